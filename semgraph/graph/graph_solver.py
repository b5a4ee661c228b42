"""The log, iSAM2 and what is condensed, kept in step: updates, failures, and the batch.

iSAM2 is built from the log again when an update fails, since a failed update leaves it unusable.
After an update only what is asked for is read: reading everything would cost more than the update,
the longer the run the more. Poses that lie back are condensed, window by window.
"""

import itertools
from typing import Final, final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.condensation import Condensed, follow
from semgraph.graph.factors import (
    Sighting,
    condensed_factor,
    motion_factor,
    prior_factor,
    sighting_factor,
)
from semgraph.graph.graph_log import GraphLog
from semgraph.graph.graph_states import AllSlots, GraphEstimate, Snapshot
from semgraph.graph.growing import Growing
from semgraph.graph.incremental import Front, Incremental, UpdateError, Values
from semgraph.graph.windows import NONE, Window, Windows
from semgraph.point_grid import PointGrid

# Cells of the places of landmarks; about as far as things are seen.
_CELL_M: Final = 10.0
# By so much the last pose may jump before all that was read of the graph is stale.
JUMP_M: Final = 0.5
# Around the last pose, how far and at most how many landmarks are kept at the Bayes tree's root.
_FRONT_M: Final = 20.0
_FRONT_LANDMARKS: Final = 80
# In a shorter run paths are short, and iSAM2's own order costs less.
_LONG_WINDOWS: Final = 200
# How often a graph that moves much is linearized again at most: it ends where nothing moves far.
_SETTLING: Final = 25
# After so many failed updates by Cholesky the rest is done by QR.
_FAILURES: Final = 3


