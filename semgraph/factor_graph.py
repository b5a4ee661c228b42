"""The pose and landmark graph: what is added to it, made one, split and solved.

The graph keeps a log of its own of all that was added. iSAM2 is built from the log again when an
update fails, since a failed update leaves it unusable. After an update only what is asked for is
read: reading everything would cost more than the update, the longer the run the more. Poses that
lie back are condensed, window by window, until the batch at the end.
"""

from collections.abc import Callable, Iterable, Sequence, Set
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats
from semgraph.condensation import Condensed, follow, linearized
from semgraph.covariances import Covariances
from semgraph.errors import GraphError
from semgraph.factors import (
    ROBUST_CHI2,
    Sighting,
    check_definite,
    check_sighting,
    condensed_factor,
    landmark_key,
    motion_factor,
    pose_key,
    prior_factor,
    sighting_factor,
)
from semgraph.geometry import Pose2, UncertainPose2, rotation, wrap_angle
from semgraph.graph_log import GraphLog
from semgraph.growing import Growing
from semgraph.incremental import Incremental, NoCovarianceError, Slots, UpdateError
from semgraph.measurement_model import innovations, mahalanobis2, predict
from semgraph.pieces import Piece, covariance_by
from semgraph.point_grid import PointGrid
from semgraph.windows import NONE, Window, Windows

Answer = TypeVar("Answer")
# Cells of the places of landmarks; about as far as things are seen.
_CELL_M: Final = 10.0
_LEAST_SIGMA_M: Final = 1e-3
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
    estimate: GraphEstimate


