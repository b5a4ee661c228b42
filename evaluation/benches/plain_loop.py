"""What a graph costs and finds without a front end: known identities, GTSAM as it comes.

The plain loop gives iSAM2 one update a pose with its default parameters, and asks for the new pose
each time. The batch optimum starts where that ended: from dead reckoning every batch solver fails
on Victoria Park.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factors import (
    Odometry,
    Sighting,
    odometry_factor,
    prior_factor,
    sighting_factor,
    to_gtsam,
)
from semgraph.landmarks import Perceptions
from semgraph.motion_model import OdometryAccumulator
from sensors.measurements import Recording, WheelOdometry

_START_SIGMAS: Final = np.array([1e-3, 1e-3, 1e-4])


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A pose, reached by `motion` from the one before, and what is perceived from it."""

    stamp_ns: int
    motion: UncertainPose2
    perceptions: Perceptions | None


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Poses at the stamps of the steps, (2,) of each landmark by identity."""

    trajectory: Trajectory
    map_t_landmarks: Mapping[str, FloatArray]


def every_pose(recording: Recording) -> list[Step]:
    """A step for each sample of the wheels.

    Raises:
        InputError: no wheels, or a perception without an identity or odometry of its time.
    """
    wheels, steps = _wheels(recording), list[Step]()
    for measurement in recording.measurements:
        if isinstance(measurement, WheelOdometry):
            wheels.add(measurement)
            steps.append(Step(measurement.stamp_ns, wheels.take(), None))
        elif isinstance(measurement, Perceptions):
            _check_identities(recording, measurement)
            if not steps or steps[-1].stamp_ns != measurement.stamp_ns:
                raise InputError(f"{recording.name}: expected odometry at each perception's time")
            steps[-1] = Step(measurement.stamp_ns, steps[-1].motion, measurement)
    return steps


def every_scan(recording: Recording) -> list[Step]:
    """A step for each set of perceptions, the odometry between them composed.

    Raises:
        InputError: no wheels, or a perception without an identity.
    """
    wheels, steps = _wheels(recording), list[Step]()
    for measurement in recording.measurements:
        if isinstance(measurement, WheelOdometry):
            wheels.add(measurement)
        elif isinstance(measurement, Perceptions):
            _check_identities(recording, measurement)
            steps.append(Step(measurement.stamp_ns, wheels.take(), measurement))
    return steps


def plain_loop(steps: Sequence[Step], map_T_start: Pose2) -> Solution:
    """One iSAM2 update a step, the new pose asked for each time; all variables at the end."""
    isam, numbers = gtsam.ISAM2(gtsam.ISAM2Params()), dict[str, int]()
    pose = map_T_start
    for k, step in enumerate(steps):
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            factors.add(_prior(map_T_start))
            values.insert(X(0), to_gtsam(pose))
        pose = pose @ step.motion.pose
        values.insert(X(k + 1), to_gtsam(pose))
        num_known = len(numbers)
        for factor in _factors(k, step, numbers):
            factors.add(factor)
        for number, place in _first_places(step, pose, numbers, num_known).items():
            values.insert(j=L(number), point2=place)
        isam.update(factors, values)
        estimate = isam.calculateEstimatePose2(X(k + 1))
        pose = Pose2(estimate.x(), estimate.y(), estimate.theta())
    return _solution(isam.calculateEstimate(), steps, numbers)


class KnownGraph:
    """The whole graph over some steps, whose landmarks are known by their identities."""

    def __init__(self, steps: Sequence[Step], map_T_start: Pose2) -> None:
        self._steps = steps
        self._map_T_start = map_T_start
        self._factors = gtsam.NonlinearFactorGraph()
        self._numbers: dict[str, int] = {}
        self._factors.add(_prior(map_T_start))
        for k, step in enumerate(steps):
            for factor in _factors(k, step, self._numbers):
                self._factors.add(factor)

    def cost(self, solution: Solution) -> float:
        """The sum over all factors at a solution, robust kernels included.

        A landmark that it lacks lies where its poses see it best.
        """
        return float(self._factors.error(self._values(solution)))

    def optimum(self, *starts: Solution) -> Solution:
        """The best batch optimum that Levenberg-Marquardt finds from any of the starts.

        Robust kernels leave several.
        """
        found = [self._optimum(start) for start in starts]
        return min(found, key=self.cost)

    def _optimum(self, start: Solution) -> Solution:
        optimizer = gtsam.LevenbergMarquardtOptimizer(self._factors, self._values(start))
        return _solution(optimizer.optimize(), self._steps, self._numbers)

    def _values(self, solution: Solution) -> gtsam.Values:
        stamps_ns = np.array([step.stamp_ns for step in self._steps])
        rows = np.searchsorted(solution.trajectory.stamps_ns, stamps_ns)
        poses = [Pose2.from_array(pose) for pose in solution.trajectory.map_T_bases[rows]]
        values = gtsam.Values()
        values.insert(X(0), to_gtsam(self._map_T_start))
        for k, pose in enumerate(poses):
            values.insert(X(k + 1), to_gtsam(pose))
        lacking: list[int] = []
        for identity, (first, *_) in _seen(self._steps, poses).items():
            place, number = solution.map_t_landmarks.get(identity), self._numbers[identity]
            values.insert(j=L(number), point2=first if place is None else place)
            if place is None:
                lacking.append(number)
        return self._placed(values, lacking) if lacking else values

    def _placed(self, values: gtsam.Values, landmarks: Sequence[int]) -> gtsam.Values:
        """Values with these landmarks at their optimum, all poses held."""
        keys = {L(landmark) for landmark in landmarks}
        graph, some, held = gtsam.NonlinearFactorGraph(), gtsam.Values(), set[int]()
        for k in range(self._factors.size()):
            pose, *landmark = self._factors.at(k).keys()
            if keys.intersection(landmark):
                graph.add(self._factors.at(k))
                held.add(pose)
        for key in held:
            some.insert(key, values.atPose2(key))
            graph.add(gtsam.NonlinearEqualityPose2(key, values.atPose2(key)))
        for key in keys:
            some.insert(j=key, point2=values.atPoint2(key))
        placed = gtsam.LevenbergMarquardtOptimizer(graph, some).optimize()
        for key in keys:
            values.update(j=key, point2=placed.atPoint2(key))
        return values


def _prior(map_T_start: Pose2) -> gtsam.PriorFactorPose2:
    return prior_factor(UncertainPose2(map_T_start, np.diag(_START_SIGMAS**2)))


def _factors(
    k: int, step: Step, numbers: dict[str, int]
) -> Iterator[gtsam.BetweenFactorPose2 | gtsam.BearingRangeFactor2D]:
    """Of a step: to pose k + 1, and its sightings. New identities are given numbers."""
    yield odometry_factor(Odometry(k, k + 1, step.motion))
    seen = step.perceptions
    if seen is None:
        return
    for row, identity in enumerate(seen.identities.tolist()):
        number = numbers.setdefault(identity, len(numbers))
        range_m, bearing = float(seen.ranges_m[row]), float(seen.bearings[row])
        yield sighting_factor(Sighting(k + 1, number, range_m, bearing, seen.covariances[row]))


def _first_places(
    step: Step, map_T_base: Pose2, numbers: Mapping[str, int], num_known: int
) -> dict[int, FloatArray]:
    """(2,) of each landmark that is new in a step, where it is seen."""
    places = {numbers[name]: seen[0] for name, seen in _seen([step], [map_T_base]).items()}
    return {number: place for number, place in places.items() if number >= num_known}


def _seen(steps: Sequence[Step], map_T_bases: Sequence[Pose2]) -> dict[str, list[FloatArray]]:
    """By identity, where each perception of it lies in map (2,)."""
    seen: dict[str, list[FloatArray]] = {}
    for step, map_T_base in zip(steps, map_T_bases, strict=True):
        if step.perceptions is not None:
            places = map_T_base.transform(step.perceptions.base_t_landmarks())
            for name, place in zip(step.perceptions.identities.tolist(), places, strict=True):
                seen.setdefault(name, []).append(place)
    return seen


def _solution(values: gtsam.Values, steps: Sequence[Step], numbers: Mapping[str, int]) -> Solution:
    poses = np.asarray(gtsam.utilities.extractPose2(values))[1:]
    stamps_ns = np.array([step.stamp_ns for step in steps], dtype=np.int64)
    places = {name: np.asarray(values.atPoint2(L(number))) for name, number in numbers.items()}
    return Solution(Trajectory(stamps_ns, poses), places)


def _wheels(recording: Recording) -> OdometryAccumulator:
    if recording.odometry_noise is None:
        raise InputError(f"{recording.name}: expected wheel odometry, there is none")
    return OdometryAccumulator(recording.odometry_noise)


def _check_identities(recording: Recording, perceptions: Perceptions) -> None:
    if (perceptions.identities == "").any():
        raise InputError(f"{recording.name}: expected an identity of each perception")