@final
class GraphSolver:
    """A graph that is solved step by step.

    Attributes:
        log: all that was added.
        windows: what of it is condensed.
        isam: the rest, and the condensed.
        slots: where all of it is in there.
        firm: rows of sightings that hold without their kernel in the next update.
        places: of landmarks, as they were last read.
        incidents: what went wrong and was mended, one line each.
    """

    def __init__(self, map_T_start: UncertainPose2, window_poses: int) -> None:
        self.log = GraphLog(map_T_start)
        self.windows = Windows(self.log, window_poses)
        self.isam = Incremental()
        self.slots = AllSlots()
        self.firm: list[int] = []
        self.places = PointGrid(_CELL_M)
        self.incidents: list[str] = []
        # Of each variable the last that was read; of what was not read as yet, its first guess.
        self._poses, self._landmarks = Growing((3,)), dict[int, FloatArray]()
        self._is_current = False
        self._are_current = set[int]()
        self._last_updated = -1
        self._num_failures = 0
        self._front_at = map_T_start.pose.as_array()[:2]
        self._poses.append(map_T_start.pose.as_array())
        self.isam.add(prior_factor(map_T_start), self.slots.prior, 0)
        self.isam.insert_pose(0, map_T_start.pose)

    @property
    def last(self) -> int:
        """The newest pose."""
        return self.log.num_poses - 1

    @property
    def is_long(self) -> bool:
        """Whether what takes time as long as the run takes too much of it."""
        return len(self.windows) >= _LONG_WINDOWS

    def add_pose(self, motion: UncertainPose2, guess: Pose2) -> int:
        """Its number."""
        index = self.log.add_motion(motion)
        self._poses.append(guess.as_array())
        self.isam.insert_pose(index, guess)
        self.add_motion(index)
        return index

    def add_landmark(self, landmark: int, guess: FloatArray) -> None:
        """One more, near (2,)."""
        self.log.add_landmark(landmark)
        self.move(landmark, guess)
        self.isam.insert_landmark(landmark, guess)

    def forget(self, landmark: int) -> None:
        """It is no more."""
        self.log.forget(landmark)
        del self._landmarks[landmark]
        self._are_current.discard(landmark)
        self.places.remove(landmark)

    def add_motion(self, pose: int) -> None:
        """With the next update the motion to a pose is in the graph."""
        factor = motion_factor(
            pose - 1, pose, self.log.motions[pose], self.log.motion_covariances[pose]
        )
        self.isam.add(factor, self.slots.motions, pose)

    def add_sighting(self, row: int, sighting: Sighting) -> None:
        """With the next update the sighting of a row of the log is."""
        factor = sighting_factor(sighting, is_firm=row in self.firm)
        self.isam.add(factor, self.slots.sightings, row)

    def live(self, rows: IntArray) -> list[int]:
        """The sightings that are factors of their own."""
        poses = self.log.poses[rows].tolist()
        return [
            row
            for row, pose in zip(rows.tolist(), poses, strict=True)
            if self.windows.of_motion(pose) == NONE
        ]

    def hand_over(self, rows: IntArray, landmark: int) -> None:
        """With the next update these are sightings of another landmark."""
        self.log.hand_over(rows, landmark)
        for row in self.live(rows):
            self.isam.remove(self.slots.sightings, row)
            self.add_sighting(row, self.log.sighting(row))

    def update(self, *, relinearize: bool = False) -> None:
        """Takes in all that was added since the last update.

        Args:
            relinearize: force it, after something old was seen again.

        A failure is named in `incidents`, and the graph rebuilt from its own log.
        """
        before = self._poses.rows[self.last].copy()
        try:
            if not relinearize:
                self._condense_next()
            self.add_windows()
            self.isam.update(self._front(), relinearize=relinearize)
            self._let_go()
            self._moved_on(before)
        except UpdateError as error:
            self._mend(error)
        self._settled()

    def _moved_on(self, before: FloatArray) -> None:
        """Nothing that was read is current; all is read where the last pose (3,) has jumped."""
        self._is_current = False
        self._are_current.clear()
        self._poses.rows[self.last] = self.isam.pose(self.last).as_array()
        if np.hypot(*(self._poses.rows[self.last] - before)[:2]) > JUMP_M:
            self._read_all()

    def _mend(self, error: UpdateError) -> None:
        """The graph from its own log; what failed several times would go on to fail."""
        self._num_failures += 1
        by = ""
        if self._num_failures == _FAILURES and self.isam.factorization != "QR":
            self.isam.factorization, by = "QR", ", by QR from now on"
        self.incidents.append(f"update failed, graph rebuilt{by}: {error}")
        self.rebuild()

    def settle(self) -> None:
        """Linearizes again until little moves: what one update after a great change leaves open."""
        self.update(relinearize=True)
        before = self._poses.rows[self.last].copy()
        try:
            self.isam.linearize_again(_SETTLING, everywhere=not self.is_long)
            self._moved_on(before)
            if not (self.is_long or self._is_current):
                self._read_all()
        except UpdateError as error:
            self._mend(error)

    def polish(self) -> None:
        """Moves to the batch optimum over the whole log, starting from the estimate at hand.

        Takes in what waits for an update; after many merges at once that is quicker than `update`.
        Nothing is condensed any more.
        """
        self.estimate()
        self.windows.clear(self.last)
        self.optimize()

    def optimize(self) -> None:
        """The same, with what is condensed as it is."""
        self.estimate()
        kept = self.isam, self.slots
        self.isam, self.slots = Incremental(self.isam.factorization), AllSlots()
        try:
            self._add_all()
            self._take(self.isam.go_to_optimum())
            self._are_current.clear()
            self.isam.update()
            self._settled()
        except UpdateError:
            self.rebuild()
        except GraphError:
            self.isam, self.slots = kept
            raise

    def pose(self, index: int) -> Pose2:
        """map_T_base of one pose as of the last update."""
        if self.windows.of_pose(index) == NONE:
            return self.isam.pose(index)
        return Pose2.from_array(self.poses(np.array([index]))[0])

    def poses(self, indices: IntArray) -> FloatArray:
        """(n, 3) of some; those of one window after each other take little more than one."""
        found = np.empty((len(indices), 3))
        numbers = [self.windows.of_pose(index) for index in indices.tolist()]
        for number, places in itertools.groupby(range(len(indices)), numbers.__getitem__):
            rows = list(places)
            if number == NONE:
                found[rows] = [self.isam.pose(k).as_array() for k in indices[rows].tolist()]
                continue
            window = self.windows[number]
            first = self.isam.pose(window.first).as_array()
            found[rows] = follow(first, window.condensed, indices[rows] - window.first - 1)
        return found

    def landmark(self, landmark: int) -> FloatArray:
        """map_t_landmark (2,) as of the last update; of what is newer, the guess."""
        if landmark not in self._are_current and self.isam.has_landmark(landmark):
            self.move(landmark, self.isam.landmark(landmark))
            self._are_current.add(landmark)
        return self._landmarks[landmark]

    def estimate(self) -> GraphEstimate:
        """All poses and landmarks as of the last update; takes time as long as the run."""
        if not self._is_current:
            self._read_all()
        return GraphEstimate(self._poses.rows.copy(), dict(self._landmarks))

    def condense(self, first: int, last: int, rows: IntArray) -> tuple[IntArray, Condensed]:
        """Landmark and track of each thing in a stretch, and what it says where all is now."""
        poses = self.poses(np.arange(first, last + 1))
        names = np.unique(self.log.landmarks[rows]).tolist()
        places = {name: self.landmark(name) for name in names}
        return self.windows.condensed(first, rows, poses, places)

    def snapshot(self) -> Snapshot:
        """The graph as it is, after an update if something waits."""
        if not self.isam.is_updated or self.windows.changed:
            self.update()
        return Snapshot(
            self.estimate(),
            self.isam.copy(),
            self.slots.copy(),
            self.log.landmarks.copy(),
            len(self.windows),
        )

    def go_back(self, snapshot: Snapshot) -> None:
        """Takes in what waits, but everything is where it was then.

        The same sightings of the same landmarks are the same graph; else it is built anew.
        """
        is_same = (
            len(snapshot.estimate.map_T_bases) == self.log.num_poses
            and np.array_equal(snapshot.landmarks, self.log.landmarks)
            and snapshot.num_windows == len(self.windows)
        )
        if not is_same:
            self.start_from(snapshot.estimate)
            return
        self.isam, self.slots = snapshot.isam.copy(), snapshot.slots.copy()
        self.windows.changed.clear()
        self._settled()
        self._read_all()

    def uncondense(self) -> None:
        """Builds the whole graph; what there is as yet is not condensed again."""
        estimate = self.estimate()
        self.windows.clear(self.last)
        self.start_from(estimate)

    def start_from(self, estimate: GraphEstimate) -> None:
        """Builds the graph from the log, with everything here and nothing waiting."""
        self._poses.rows[: len(estimate.map_T_bases)] = estimate.map_T_bases
        self._are_current.clear()
        for landmark, place in estimate.map_t_landmarks.items():
            if landmark in self.log:
                self.move(landmark, place)
        self._is_current = True
        self.rebuild()

    def rebuild(self) -> None:
        """A new iSAM2 over the whole log, at the last good estimate; by QR if it must be.

        Raises:
            GraphError: the log itself cannot be solved.
        """
        old = self.isam, self.slots
        for factorization in dict.fromkeys((old[0].factorization, "QR")):
            self.isam, self.slots = Incremental(factorization), AllSlots()
            self._add_all()
            try:
                self.isam.update()
                steps = 0 if self._is_current else _SETTLING
                self.isam.linearize_again(steps, everywhere=not self.is_long)
                self._last_updated = self.last
                self._read_all()
            except UpdateError as error:
                failure = error
            else:
                self._settled()
                return
        self.isam, self.slots = old
        self.isam.factorization = "QR"
        raise GraphError(f"the graph cannot be solved: {failure}") from failure

    def move(self, landmark: int, place: FloatArray) -> None:
        """It was read to be there."""
        self._landmarks[landmark] = place
        self.places.put(landmark, place)

    def _front(self) -> Front | None:
        """What is around the last pose; anew every so often. None in a short run.

        The next sightings are of that. Left to itself iSAM2 keeps only what was just sighted at the
        root; the rest of a long run's surroundings is deep down, on long paths.
        """
        if not self.is_long:
            return None
        here = self._poses.rows[self.last, :2].copy()
        is_new = bool(np.hypot(*(here - self._front_at)) > 0.5 * _FRONT_M)
        if is_new:
            self._front_at = here
        around = self.places.around(here, _FRONT_M)
        if len(around) > _FRONT_LANDMARKS:
            off = np.array([self._landmarks[each] for each in around]) - here
            nearest = np.argsort(np.hypot(*off.T), kind="stable")[:_FRONT_LANDMARKS]
            around = [around[k] for k in nearest.tolist()]
        sighted = self.log.landmarks[self.log.rows_of_poses(self.windows.end + 1, self.last)]
        landmarks = sorted({*around, *sighted.tolist()})
        return Front(range(self.windows.end, self.last + 1), landmarks, is_new)

    def _condense_next(self) -> None:
        """Takes one window of poses out with the next update, and its factor in."""
        found = self.windows.next(self._last_updated)
        if found is None:
            return
        first, last = found
        motions, rows = range(first + 1, last + 1), self.log.rows_of_poses(first + 1, last)
        if any(self.slots.sightings[row] == NONE for row in rows.tolist()):
            return
        try:
            names, condensed = self.condense(first, last, rows)
        except GraphError as error:
            self.incidents.append(f"poses {first} to {last} are not condensed: {error}")
            self.windows.skip(last)
            return
        for pose in motions:
            self.isam.remove(self.slots.motions, pose)
        for row in rows.tolist():
            self.isam.remove(self.slots.sightings, row)
        window = Window(first, last, rows.astype(np.int32), names[:, 1], names[:, 0], condensed)
        self.windows.add(window)

    def add_windows(self) -> None:
        """Those that are new or changed."""
        for number in sorted(self.windows.changed):
            if self.slots.windows[number] != NONE:
                self.isam.remove(self.slots.windows, number)
            window = self.windows[number]
            factor = condensed_factor(window.condensed, window.first, window.last, window.landmarks)
            self.isam.add(factor, self.slots.windows, number)
        self.windows.changed.clear()

    def _let_go(self) -> None:
        """Sightings that held firmly while the graph moved get their kernel."""
        if not self.firm:
            return
        firm, self.firm = self.firm, []
        self.isam.forget_waiting()
        self.isam.linearize_again(_SETTLING, everywhere=not self.is_long)
        for row in firm:
            self.isam.remove(self.slots.sightings, row)
            self.add_sighting(row, self.log.sighting(row))
        self.isam.update(relinearize=True)

    def _read_all(self) -> None:
        """All variables, poses that were given up included."""
        if self._last_updated >= 0:
            self._take(self.isam.values())
        self._is_current = True

    def _take(self, values: Values) -> None:
        """Everything is there."""
        self._poses.rows[values.poses] = values.map_T_bases
        for landmark, place in values.map_t_landmarks.items():
            if landmark in self.log:
                self.move(landmark, place)
        for window in self.windows:
            followed = follow(self._poses.rows[window.first], window.condensed)
            self._poses.rows[window.first + 1 : window.last] = followed

    def _settled(self) -> None:
        """Nothing waits any more."""
        self.isam.forget_waiting()
        self.firm = []
        self._last_updated = self.last

    def _add_all(self) -> None:
        """All that was ever added waits for an update, with the last good value of each."""
        self.isam.add(prior_factor(self.log.start), self.slots.prior, 0)
        for pose in range(1, self.log.num_poses):
            if self.windows.of_motion(pose) == NONE:
                self.add_motion(pose)
        for landmark in self.log.names():
            for row in self.live(self.log.rows(landmark)):
                self.add_sighting(row, self.log.sighting(row))
        self.windows.changed.update(range(len(self.windows)))
        self.add_windows()
        for pose, row in enumerate(self._poses.rows):
            if self.windows.of_pose(pose) == NONE:
                self.isam.insert_pose(pose, Pose2.from_array(row))
        for landmark, place in self._landmarks.items():
            self.isam.insert_landmark(landmark, place)
