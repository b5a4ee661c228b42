"""The log, iSAM2 and what is condensed, kept in step: updates, failures, and the batch.

iSAM2 is built from the log again when an update fails, since a failed update leaves it unusable.
After an update only what is asked for is read: reading everything would cost more than the update,
the longer the run the more. Poses that lie back are condensed, window by window; in a long run
windows that lie far off rest.
"""

import itertools
from collections.abc import Iterable, Sequence
from typing import Final, final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.geometry import Pose2, UncertainPose2, transform_points
from semgraph.graph.condensation import Condensed, follow
from semgraph.graph.factors import Hold, Sighting
from semgraph.graph.graph_log import GraphLog
from semgraph.graph.graph_states import GraphEstimate, Snapshot
from semgraph.graph.incremental import Incremental, UpdateError, Values
from semgraph.graph.last_read import LastRead
from semgraph.graph.resting import Resting
from semgraph.graph.solved_part import InIsam, SolvedPart
from semgraph.graph.window_ends import WindowEnds
from semgraph.graph.windows import NONE, Window, Windows
from semgraph.landmarks import cartesian

# By so much the last pose may jump before all that was read of the graph is stale.
JUMP_M: Final = 0.5
# From so many windows on those far off rest.
_LONG_WINDOWS: Final = 100
# Of so many that are awake, what takes time as long as all of them is left out.
_MANY_WINDOWS: Final = 200
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
        resting: what of that is not solved at the moment.
        ends: how sure the ends of windows are.
        last_read: where all is.
        part: what is in iSAM2.
        incidents: what went wrong and was mended, one line each.
    """

    def __init__(self, map_T_start: UncertainPose2, window_poses: int) -> None:
        self.log = GraphLog(map_T_start)
        self.windows = Windows(self.log, window_poses)
        self.resting, self.ends = Resting(self.log, self.windows), WindowEnds()
        self.last_read = LastRead(map_T_start.pose)
        self.part = SolvedPart(self.log, self.windows, self.resting, self.last_read)
        self.incidents: list[str] = []
        self._last_updated = -1
        self._num_failures = 0
        # Whether something became one with what rests, since was chosen what does.
        self._is_stale = False

    @property
    def isam(self) -> Incremental:
        """All that does not rest, what is condensed of it included."""
        return self.part.now.isam

    @property
    def last(self) -> int:
        """The newest pose."""
        return self.log.num_poses - 1

    @property
    def is_long(self) -> bool:
        """Whether what takes time as long as what is solved takes too much of it."""
        return len(self.resting.numbers()) >= _MANY_WINDOWS

    def add_pose(self, motion: UncertainPose2, guess: Pose2) -> int:
        """Its number."""
        index = self.log.add_motion(motion)
        self.last_read.add_pose(guess)
        self.isam.insert_pose(index, guess)
        self.part.add_motions([index])
        return index

    def add_landmark(self, landmark: int, guess: FloatArray) -> None:
        """One more, near (2,)."""
        self.log.add_landmark(landmark)
        self.last_read.put(landmark, guess)
        self.isam.insert_landmark(landmark, guess)

    def forget(self, landmark: int) -> None:
        """It is no more."""
        self.log.forget(landmark)
        self.last_read.forget(landmark)

    def add_sighting(self, sighting: Sighting) -> None:
        """With the next update it is."""
        self.show([sighting.landmark])
        row = self.log.add_sighting(sighting)
        self._is_stale |= self._rests(sighting.landmark)
        self.part.add_sighting(row, sighting)

    def is_solved(self, landmark: int) -> bool:
        """Whether nothing that was sighted of it rests."""
        return self.resting.awake is None or (
            landmark not in self.resting.held and self.isam.has_landmark(landmark)
        )

    def _rests(self, landmark: int) -> bool:
        """Whether it is not solved, though it was sighted before what is not condensed."""
        return (
            self.resting.awake is not None
            and not self.isam.has_landmark(landmark)
            and self.log.poses[self.log.first_row(landmark)] <= self.resting.since
            and self.resting.awake.isdisjoint(self.windows.of(landmark))
        )

    def show(self, landmarks: Iterable[int]) -> None:
        """With the next update those of these that were glimpsed are in the graph as all others."""
        for landmark in self.windows.glimpsed.intersection(landmarks):
            # Where a window cannot be condensed anew none is, and nothing is glimpsed any more.
            if landmark in self.windows.glimpsed and self.take_up(landmark):
                self.isam.insert_landmark(landmark, self.last_read.landmark(landmark))

    def take_up(self, glimpsed: int) -> bool:
        """With the next update what showed this landmark is in its window, and asks where it is.

        Returns:
            whether that window neither rests nor is no more.
        """
        row = self.log.first_row(glimpsed)
        number = self.windows.of_motion(int(self.log.poses[row]))
        (place,) = self._places(np.array([row]), self.poses(self.log.poses[[row]]))
        self.last_read.put(glimpsed, place)
        self.windows.glimpsed.discard(glimpsed)
        is_awake = self.resting.awake is None or number in self.resting.awake
        return self.recondense(number) and is_awake

    def recondense(self, number: int) -> bool:
        """Whether that window can be condensed anew; if not none is any more."""
        window = self.windows[number]
        try:
            rows = self.windows.rows(number)
            self.windows.replace(number, *self.condense(window.first, window.last, rows))
        except GraphError as error:
            self.incidents.append(f"nothing is condensed any more: {error}")
            self.uncondense()
            return False
        return True

    def _places(self, rows: IntArray, map_T_bases: FloatArray) -> FloatArray:
        """(k, 2) of sightings, from poses (k, 3)."""
        return transform_points(map_T_bases, cartesian(*self.log.polar(rows).T))

    def hand_over(self, rows: IntArray, landmark: int) -> None:
        """With the next update these are sightings of another landmark."""
        names = [*np.unique(self.log.landmarks[rows]).tolist(), landmark]
        old = [name for name in names if len(self.log.rows(name))]
        self._is_stale |= not all(map(self.is_solved, old))
        self.log.hand_over(rows, landmark)
        self.part.renew(self.part.live(rows))

    def update(self, *, relinearize: bool = False) -> None:
        """Takes in all that was added since the last update.

        Args:
            relinearize: force it, after something old was seen again.

        A failure is named in `incidents`, and the graph rebuilt from its own log.
        """
        try:
            if not relinearize:
                self._condense_next()
            is_left = len(self.windows) >= _LONG_WINDOWS and self.resting.is_left(
                self.last_read.last_position()
            )
            if self._is_stale or (is_left and not relinearize):
                if self.knit():
                    return
                self._choose()
            self.part.add_windows()
            self.isam.update(relinearize=relinearize)
            self._let_go()
            self._moved_on()
        except UpdateError as error:
            self._mend(error)
        self._settled()

    def _moved_on(self) -> None:
        """Nothing that was read is current; all is read where the last pose has jumped."""
        if self.last_read.move_on(self.isam.pose(self.last)) > JUMP_M:
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
        try:
            self.isam.linearize_again(_SETTLING, everywhere=not self.is_long)
            self._moved_on()
            if not (self.is_long or self.last_read.is_current):
                self._read_all()
        except UpdateError as error:
            self._mend(error)

    def polish(self) -> None:
        """Moves to the batch optimum over the whole log, starting from the estimate at hand.

        Takes in what waits for an update; after many merges at once that is quicker than `update`.
        Nothing is condensed any more.
        """
        self.estimate()
        self._wake()
        self.windows.clear(self.last)
        self.optimize()

    def optimize(self) -> None:
        """The same, with what is condensed as it is, and what rests."""
        kept = self.part.now
        try:
            self._go_to_optimum()
            self.isam.update()
            self._settled()
        except UpdateError as error:
            self.part.now = kept
            self._mend(error)

    def _go_to_optimum(self) -> None:
        """All that does not rest is there, and waits to be solved step by step.

        Raises:
            GraphError: it cannot be solved; all is as it was.
        """
        self._make_current()
        kept = self.part.now
        try:
            self.part.begin_anew()
            self._take(self.isam.go_to_optimum())
        except GraphError:
            self.part.now = kept
            raise

    def pose(self, index: int) -> Pose2:
        """map_T_base of one pose as of the last update."""
        if self.windows.of_pose(index) != NONE:
            return Pose2.from_array(self.poses(np.array([index]))[0])
        if self.resting.awake is None or self.isam.has_pose(index):
            return self.isam.pose(index)
        return self.last_read.pose(index)

    def poses(self, indices: IntArray) -> FloatArray:
        """(n, 3) of some; those of one window after each other take little more than one."""
        found = np.empty((len(indices), 3))
        numbers = [self.windows.of_pose(index) for index in indices.tolist()]
        for number, places in itertools.groupby(range(len(indices)), numbers.__getitem__):
            rows = list(places)
            if number == NONE:
                found[rows] = [self.pose(k).as_array() for k in indices[rows].tolist()]
                continue
            window = self.windows[number]
            first = self.pose(window.first).as_array()
            found[rows] = follow(first, window.condensed, indices[rows] - window.first - 1)
        return found

    def landmark(self, landmark: int) -> FloatArray:
        """map_t_landmark (2,) as of the last update; of what is newer, the guess."""
        return self.last_read.read_landmark(landmark, self.isam)

    def estimate(self) -> GraphEstimate:
        """All poses and landmarks as of the last update; takes time as long as the run."""
        self._make_current()
        glimpsed = sorted(self.windows.glimpsed)
        rows = np.array([self.log.first_row(each) for each in glimpsed], dtype=np.int64)
        places = self._places(rows, self.last_read.poses(self.log.poses[rows]))
        for landmark, place in zip(glimpsed, places, strict=True):
            self.last_read.put(landmark, place)
        return self.last_read.estimate()

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
            self.part.now.slots.copy(),
            self.log.landmarks.copy(),
            len(self.windows),
            frozenset(self.windows.glimpsed),
            self.resting.num_choices,
        )

    def go_back(self, snapshot: Snapshot) -> None:
        """Takes in what waits, but everything is where it was then.

        The same sightings of the same landmarks are the same graph; else it is built anew.
        """
        is_same = (
            len(snapshot.estimate.map_T_bases) == self.log.num_poses
            and np.array_equal(snapshot.landmarks, self.log.landmarks)
            and snapshot.num_windows == len(self.windows)
            and snapshot.glimpsed == self.windows.glimpsed
            and snapshot.num_choices == self.resting.num_choices
        )
        if not is_same:
            self.start_from(snapshot.estimate)
            return
        self.part.now = InIsam(snapshot.isam.copy(), snapshot.slots.copy())
        self.windows.changed.clear()
        self._settled()
        self._read_all()

    def uncondense(self) -> None:
        """Builds the whole graph; what there is as yet is not condensed again."""
        estimate = self.estimate()
        self._wake()
        self.windows.clear(self.last)
        self.start_from(estimate)

    def start_from(self, estimate: GraphEstimate) -> None:
        """Builds the graph from the log, with everything here and nothing waiting."""
        self.last_read.start_from(estimate)
        self.rebuild()

    def rebuild(self) -> None:
        """A new iSAM2 over all that does not rest, at the last good estimate; by QR if it must be.

        Raises:
            GraphError: the log itself cannot be solved.
        """
        old = self.part.now
        for factorization in dict.fromkeys((old.isam.factorization, "QR")):
            self.part.begin_anew(factorization)
            try:
                self.isam.update()
                self._let_go()
                steps = 0 if self.last_read.is_current else _SETTLING
                self.isam.linearize_again(steps, everywhere=not self.is_long)
                self._last_updated = self.last
                self._read_all()
            except UpdateError as error:
                failure = error
            else:
                self._settled()
                return
        self.part.now = old
        self.isam.factorization = "QR"
        raise GraphError(f"the graph cannot be solved: {failure}") from failure

    def wake(self, landmarks: Sequence[int] | None = None) -> None:
        """Nothing that was sighted of some landmarks rests, None for all; rather all than less."""
        if landmarks is not None and not all(map(self.is_solved, landmarks)):
            self._bring(landmarks)
            landmarks = landmarks if all(map(self.is_solved, landmarks)) else None
        if landmarks is None and self.resting.awake is not None:
            self._wake()
            self.rebuild()

    def bring(self, landmarks: Sequence[int]) -> bool:
        """Whether some landmarks rested, that are solved from now on, though maybe held."""
        if self.resting.awake is None or all(map(self.isam.has_landmark, landmarks)):
            return False
        self._bring(landmarks)
        if not all(map(self.isam.has_landmark, landmarks)):
            self.wake()
        return True

    def _bring(self, landmarks: Sequence[int]) -> None:
        """Chooses anew what is awake, with all windows that sighted these landmarks."""
        self.resting.ask(np.array([self.last_read.landmark(each) for each in landmarks]))
        self._choose(landmarks)
        self.update(relinearize=True)

    def knit(self) -> bool:
        """Solves the whole graph if what was solved alone has moved off from what rests.

        After it nothing waits, and as much rests as before: far off all is believed as unsure as it
        was.

        Returns:
            whether it had.
        """
        if self.resting.awake is None or not self.part.is_torn():
            return False
        self._wake()
        try:
            self._go_to_optimum()
        except GraphError as error:
            self.incidents.append(f"the whole is solved step by step: {error}")
            self.rebuild()
        self.update()
        return True

    def _wake(self) -> None:
        """With the next graph that is built nothing rests."""
        if self.resting.awake is not None:
            self._make_current()
            self.resting.wake()
            self.part.hold([Hold(0, self.log.start)])

    def _choose(self, landmarks: Iterable[int] = ()) -> None:
        """Lets rest what is far off, and builds the graph of all others, to be updated.

        Args:
            landmarks: that do not rest, wherever they are.
        """
        self._make_current()
        before = set(self.resting.ends())
        self.resting.choose(self.last_read.last_position(), self.last_read.places, landmarks)
        leaving = before.difference(self.resting.ends())
        self.incidents += self.ends.solve(leaving.union(self.resting.rims()), self.isam)
        try:
            self.part.hold(
                self.resting.holds(self.last_read.pose, self.landmark, self.ends.covariances)
            )
        except GraphError as error:
            self.incidents.append(f"nothing rests: {error}")
            self._wake()
        self._is_stale = False
        self.part.begin_anew()

    def _condense_next(self) -> None:
        """Takes one window of poses out with the next update, and its factor in."""
        found = self.windows.next(self._last_updated)
        if found is None:
            return
        first, last = found
        rows = self.log.rows_of_poses(first + 1, last)
        if not self.part.is_in(rows):
            return
        is_glimpse = self.windows.glimpses(rows)
        try:
            names, condensed = self.condense(first, last, rows[~is_glimpse])
        except GraphError as error:
            self.incidents.append(f"poses {first} to {last} are not condensed: {error}")
            self.windows.skip(last)
            return
        self.part.take_out_motions(range(first + 1, last + 1))
        self.part.take_out(rows.tolist())
        window = Window(first, last, names[:, 1], names[:, 0], condensed)
        number = self.windows.add(window)
        self.windows.glimpsed.update(self.log.landmarks[rows[is_glimpse]].tolist())
        self.ends.keep(last, self.pose)
        if self.resting.awake is not None:
            self.resting.awake.add(number)

    def _let_go(self) -> None:
        """Sightings that held firmly while the graph moved get their kernel."""
        firm = self.part.let_go()
        if not firm:
            return
        self.isam.forget_waiting()
        self.isam.linearize_again(_SETTLING, everywhere=not self.is_long)
        self.part.renew(firm)
        self.isam.update(relinearize=True)

    def _read_all(self) -> None:
        """All variables, poses that were given up included."""
        if self._last_updated >= 0:
            self._take(self.isam.values())
        self.last_read.is_current = True

    def _make_current(self) -> None:
        """All that was read is as of the last update."""
        if not self.last_read.is_current:
            self._read_all()

    def _take(self, values: Values) -> None:
        """Everything is there."""
        self.last_read.take(values, self.windows, self.resting.numbers())

    def _settled(self) -> None:
        """Nothing waits any more."""
        self.isam.forget_waiting()
        self.part.let_go()
        self._last_updated = self.last
