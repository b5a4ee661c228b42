"""The pose and landmark graph on iSAM2. Only this file and `factors.py` know gtsam.

The graph keeps a log of its own of every factor. iSAM2 is built from the log again when an update
fails, since a failed update leaves it unusable. After an update only what is asked for is read:
reading everything would cost more than the update, the longer the run the more.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from scipy.sparse import csr_matrix

from semgraph.arrays import FloatArray, IntArray, frozen_floats
from semgraph.errors import GraphError
from semgraph.factors import (
    ROBUST_CHI2,
    Odometry,
    Sighting,
    check_definite,
    check_sighting,
    odometry_factor,
    prior_factor,
    sighting_factor,
    to_gtsam,
)
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.information import Information
from semgraph.measurement_model import innovations, mahalanobis2, predict
from semgraph.point_grid import PointGrid

# Entries of the Bayes tree a column, from which on a graph is dense.
_DENSE: Final = 200
_AT_ONCE: Final = 40
# Cells of the places of landmarks; about as far as things are seen.
_CELL_M: Final = 10.0
# By so much the last pose may jump before all that was read of the graph is stale.
_JUMP_M: Final = 0.5
# How often a graph that was rebuilt from values of some time ago is linearized again.
_SETTLING: Final = 5


@dataclass(frozen=True, slots=True, eq=False)
class GraphEstimate:
    """All variables at one moment.

    Attributes:
        map_T_bases: (n, 3), row k is pose k.
        map_t_landmarks: position (2,) by landmark.
    """

    map_T_bases: FloatArray
    map_t_landmarks: dict[int, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """All variables at one moment, and what they cost."""

    cost: float
    values: gtsam.Values


class FactorGraph:
    """Poses 0, 1, 2, ... joined by odometry, and the landmarks they sighted.

    Raises:
        GraphError: the start has no positive definite covariance.
    """

    def __init__(self, map_T_start: UncertainPose2) -> None:
        check_definite("start", map_T_start.covariance)
        self._start = map_T_start
        self._odometry: list[Odometry] = []
        self._sightings: dict[int, list[Sighting]] = {}
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_sightings: list[tuple[int, Sighting]] = []
        self._new_values = gtsam.Values()
        self._removed_slots: list[int] = []
        self._firm: list[Sighting] = []
        self._pose_guesses = [map_T_start.pose]
        self._landmark_guesses: dict[int, FloatArray] = {}
        self._factorization = "CHOLESKY"
        self._isam = _new_isam(self._factorization)
        self._estimate = gtsam.Values()
        self._is_current = False
        self._places = PointGrid(_CELL_M)
        self._factored: Information | None = None
        self._columns: dict[int, IntArray] = {}
        self._incidents: list[str] = []
        self._new_factors.add(prior_factor(map_T_start))
        self._new_values.insert(X(0), to_gtsam(map_T_start.pose))

    @property
    def num_poses(self) -> int:
        """How many poses there are, the start included."""
        return len(self._pose_guesses)

    @property
    def is_updated(self) -> bool:
        """Whether nothing waits for an update."""
        return self._new_factors.size() == 0 and not self._removed_slots

    @property
    def incidents(self) -> Sequence[str]:
        """What went wrong in updates and how it was mended, one line each."""
        return tuple(self._incidents)

    def landmarks(self) -> tuple[int, ...]:
        """The landmarks in the graph."""
        return tuple(self._sightings)

    def sightings(self, landmark: int) -> Sequence[Sighting]:
        """All sightings of a landmark, in the order they were added."""
        return tuple(self._sightings[landmark])

    def add_pose(self, motion: UncertainPose2, guess: Pose2) -> int:
        """The index of a new pose, reached from the last one by `motion`; it starts at `guess`.

        Raises:
            GraphError: the motion has no positive definite covariance.
        """
        check_definite("motion", motion.covariance)
        index = len(self._pose_guesses)
        odometry = Odometry(index - 1, index, motion)
        self._odometry.append(odometry)
        self._pose_guesses.append(guess)
        self._new_factors.add(odometry_factor(odometry))
        self._new_values.insert(X(index), to_gtsam(guess))
        return index

    def add_landmark(self, landmark: int, guess: FloatArray) -> None:
        """A new landmark near `guess` (2,); a sighting must follow before the next update.

        Raises:
            GraphError: it exists already.
            InputError: the guess is no finite point.
        """
        if landmark in self._sightings:
            raise GraphError(f"landmark {landmark} is in the graph already")
        guess = frozen_floats(f"guess of landmark {landmark}", guess, (2,))
        self._sightings[landmark] = []
        self._landmark_guesses[landmark] = guess
        self._places.put(landmark, guess)
        self._new_values.insert(j=L(landmark), point2=guess)

    def add_sighting(self, sighting: Sighting) -> None:
        """One more sighting of a landmark that is in the graph.

        Raises:
            GraphError: no such pose or landmark, NaN, a range of zero or below, or a covariance
                that is not positive definite. GTSAM would take them in silence, and the log could
                never be solved again.
            InputError: the covariance is no finite symmetric (2, 2).
        """
        self._check_known(sighting.landmark)
        if not 0 <= sighting.pose < self.num_poses:
            raise GraphError(
                f"sighting of landmark {sighting.landmark}: expected a pose below "
                f"{self.num_poses}, got {sighting.pose}"
            )
        check_sighting(sighting)
        self._sightings[sighting.landmark].append(sighting)
        self._queue(sighting)

    def merge(self, gone: int, kept: int) -> None:
        """Makes two landmarks one with the next update: sightings of `gone` become `kept`'s.

        Where drift has brought both so far apart that the robust kernel would let the sightings
        go, they hold firmly at first, until the graph has moved.

        Raises:
            GraphError: both are the same or one is not in the graph; or factors wait for an
                update, their places in iSAM2 are not known yet.
        """
        for landmark in (gone, kept):
            self._check_known(landmark)
        if gone == kept:
            raise GraphError(f"landmark {gone}: expected another one to merge it with")
        self._check_updated(gone)
        if self.are_far_apart(gone, kept):
            self._firm += self._sightings[gone]
        self._hand_over(self._sightings[gone], kept)
        self._forget(gone)

    def are_far_apart(self, gone: int, kept: int) -> bool:
        """Whether the kernel would let a sighting of `gone` go if it were one of `kept`."""
        place = self.landmark(kept)
        return any(self._misfit(each, place) > ROBUST_CHI2 for each in self._sightings[gone])

    def cost(self) -> float:
        """Half the sum of all chi-squares, under the kernel; takes time as long as the run."""
        if not self._is_current:
            self._read_all()
        return float(self._isam.getFactorsUnsafe().error(self._estimate))

    def checkpoint(self) -> Checkpoint:
        """Where everything is now, to go back to if what comes next turns out wrong."""
        return Checkpoint(self.cost(), self._estimate)

    def go_back(self, checkpoint: Checkpoint) -> None:
        """Takes in what waits for an update, but everything starts from where it was then.

        What has been split again would else stay near where the wrong merge has brought it.
        """
        self._estimate, self._is_current = checkpoint.values, True
        self._rebuild()
        self._empty_queue()

    def split(self, landmark: int, tracks: Set[int], new: int) -> None:
        """Takes a merge back with the next update: sightings of these tracks are of `new` again.

        Raises:
            GraphError: the landmark is not in the graph, none or all of its sightings are of these
                tracks, or factors of it wait for an update.
        """
        self._check_known(landmark)
        self._check_updated(landmark)
        leaving = [each for each in self._sightings[landmark] if each.track in tracks]
        if not 0 < len(leaving) < len(self._sightings[landmark]):
            raise GraphError(
                f"landmark {landmark}: {len(leaving)} of its {len(self._sightings[landmark])} "
                "sightings are of the tracks to be split off, expected some but not all"
            )
        self._sightings[landmark] = [
            each for each in self._sightings[landmark] if each.track not in tracks
        ]
        self.add_landmark(new, self.landmark(landmark))
        self._hand_over(leaving, new)

    def remove(self, landmark: int) -> None:
        """Takes a landmark and its sightings out with the next update.

        Raises:
            GraphError: it is not in the graph, or factors of it wait for an update.
        """
        self._check_known(landmark)
        self._check_updated(landmark)
        self._removed_slots += [sighting.slot for sighting in self._sightings[landmark]]
        self._forget(landmark)

    def update(self, *, relinearize: bool = False) -> None:
        """Takes in all that was added since the last update.

        Args:
            relinearize: force it, after something old was seen again.

        A failure is named in `incidents`, and the graph rebuilt from its own log.
        """
        last = self.num_poses - 1
        try:
            before = self._guess(last)
            result = self._isam.update(
                self._new_factors,
                self._new_values,
                self._removed_slots,
                None,
                None,
                None,
                relinearize,
            )
            slots = list(result.getNewFactorsIndices())
            for position, sighting in self._new_sightings:
                sighting.slot = int(slots[position])
            self._is_current = False
            self._let_go()
            after = self.pose(last)
        except (RuntimeError, ValueError, IndexError) as error:
            self._incidents.append(f"update failed, graph rebuilt: {_first_line(error)}")
            self._rebuild()
        else:
            if np.hypot(after.x - before.x, after.y - before.y) > _JUMP_M:
                self._read_all()
        self._empty_queue()

    def _let_go(self) -> None:
        """Sightings that held firmly while the graph moved get their kernel."""
        if not self._firm:
            return
        for _ in range(_SETTLING):
            _relinearize(self._isam)
        robust = gtsam.NonlinearFactorGraph()
        for sighting in self._firm:
            robust.add(sighting_factor(sighting))
        slots = [sighting.slot for sighting in self._firm]
        result = self._isam.update(robust, gtsam.Values(), slots, None, None, None, True)
        for sighting, slot in zip(self._firm, result.getNewFactorsIndices(), strict=True):
            sighting.slot = int(slot)

    def _misfit(self, sighting: Sighting, place: FloatArray) -> float:
        """Chi-square of a sighting, if its landmark were at a place (2,)."""
        predicted = predict(self.pose(sighting.pose), place[None])
        measured = np.array([sighting.range_m]), np.array([sighting.bearing])
        innovation = innovations(predicted, *measured)[0]
        return float(mahalanobis2(innovation, sighting.covariance))

    def polish(self) -> None:
        """Moves to the batch optimum over the whole log, starting from the estimate at hand.

        Takes in what waits for an update; after many merges at once that is quicker than `update`.
        """
        graph, _ = self._whole_graph()
        self._estimate = _optimum(graph, self._guesses(), self._factorization)
        self._is_current = True
        self._rebuild()
        self._empty_queue()

    def pose(self, index: int) -> Pose2:
        """map_T_base of one pose as of the last update."""
        pose = self._isam.calculateEstimatePose2(X(index))
        return Pose2(pose.x(), pose.y(), pose.theta())

    def landmark(self, landmark: int) -> FloatArray:
        """map_t_landmark (2,) as of the last update; of what is newer, the guess."""
        if not self._isam.valueExists(L(landmark)):
            return self._landmark_guesses[landmark]
        place: FloatArray = np.array(self._isam.calculateEstimatePoint2(L(landmark)))
        self._landmark_guesses[landmark] = place
        self._places.put(landmark, place)
        return place

    def near(self, map_t_point: FloatArray, radius_m: float) -> dict[int, FloatArray]:
        """The landmarks within a radius of a point (2,), with their positions (2,)."""
        around = {
            landmark: self.landmark(landmark)
            for landmark in self._places.around(map_t_point, radius_m + _JUMP_M)
        }
        return {
            landmark: place
            for landmark, place in around.items()
            if np.hypot(*(place - map_t_point)) <= radius_m
        }

    def estimate(self) -> GraphEstimate:
        """All poses and landmarks as of the last update; takes time as long as the run."""
        if not self._is_current:
            self._read_all()
        poses = gtsam.utilities.extractPose2(self._estimate)
        return GraphEstimate(np.asarray(poses), dict(self._landmark_guesses))

    def _read_all(self) -> None:
        self._estimate = self._isam.calculateEstimate()
        self._is_current = True
        for landmark in self._sightings:
            self.landmark(landmark)

    def landmark_covariance(self, landmarks: Sequence[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks, in map, in the order given."""
        return self._joint([L(landmark) for landmark in landmarks])

    def landmark_covariances(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2, 2) marginal covariance of each landmark, in map."""
        return self._marginals([L(landmark) for landmark in landmarks], 2)

    def pose_covariance(self, index: int) -> FloatArray:
        """(3, 3) marginal covariance of a pose, (x, y, theta) in its own frame."""
        return self._by_isam([X(index)])

    def pose_covariances(self, indices: Sequence[int]) -> FloatArray:
        """(n, 3, 3) marginal covariance of each pose, (x, y, theta) in its own frame."""
        return self._marginals([X(index) for index in indices], 3)

    def chain_covariances(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3, 3) marginal covariance of each pose, and of each with the one after it.

        Each in its own frame; after the last pose there is none, the cross covariance is 0.
        """
        keys = [X(index) for index in range(self.num_poses)]
        covariances, crosses = (np.zeros((len(keys), 3, 3)) for _ in range(2))
        for start in range(0, len(keys), _AT_ONCE):
            some = keys[start : start + _AT_ONCE + 1]
            joint = self._joint(some).reshape(len(some), 3, len(some), 3)
            each = np.arange(len(some))
            covariances[start : start + len(some)] = joint[each, :, each, :]
            crosses[start : start + len(some) - 1] = joint[each[:-1], :, each[1:], :]
        return covariances, crosses

    def _joint(self, keys: Sequence[int]) -> FloatArray:
        """The covariance of variables together.

        iSAM2 needs the cliques between them; where these are large, in a dense stand, the sparse
        matrix of the whole graph is tenfold quicker.
        """
        try:
            if self._is_dense():
                information = self._information()
                return information.covariance(np.concatenate([self._columns[k] for k in keys]))
        except GraphError as error:
            self._incidents.append(f"covariance by iSAM2: {error}")
        return self._by_isam(keys)

    def _marginals(self, keys: Sequence[int], size: int) -> FloatArray:
        """(n, size, size): by the dozen, which costs little more than one."""
        covariances = np.zeros((len(keys), size, size))
        for start in range(0, len(keys), _AT_ONCE):
            some = keys[start : start + _AT_ONCE]
            joint = self._joint(some).reshape(len(some), size, len(some), size)
            each = np.arange(len(some))
            covariances[start : start + len(some)] = joint[each, :, each, :]
        return covariances

    def _is_dense(self) -> bool:
        num_columns = 3 * self.num_poses + 2 * len(self._sightings)
        return bool(self._isam.treeNnz() >= _DENSE * num_columns)

    def _by_isam(self, keys: Sequence[int]) -> FloatArray:
        try:
            return self._isam_covariance(keys)
        except RuntimeError as error:
            if self._factorization == "QR":
                raise GraphError(f"no covariance: {_first_line(error)}") from error
            self._incidents.append(f"no covariance, QR from now on: {_first_line(error)}")
            self._factorization = "QR"
            self._rebuild()
            return self._isam_covariance(keys)

    def _isam_covariance(self, keys: Sequence[int]) -> FloatArray:
        if len(keys) == 1:
            return np.asarray(self._isam.marginalCovariance(keys[0]))
        return np.asarray(self._isam.jointMarginalCovariance(list(keys)).fullMatrix())

    def _information(self) -> Information:
        """Of all variables as of the last update; made when it is first asked for.

        Raises:
            GraphError: the graph is singular.
        """
        if self._factored is None:
            if not self._is_current:
                self._read_all()
            linear = self._isam.getFactorsUnsafe().linearize(self._estimate)
            row, column, value = linear.sparseJacobian_()
            widths = {key: 2 if key < X(0) else 3 for key in sorted(linear.keys())}
            starts = np.cumsum([0, *widths.values()])
            self._columns = {
                key: np.arange(start, start + width)
                for (key, width), start in zip(widths.items(), starts[:-1].tolist(), strict=True)
            }
            # The last column is the right side.
            whole = csr_matrix((value, (row.astype(np.int64) - 1, column.astype(np.int64) - 1)))
            self._factored = Information(whole[:, : starts[-1]])
        return self._factored

    def _check_known(self, landmark: int) -> None:
        if landmark not in self._sightings:
            raise GraphError(f"landmark {landmark} is not in the graph; add it first")

    def _check_updated(self, landmark: int) -> None:
        if any(sighting.landmark == landmark for _, sighting in self._new_sightings):
            raise GraphError(f"landmark {landmark}: update the graph before it is taken out")

    def _hand_over(self, sightings: Sequence[Sighting], landmark: int) -> None:
        """With the next update these are sightings of another landmark."""
        for sighting in sightings:
            self._removed_slots.append(sighting.slot)
            sighting.landmark = landmark
            self._sightings[landmark].append(sighting)
            self._queue(sighting)

    def _forget(self, landmark: int) -> None:
        del self._sightings[landmark], self._landmark_guesses[landmark]
        self._places.remove(landmark)

    def _queue(self, sighting: Sighting) -> None:
        self._new_sightings.append((self._new_factors.size(), sighting))
        is_firm = sighting in self._firm
        self._new_factors.add(sighting_factor(sighting, is_firm=is_firm))

    def _empty_queue(self) -> None:
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_sightings = []
        self._new_values = gtsam.Values()
        self._removed_slots = []
        self._firm = []
        self._factored = None

    def _whole_graph(self) -> tuple[gtsam.NonlinearFactorGraph, list[Sighting]]:
        """All factors of the log, and the sightings in the order of their factors."""
        graph = gtsam.NonlinearFactorGraph()
        graph.add(prior_factor(self._start))
        for odometry in self._odometry:
            graph.add(odometry_factor(odometry))
        sightings = [sighting for group in self._sightings.values() for sighting in group]
        for sighting in sightings:
            graph.add(sighting_factor(sighting))
        return graph, sightings

    def _rebuild(self) -> None:
        """A new iSAM2 over the whole log, at the last good estimate; by QR if it must be.

        Raises:
            GraphError: the log itself cannot be solved.
        """
        graph, sightings = self._whole_graph()
        isam = _new_isam(self._factorization)
        try:
            isam.update(graph, self._guesses())
            for _ in range(0 if self._is_current else _SETTLING):
                isam.update(
                    gtsam.NonlinearFactorGraph(), gtsam.Values(), [], None, None, None, True
                )
            self._estimate = isam.calculateEstimate()
        except (RuntimeError, ValueError, IndexError) as error:
            if self._factorization == "QR":
                raise GraphError(f"the graph cannot be solved: {_first_line(error)}") from error
            self._factorization = "QR"
            self._rebuild()
            return
        first = 1 + len(self._odometry)
        for position, sighting in enumerate(sightings):
            sighting.slot = first + position
        self._isam = isam
        self._read_all()

    def _guesses(self) -> gtsam.Values:
        """The last good value of each variable, and the first guess of new ones."""
        values = gtsam.Values()
        for index in range(self.num_poses):
            values.insert(X(index), to_gtsam(self._guess(index)))
        for landmark, guess in self._landmark_guesses.items():
            is_read = self._is_current and self._estimate.exists(L(landmark))
            place = np.asarray(self._estimate.atPoint2(L(landmark))) if is_read else guess
            values.insert(j=L(landmark), point2=place)
        return values

    def _guess(self, index: int) -> Pose2:
        """The last good value of a pose, or its first guess."""
        if not self._estimate.exists(X(index)):
            return self._pose_guesses[index]
        pose = self._estimate.atPose2(X(index))
        return Pose2(pose.x(), pose.y(), pose.theta())


def _new_isam(factorization: str) -> gtsam.ISAM2:
    """iSAM2 by Cholesky, or QR: that is slower but takes graphs whose sigmas differ by decades."""
    params = gtsam.ISAM2Params()
    params.setFactorization(factorization)
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.01))
    params.setRelinearizeThreshold(0.1)
    # Closures force it; relinearizing less often costs no accuracy, for the end is a batch.
    params.relinearizeSkip = 3
    params.enablePartialRelinearizationCheck = True
    params.findUnusedFactorSlots = True
    return gtsam.ISAM2(params)


def _relinearize(isam: gtsam.ISAM2) -> None:
    """One step more, with nothing new."""
    isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), [], None, None, None, True)


def _optimum(
    graph: gtsam.NonlinearFactorGraph, guesses: gtsam.Values, factorization: str
) -> gtsam.Values:
    """The batch optimum; by QR if it must be."""
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType(f"MULTIFRONTAL_{factorization}")
    try:
        return gtsam.LevenbergMarquardtOptimizer(graph, guesses, params).optimize()
    except RuntimeError:
        if factorization == "QR":
            raise
        return _optimum(graph, guesses, "QR")


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