class FactorGraph:
    """Poses 0, 1, 2, ... joined by odometry, and the landmarks they sighted.

    Args:
        map_T_start: of pose 0.
        window_poses: so many poses are condensed into one factor once as many have followed;
            0 for none. It must not be less than come between two updates.

    Raises:
        GraphError: the start has no positive definite covariance.
    """

    def __init__(self, map_T_start: UncertainPose2, window_poses: int = 0) -> None:
        check_definite("start", map_T_start.covariance)
        self._log = GraphLog(map_T_start)
        self._windows = Windows(self._log, window_poses)
        self._isam = Incremental()
        self._slots = _AllSlots()
        self._firm: list[int] = []
        # Of each variable the last that was read; of what was not read as yet, its first guess.
        self._poses, self._landmarks = Growing((3,)), dict[int, FloatArray]()
        self._places = PointGrid(_CELL_M)
        self._is_current = False
        self._last_updated = -1
        self._incidents: list[str] = []
        self._covariances = self._new_covariances()
        self._poses.append(map_T_start.pose.as_array())
        self._isam.add(prior_factor(map_T_start), self._slots.prior, 0)
        self._isam.insert_pose(0, map_T_start.pose)

    @property
    def num_poses(self) -> int:
        """How many poses there are, the start included."""
        return self._log.num_poses

    @property
    def is_updated(self) -> bool:
        """Whether nothing waits for an update."""
        return self._isam.is_updated and not self._windows.changed

    @property
    def incidents(self) -> Sequence[str]:
        """What went wrong in updates and how it was mended, one line each."""
        return tuple(self._incidents)

    def landmarks(self) -> tuple[int, ...]:
        """The landmarks in the graph."""
        return self._log.names()

    def sightings(self, landmark: int) -> Sequence[Sighting]:
        """All sightings of a landmark."""
        return tuple(map(self._log.sighting, self._log.rows(landmark).tolist()))

    def num_sightings(self, landmark: int) -> int:
        """How many there are of a landmark."""
        return len(self._log.rows(landmark))

    def add_pose(self, motion: UncertainPose2, guess: Pose2) -> int:
        """The index of a new pose, reached from the last one by `motion`; it starts at `guess`.

        Raises:
            GraphError: the motion has no positive definite covariance.
        """
        check_definite("motion", motion.covariance)
        index = self._log.add_motion(motion)
        self._poses.append(guess.as_array())
        self._isam.insert_pose(index, guess)
        self._add_motion(index)
        return index

    def add_landmark(self, landmark: int, guess: FloatArray) -> None:
        """A new landmark near `guess` (2,); a sighting must follow before the next update.

        Raises:
            GraphError: it exists already.
            InputError: the guess is no finite point.
        """
        if landmark in self._log:
            raise GraphError(f"landmark {landmark} is in the graph already")
        guess = frozen_floats(f"guess of landmark {landmark}", guess, (2,))
        self._log.add_landmark(landmark)
        self._move(landmark, guess)
        self._isam.insert_landmark(landmark, guess)

    def add_sighting(self, sighting: Sighting) -> None:
        """One more sighting of a landmark that is in the graph.

        Raises:
            GraphError: no such pose or landmark, or the pose is condensed; NaN, a range of zero or
                below, or a covariance that is not positive definite. GTSAM would take them in
                silence, and the log could never be solved again.
            InputError: the covariance is no finite symmetric (2, 2).
        """
        self._check_known(sighting.landmark)
        if not 0 <= sighting.pose < self.num_poses:
            raise GraphError(
                f"sighting of landmark {sighting.landmark}: expected a pose below "
                f"{self.num_poses}, got {sighting.pose}"
            )
        if self._windows.of_motion(sighting.pose) != NONE:
            raise GraphError(f"sighting from pose {sighting.pose}: that is condensed already")
        check_sighting(sighting)
        self._add_sighting(self._log.add_sighting(sighting))

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
        rows = self._log.rows(gone)
        if self.are_far_apart(gone, kept):
            self._firm += self._live(rows)
        self._hand_over(rows, kept)
        self._windows.hand_over(gone, kept)
        self._forget(gone)

    def are_far_apart(self, gone: int, kept: int) -> bool:
        """Whether the kernel would let go as one of `kept` a sighting that it holds of `gone`."""
        rows = self._log.rows(gone)
        now, then = (self._misfits(rows, self.landmark(each)) for each in (gone, kept))
        return bool(((now <= ROBUST_CHI2) & (then > ROBUST_CHI2)).any())

    def split(self, landmark: int, tracks: Set[int], new: int) -> None:
        """Takes a merge back with the next update: sightings of these tracks are of `new` again.

        Raises:
            GraphError: the landmark is not in the graph, none or all of its sightings are of these
                tracks, or factors of it wait for an update.
        """
        self._check_known(landmark)
        self._check_updated(landmark)
        rows = self._log.rows(landmark)
        leaving = rows[np.isin(self._log.tracks[rows], list(tracks))]
        if not 0 < len(leaving) < len(rows):
            raise GraphError(
                f"landmark {landmark}: {len(leaving)} of its {len(rows)} "
                "sightings are of the tracks to be split off, expected some but not all"
            )
        self.add_landmark(new, self.landmark(landmark))
        self._hand_over(leaving, new)
        self._windows.hand_over(landmark, new, tracks)

    def remove(self, landmark: int) -> None:
        """Takes a landmark and its sightings out with the next update.

        Raises:
            GraphError: it is not in the graph, or factors of it wait for an update.
        """
        self._check_known(landmark)
        self._check_updated(landmark)
        for row in self._live(self._log.rows(landmark)):
            self._isam.remove(self._slots.sightings, row)
        windows = self._windows.of(landmark)
        self._forget(landmark)
        for number in windows:
            window = self._windows[number]
            rows = np.array(self._log.known(window.rows.tolist()), dtype=np.int64)
            self._windows.replace(number, *self._condense(window.first, window.last, rows))
        self._windows.forget(landmark)

    def weakest_link(self, since_pose: int) -> int:
        """The pose after the least certain motion since a pose."""
        covariances = self._log.motion_covariances[since_pose + 1 :]
        return since_pose + 1 + int((covariances[:, 0, 0] + covariances[:, 1, 1]).argmax())

    def cost(self) -> float:
        """Half the sum of all chi-squares, under the kernel; takes time as long as the run.

        Of what is condensed, only what comes to it by its ends and landmarks.
        """
        return self._isam.cost()

    def checkpoint(self) -> Checkpoint:
        """Where everything is now, to go back to if what comes next turns out wrong."""
        return Checkpoint(self.cost(), self.estimate())

    def go_back(self, checkpoint: Checkpoint) -> None:
        """Takes in what waits for an update, but everything starts from where it was then.

        What has been split again would else stay near where the wrong merge has brought it.
        """
        self._start_from(checkpoint.estimate)

    def carry(self, correction: Pose2, since_pose: int) -> None:
        """Moves a pose, all after it, and what only those sighted; no factor changes.

        Args:
            correction: takes what was believed in map to where it is.
            since_pose: the first pose that moves.
        """
        estimate = self.estimate()
        poses = estimate.map_T_bases.copy()
        poses[since_pose:, :2] = correction.transform(poses[since_pose:, :2])
        poses[since_pose:, 2] = wrap_angle(poses[since_pose:, 2] + correction.theta)
        places = {
            landmark: correction.transform(place[None])[0]
            if (self._log.poses[self._log.rows(landmark)] >= since_pose).all()
            else place
            for landmark, place in estimate.map_t_landmarks.items()
        }
        self._start_from(GraphEstimate(poses, places))

    def polish(self) -> None:
        """Moves to the batch optimum over the whole log, starting from the estimate at hand.

        Takes in what waits for an update; after many merges at once that is quicker than `update`.
        Nothing is condensed any more.
        """
        self.estimate()
        self._windows.clear(self.num_poses - 1)
        whole, kept = Incremental(self._isam.factorization), (self._isam, self._slots)
        self._isam, self._slots = whole, _AllSlots()
        self._add_all()
        self._isam, self._slots = kept
        found = whole.optimum()
        self._start_from(GraphEstimate(found.map_T_bases, dict(found.map_t_landmarks)))

    def update(self, *, relinearize: bool = False) -> None:
        """Takes in all that was added since the last update.

        Args:
            relinearize: force it, after something old was seen again.

        A failure is named in `incidents`, and the graph rebuilt from its own log.
        """
        last = self.num_poses - 1
        before = self._poses.rows[last].copy()
        try:
            if not relinearize:
                self._condense_next()
            self._add_windows()
            self._isam.update(relinearize=relinearize)
            self._is_current = False
            self._let_go()
            self._poses.rows[last] = self._isam.pose(last).as_array()
        except UpdateError as error:
            self._incidents.append(f"update failed, graph rebuilt: {error}")
            self._rebuild()
        else:
            if np.hypot(*(self._poses.rows[last] - before)[:2]) > _JUMP_M:
                self._read_all()
        self._settled()

    def settle(self) -> None:
        """Linearizes again until little moves: what one update after a great change leaves open."""
        for _ in range(_SETTLING):
            self.update(relinearize=True)

    def pose(self, index: int) -> Pose2:
        """map_T_base of one pose as of the last update."""
        number = self._windows.of_pose(index)
        if number == NONE:
            return self._isam.pose(index)
        window = self._windows[number]
        first = self._isam.pose(window.first)
        between = window.condensed.first_T_between[index - window.first - 1]
        return first @ Pose2.from_array(between)

    def landmark(self, landmark: int) -> FloatArray:
        """map_t_landmark (2,) as of the last update; of what is newer, the guess."""
        if self._isam.has_landmark(landmark):
            self._move(landmark, self._isam.landmark(landmark))
        return self._landmarks[landmark]

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
        return GraphEstimate(self._poses.rows.copy(), dict(self._landmarks))

    def landmark_covariance(self, landmarks: Sequence[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks, in map, in the order given."""
        return self._joint([landmark_key(landmark) for landmark in landmarks])

    def covariance_around(self, landmarks: Sequence[int], around: Iterable[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks as if the last pose were known, in map.

        By what is not condensed and what else was sighted together with those `around`: what lies
        farther off could make it smaller, but it costs as much as the run is long. As it is where
        that does not connect them, or nothing is condensed.
        """
        if not len(self._windows) or not self._isam.is_updated:
            return self.landmark_covariance(landmarks)
        windows = {number for each in (*around, *landmarks) for number in self._windows.of(each)}
        pieces = [self._piece(number) for number in sorted(windows)]
        try:
            found = covariance_by(pieces, self._last_piece(), landmarks)
        except GraphError as error:
            self._incidents.append(f"covariance by the whole graph: {error}")
            found = None
        return self.landmark_covariance(landmarks) if found is None else found

    def _piece(self, number: int) -> Piece:
        """A window where it is now."""
        window = self._windows[number]
        return Piece(
            window.first,
            window.last,
            tuple(window.landmarks.tolist()),
            *linearized(
                window.condensed,
                self.pose(window.first).as_array(),
                self.pose(window.last).as_array(),
                np.array([self.landmark(k) for k in window.landmarks.tolist()]).reshape(-1, 2),
            )[1:],
        )

    def _last_piece(self) -> Piece:
        """What is not condensed as yet, condensed for once."""
        last = self.num_poses - 1
        first = last
        while first > 0 and self._windows.of_motion(first) == NONE:
            first -= 1
        rows = self._log.rows_of_poses(first + 1, last)
        poses = np.array([self.pose(k).as_array() for k in range(first, last + 1)])
        names, condensed = self._condense(first, last, rows)
        landmarks = tuple(names[:, 0].tolist())
        places = np.array([self.landmark(k) for k in landmarks]).reshape(-1, 2)
        return Piece(
            first, last, landmarks, *linearized(condensed, poses[0], poses[-1], places)[1:]
        )

    def landmark_covariances(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2, 2) marginal covariance of each landmark, in map."""
        keys = [landmark_key(landmark) for landmark in landmarks]
        return self._sure(lambda known: known.marginals(keys, 2))

    def covariances_given_last_pose(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2, 2) of each landmark in the last pose's frame, as if that pose were known."""
        last = self.num_poses - 1
        joint = self._joint([pose_key(last), *map(landmark_key, landmarks)])
        gain = np.linalg.solve(joint[:3, :3], joint[:3, 3:])
        given = (joint[3:, 3:] - gain.T @ joint[:3, 3:]).reshape(
            len(landmarks), 2, len(landmarks), 2
        )
        each = np.arange(len(landmarks))
        base_R_map = rotation(-self.pose(last).theta)
        in_base = base_R_map @ given[each, :, each, :] @ base_R_map.T
        # Where the pose is unsure by kilometres, little is left of the difference but rounding.
        values, axes = np.linalg.eigh(0.5 * (in_base + in_base.transpose(0, 2, 1)))
        floored: FloatArray = np.maximum(values, _LEAST_SIGMA_M**2)
        covariances: FloatArray = (axes * floored[:, None, :]) @ axes.transpose(0, 2, 1)
        return covariances

    def pose_covariance(self, index: int) -> FloatArray:
        """(3, 3) marginal covariance of a pose, (x, y, theta) in its own frame."""
        self._uncondense([index])
        return self._joint([pose_key(index)])

    def pose_covariances(self, indices: Sequence[int]) -> FloatArray:
        """(n, 3, 3) marginal covariance of each pose, (x, y, theta) in its own frame."""
        self._uncondense(indices)
        keys = [pose_key(index) for index in indices]
        return self._sure(lambda known: known.marginals(keys, 3))

    def chain_covariances(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3, 3) marginal covariance of each pose, and of each with the one after it.

        Each in its own frame; after the last pose there is none, the cross covariance is 0.
        """
        indices = range(self.num_poses)
        self._uncondense(indices)
        keys = [pose_key(index) for index in indices]
        return self._sure(lambda known: known.chain(keys))

    def _joint(self, keys: Sequence[int]) -> FloatArray:
        return self._sure(lambda known: known.joint(keys))

    def _sure(self, ask: Callable[[Covariances], Answer]) -> Answer:
        """What is asked for; by QR from now on if it must be.

        Raises:
            GraphError: not even then.
        """
        try:
            return ask(self._covariances)
        except NoCovarianceError as error:
            if self._isam.factorization == "QR":
                raise GraphError(f"no covariance: {error}") from error
            self._incidents.append(f"no covariance, QR from now on: {error}")
            self._isam.factorization = "QR"
            self._rebuild()
            self._settled()
            return ask(self._covariances)

    def _new_covariances(self) -> Covariances:
        # Condensed factors are slow to linearize, and a long graph is slow to factor.
        num_columns = None if len(self._windows) else 3 * self.num_poses + 2 * len(self._log)
        return Covariances(self._isam, num_columns, self._incidents)

    def _check_known(self, landmark: int) -> None:
        if landmark not in self._log:
            raise GraphError(f"landmark {landmark} is not in the graph; add it first")

    def _check_updated(self, landmark: int) -> None:
        waiting = self._isam.waiting(self._slots.sightings)
        if (self._log.landmarks[waiting] == landmark).any():
            raise GraphError(f"landmark {landmark}: update the graph before it is taken out")

    def _misfits(self, rows: IntArray, place: FloatArray) -> FloatArray:
        """(k,) chi-squares of sightings, if their landmark were at a place (2,)."""
        log = self._log
        predicted = np.array([predict(self.pose(k), place[None])[0] for k in log.poses[rows]])
        differences = innovations(predicted, *log.polar[rows].T)
        return mahalanobis2(differences, log.covariances(rows))

    def _live(self, rows: IntArray) -> list[int]:
        """The sightings that are factors of their own."""
        poses = self._log.poses[rows].tolist()
        return [
            row
            for row, pose in zip(rows.tolist(), poses, strict=True)
            if self._windows.of_motion(pose) == NONE
        ]

    def _hand_over(self, rows: IntArray, landmark: int) -> None:
        """With the next update these are sightings of another landmark."""
        self._log.hand_over(rows, landmark)
        for row in self._live(rows):
            self._isam.remove(self._slots.sightings, row)
            self._add_sighting(row)

    def _forget(self, landmark: int) -> None:
        self._log.forget(landmark)
        del self._landmarks[landmark]
        self._places.remove(landmark)

    def _move(self, landmark: int, place: FloatArray) -> None:
        """It was read to be there."""
        self._landmarks[landmark] = place
        self._places.put(landmark, place)

    def _add_motion(self, pose: int) -> None:
        factor = motion_factor(
            pose - 1, pose, self._log.motions[pose], self._log.motion_covariances[pose]
        )
        self._isam.add(factor, self._slots.motions, pose)

    def _add_sighting(self, row: int) -> None:
        factor = sighting_factor(self._log.sighting(row), is_firm=row in self._firm)
        self._isam.add(factor, self._slots.sightings, row)

    def _add_windows(self) -> None:
        """Those that are new or changed."""
        for number in sorted(self._windows.changed):
            if self._slots.windows[number] != NONE:
                self._isam.remove(self._slots.windows, number)
            window = self._windows[number]
            factor = condensed_factor(window.condensed, window.first, window.last, window.landmarks)
            self._isam.add(factor, self._slots.windows, number)
        self._windows.changed.clear()

    def _condense_next(self) -> None:
        """Takes one window of poses out with the next update, and its factor in."""
        found = self._windows.next(self._last_updated)
        if found is None:
            return
        first, last = found
        motions, rows = range(first + 1, last + 1), self._log.rows_of_poses(first + 1, last)
        if any(self._slots.sightings[row] == NONE for row in rows.tolist()):
            return
        try:
            names, condensed = self._condense(first, last, rows)
        except GraphError as error:
            self._incidents.append(f"poses {first} to {last} are not condensed: {error}")
            self._windows.skip(last)
            return
        for pose in motions:
            self._isam.remove(self._slots.motions, pose)
        for row in rows.tolist():
            self._isam.remove(self._slots.sightings, row)
        window = Window(first, last, rows.astype(np.int32), names[:, 1], names[:, 0], condensed)
        self._windows.add(window)

    def _condense(self, first: int, last: int, rows: IntArray) -> tuple[IntArray, Condensed]:
        poses = np.array([self.pose(k).as_array() for k in range(first, last + 1)])
        names = np.unique(self._log.landmarks[rows]).tolist()
        places = {name: self.landmark(name) for name in names}
        return self._windows.condensed(first, rows, poses, places)

    def _uncondense(self, poses: Sequence[int]) -> None:
        """Builds the whole graph, if one of these poses was given up."""
        if len(self._windows) and any(self._windows.of_pose(pose) != NONE for pose in poses):
            estimate = self.estimate()
            self._windows.clear(self.num_poses - 1)
            self._start_from(estimate)

    def _let_go(self) -> None:
        """Sightings that held firmly while the graph moved get their kernel."""
        if not self._firm:
            return
        firm, self._firm = self._firm, []
        self._isam.forget_waiting()
        self._isam.linearize_again(_SETTLING)
        for row in firm:
            self._isam.remove(self._slots.sightings, row)
            self._add_sighting(row)
        self._isam.update(relinearize=True)

    def _read_all(self) -> None:
        if self._last_updated >= 0:
            values = self._isam.values()
            self._poses.rows[values.poses] = values.map_T_bases
            for landmark, place in values.map_t_landmarks.items():
                if landmark in self._log:
                    self._move(landmark, place)
        for window in self._windows:
            followed = follow(self._poses.rows[window.first], window.condensed)
            self._poses.rows[window.first + 1 : window.last] = followed
        self._is_current = True

    def _start_from(self, estimate: GraphEstimate) -> None:
        """Builds the graph from the log, with everything here and nothing waiting."""
        self._poses.rows[: len(estimate.map_T_bases)] = estimate.map_T_bases
        for landmark, place in estimate.map_t_landmarks.items():
            if landmark in self._log:
                self._move(landmark, place)
        self._is_current = True
        self._rebuild()
        self._settled()

    def _settled(self) -> None:
        """Nothing waits any more."""
        self._isam.forget_waiting()
        self._firm = []
        self._last_updated = self.num_poses - 1
        self._covariances = self._new_covariances()

    def _rebuild(self) -> None:
        """A new iSAM2 over the whole log, at the last good estimate; by QR if it must be.

        Raises:
            GraphError: the log itself cannot be solved.
        """
        old = self._isam, self._slots
        for factorization in dict.fromkeys((old[0].factorization, "QR")):
            self._isam, self._slots = Incremental(factorization), _AllSlots()
            self._add_all()
            try:
                self._isam.update()
                self._isam.linearize_again(0 if self._is_current else _SETTLING)
                self._last_updated = self.num_poses - 1
                self._read_all()
            except UpdateError as error:
                failure = error
            else:
                return
        self._isam, self._slots = old
        self._isam.factorization = "QR"
        raise GraphError(f"the graph cannot be solved: {failure}") from failure

    def _add_all(self) -> None:
        """All that was ever added waits for an update, with the last good value of each."""
        self._isam.add(prior_factor(self._log.start), self._slots.prior, 0)
        for pose in range(1, self.num_poses):
            if self._windows.of_motion(pose) == NONE:
                self._add_motion(pose)
        for landmark in self._log.names():
            for row in self._live(self._log.rows(landmark)):
                self._add_sighting(row)
        self._windows.changed.update(range(len(self._windows)))
        self._add_windows()
        for pose, row in enumerate(self._poses.rows):
            if self._windows.of_pose(pose) == NONE:
                self._isam.insert_pose(pose, Pose2.from_array(row))
        for landmark, place in self._landmarks.items():
            self._isam.insert_landmark(landmark, place)


@dataclass(frozen=True, slots=True, eq=False)
class _AllSlots:
    """Where everything is in iSAM2."""

    prior: Slots = field(default_factory=Slots)
    motions: Slots = field(default_factory=Slots)
    sightings: Slots = field(default_factory=Slots)
    windows: Slots = field(default_factory=Slots)
