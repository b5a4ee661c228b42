"""The pose and landmark graph: what is added to it, made one and split."""

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import compress

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats
from semgraph.errors import GraphError
from semgraph.geometry import Pose2, UncertainPose2, wrap_angle
from semgraph.graph.drift import Drift
from semgraph.graph.factors import ROBUST_CHI2, Sighting, check_definite, check_sighting
from semgraph.graph.graph_covariances import GraphCovariances
from semgraph.graph.graph_log import Sighted
from semgraph.graph.graph_solver import JUMP_M, GraphSolver
from semgraph.graph.graph_states import GraphEstimate, Snapshot
from semgraph.graph.strays import Likeness, of_neighbours, strays, taken_for_each_other
from semgraph.graph.windows import NONE
from semgraph.measurement_model import misfits2


@dataclass(frozen=True, slots=True, eq=False)
class Checkpoint:
    """The graph at one moment, and what it cost."""

    cost: float
    snapshot: Snapshot


class FactorGraph:
    """Poses 0, 1, 2, ... joined by odometry, and the landmarks they sighted.

    Args:
        map_T_start: of pose 0.
        window_poses: so many poses are condensed into one factor once as many have followed;
            0 for none.

    Raises:
        GraphError: the start has no positive definite covariance.
    """

    def __init__(self, map_T_start: UncertainPose2, window_poses: int = 0) -> None:
        check_definite("start", map_T_start.covariance)
        self._solver = GraphSolver(map_T_start, window_poses)
        self._covariances = GraphCovariances(self._solver)

    @property
    def num_poses(self) -> int:
        """How many poses there are, the start included."""
        return self._solver.log.num_poses

    @property
    def is_updated(self) -> bool:
        """Whether nothing waits for an update."""
        return self._solver.isam.is_updated and not self._solver.windows.changed

    @property
    def is_long(self) -> bool:
        """Whether what takes time as long as the run takes too much of it."""
        return self._solver.is_long

    @property
    def incidents(self) -> Sequence[str]:
        """What went wrong in updates and how it was mended, one line each."""
        return tuple(self._solver.incidents)

    @property
    def glimpsed(self) -> Set[int]:
        """Landmarks that one sighting showed, a while ago: they hold nothing, and are not solved.

        In `near` they stay where they were seen, whatever was found out of the pose since.
        """
        return self._solver.windows.glimpsed

    def landmarks(self) -> tuple[int, ...]:
        """The landmarks in the graph."""
        return self._solver.log.names()

    def sightings(self, landmark: int) -> Sequence[Sighting]:
        """All sightings of a landmark."""
        return tuple(map(self._solver.log.sighting, self._solver.log.rows(landmark).tolist()))

    def sighted(self, landmark: int) -> Sighted:
        """The same as arrays."""
        return self._solver.log.sighted(landmark)

    def num_sightings(self, landmark: int) -> int:
        """How many there are of a landmark."""
        return len(self._solver.log.rows(landmark))

    def add_pose(self, motion: UncertainPose2, guess: Pose2) -> int:
        """The index of a new pose, reached from the last one by `motion`; it starts at `guess`.

        Raises:
            GraphError: the motion has no positive definite covariance.
        """
        check_definite("motion", motion.covariance)
        return self._solver.add_pose(motion, guess)

    def add_landmark(self, landmark: int, guess: FloatArray) -> None:
        """A new landmark near `guess` (2,); a sighting must follow before the next update.

        Raises:
            GraphError: it exists already.
            InputError: the guess is no finite point.
        """
        if landmark in self._solver.log:
            raise GraphError(f"landmark {landmark} is in the graph already")
        guess = frozen_floats(f"guess of landmark {landmark}", guess, (2,))
        self._solver.add_landmark(landmark, guess)

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
        if self._solver.windows.of_motion(sighting.pose) != NONE:
            raise GraphError(f"sighting from pose {sighting.pose}: that is condensed already")
        check_sighting(sighting)
        self._solver.add_sighting(sighting)

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
        self._solver.show([kept])
        if gone in self.glimpsed:
            self._solver.take_up(gone)
        rows = self._solver.log.rows(gone)
        if self.are_far_apart(gone, kept):
            self._solver.part.make_firm(self._solver.part.live(rows))
        self._solver.hand_over(rows, kept)
        self._solver.windows.hand_over(gone, kept)
        self._solver.forget(gone)

    def are_far_apart(self, gone: int, kept: int) -> bool:
        """Whether the kernel would let go as one of `kept` a sighting that it holds of `gone`."""
        rows = self._solver.log.rows(gone)
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
        rows = self._solver.log.rows(landmark)
        leaving = rows[np.isin(self._solver.log.tracks[rows], list(tracks))]
        if not 0 < len(leaving) < len(rows):
            raise GraphError(
                f"landmark {landmark}: {len(leaving)} of its {len(rows)} "
                "sightings are of the tracks to be split off, expected some but not all"
            )
        self.add_landmark(new, self.landmark(landmark))
        self._solver.hand_over(leaving, new)
        self._solver.windows.hand_over(landmark, new, tracks)

    def remove(self, landmark: int) -> None:
        """Takes a landmark and its sightings out with the next update.

        Raises:
            GraphError: it is not in the graph, or factors of it wait for an update.
        """
        self._check_known(landmark)
        self._check_updated(landmark)
        part = self._solver.part
        part.take_out(part.live(self._solver.log.rows(landmark)))
        windows, numbers = self._solver.windows, self._solver.windows.of(landmark)
        self._solver.forget(landmark)
        for number in numbers:
            if not self._solver.recondense(number):
                self._covariances.forget()
                return
        windows.forget(landmark)

    def weakest_link(self, since_pose: int) -> tuple[int, int]:
        """The pose after what holds least since a pose, and by how many landmarks it is held.

        That is the motion across which the fewest landmarks were sighted, and of those the least
        certain one.
        """
        covariances = self._solver.log.motion_covariances(slice(since_pose + 1, None))
        variances = covariances[:, 0, 0] + covariances[:, 1, 1]
        held = self._solver.log.num_across()[since_pose + 1 :]
        weakest = int(np.lexsort((-variances, held))[0])
        return since_pose + 1 + weakest, int(held[weakest])

    def gaps(self, held_by: int, within: int) -> list[tuple[int, int]]:
        """The last pose before each gap and the first one after it.

        That is where fewer landmarks than `held_by` are sighted both before and after, each within
        so many poses.
        """
        is_weak = self._solver.log.num_across(within) < held_by
        is_weak[0] = False
        edges = np.flatnonzero(np.diff([False, *is_weak, False]))
        return list(zip((edges[::2] - 1).tolist(), (edges[1::2] - 1).tolist(), strict=True))

    def sighted_from(self, first: int, last: int) -> set[int]:
        """The landmarks sighted from these poses."""
        log = self._solver.log
        return set(log.landmarks[log.rows_of_poses(first, last)].tolist())

    def cost(self) -> float:
        """Half the sum of all chi-squares, under the kernel; takes time as long as the run.

        Of what is condensed, only what comes to it by its ends and landmarks; nothing of what
        rests.
        """
        return self._solver.isam.cost()

    def checkpoint(self, landmarks: Sequence[int] | None = None) -> Checkpoint:
        """Where everything is now, to go back to if what comes next turns out wrong.

        Takes in what waits for an update.

        Args:
            landmarks: of which nothing must rest, for then costs could not be compared; None for
                all.
        """
        self._solver.wake(landmarks)
        snapshot = self._solver.snapshot()
        self._covariances.forget()
        return Checkpoint(self.cost(), snapshot)

    def go_back(self, checkpoint: Checkpoint) -> None:
        """Takes in what waits for an update, but everything is where it was then.

        What has been split again would else stay near where the wrong merge has brought it.
        """
        self._solver.go_back(checkpoint.snapshot)
        self._covariances.forget()

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
            if (self._solver.log.poses[self._solver.log.rows(landmark)] >= since_pose).all()
            else place
            for landmark, place in estimate.map_t_landmarks.items()
        }
        self._restart(GraphEstimate(poses, places))

    def polish(self) -> None:
        """Moves to the batch optimum over the whole log, starting from the estimate at hand.

        Takes in what waits for an update; after many merges at once that is quicker than `update`.
        Nothing is condensed any more.
        """
        self._solver.polish()
        self._covariances.forget()

    def optimize(self) -> None:
        """The same, with what is condensed as it is."""
        self._solver.optimize()
        self._covariances.forget()

    def hand_over_to_neighbours(
        self, likenesses: Mapping[int, Likeness], least_log_odds: float
    ) -> list[tuple[int, int, Sighted]]:
        """Sightings that a landmark beside theirs explains better become that one's.

        It takes them in with the next update; `polish` is quicker.

        Args:
            likenesses: of each landmark that is asked about.
            least_log_odds: how much better.

        Returns:
            from which landmark to which, and what.
        """
        log, estimate = self._solver.log, self.estimate()
        handed = self._swap(taken_for_each_other(log, estimate, likenesses, least_log_odds))
        owners = of_neighbours(log, estimate, likenesses, least_log_odds)
        rows = np.array(list(owners), dtype=np.int64)
        moves = np.column_stack([log.landmarks[rows], np.array(list(owners.values()), dtype=int)])
        for old, new in np.unique(moves, axis=0).tolist():
            some = rows[(moves == (old, new)).all(axis=1)]
            # From one pose a landmark is sighted once.
            some = some[np.unique(log.poses[some], return_index=True)[1]]
            some = some[~np.isin(log.poses[some], log.poses[log.rows(new)])]
            if len(some):
                handed.append((old, new, log.some(some)))
                self._solver.hand_over(some, new)
        return handed

    def _swap(self, pairs: Iterable[tuple[int, int]]) -> list[tuple[int, int, Sighted]]:
        """Rows of one pose, each of the other's landmark now; from which to which, and what."""
        log = self._solver.log
        swapped: list[tuple[int, int, Sighted]] = []
        gone = set[int]()
        for pair in pairs:
            if not gone.isdisjoint(pair):
                continue
            gone.update(pair)
            owners = log.landmarks[list(pair)].tolist()
            for row, old, new in zip(pair, owners, owners[::-1], strict=True):
                rows = np.array([row])
                swapped.append((old, new, log.some(rows)))
                self._solver.hand_over(rows, new)
        return swapped

    def leave_out_strays(self, landmarks: Set[int]) -> dict[int, Sighted]:
        """Takes out sightings of these landmarks that fit nothing, and moves to the optimum again.

        Returns:
            what was taken out, by landmark.
        """
        log = self._solver.log
        rows = strays(log, self.estimate(), landmarks)
        names = log.landmarks[rows]
        left_out = {name: log.some(rows[names == name]) for name in np.unique(names).tolist()}
        if len(rows):
            log.leave_out(rows)
            self.polish()
        return left_out

    def update(self, *, relinearize: bool = False) -> None:
        """Takes in all that was added since the last update.

        Args:
            relinearize: force it, after something old was seen again.

        A failure is named in `incidents`, and the graph rebuilt from its own log.
        """
        self._solver.update(relinearize=relinearize)
        self._covariances.forget()

    def settle(self) -> None:
        """Linearizes again until little moves: what one update after a great change leaves open."""
        self._solver.settle()
        self._covariances.forget()

    def knit(self) -> None:
        """Solves the whole graph if what was solved alone has moved off from what rests."""
        self._solver.knit()
        self._covariances.forget()

    def pose(self, index: int) -> Pose2:
        """map_T_base of one pose as of the last update."""
        return self._solver.pose(index)

    def poses(self, indices: IntArray) -> FloatArray:
        """(n, 3) map_T_base of some poses as of the last update."""
        return self._solver.poses(indices)

    def landmark(self, landmark: int) -> FloatArray:
        """map_t_landmark (2,) as of the last update; of what is newer, the guess."""
        return self._solver.landmark(landmark)

    def near(self, map_t_point: FloatArray, radius_m: float) -> dict[int, FloatArray]:
        """The landmarks within a radius of a point (2,), with their positions (2,)."""
        around = list(self._solver.last_read.places.around(map_t_point, radius_m + JUMP_M))
        places = np.array([self.landmark(landmark) for landmark in around]).reshape(-1, 2)
        is_near = np.hypot(*(places - map_t_point).T) <= radius_m
        return dict(zip(compress(around, is_near), places[is_near], strict=True))

    def estimate(self) -> GraphEstimate:
        """All poses and landmarks as of the last update; takes time as long as the run."""
        return self._solver.estimate()

    def landmark_covariance(self, landmarks: Sequence[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks, in map, in the order given."""
        return self._covariances.of_landmarks_together(landmarks)

    def covariance_around(self, landmarks: Sequence[int], around: Iterable[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks as if the last pose were known, in map.

        By what is not condensed and what else was sighted together with those `around`: what lies
        farther off could make it smaller, but it costs as much as the run is long. As it is where
        that does not connect them, or nothing is condensed.
        """
        return self._covariances.around(landmarks, around)

    def landmark_covariances(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2, 2) marginal covariance of each landmark, in map."""
        return self._covariances.of_landmarks(landmarks)

    def covariances_given_last_pose(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2, 2) of each landmark in the last pose's frame, as if that pose were known."""
        return self._covariances.given_last_pose(landmarks)

    def pose_covariance(self, index: int) -> FloatArray:
        """(3, 3) marginal covariance of a pose, (x, y, theta) in its own frame."""
        return self._covariances.of_pose(index)

    def drift(self) -> Drift:
        """How far what is seen from the last pose may be from where it was sighted before."""
        return self._covariances.drift()

    def pose_covariances(self, indices: Sequence[int]) -> FloatArray:
        """(n, 3, 3) marginal covariance of each pose, (x, y, theta) in its own frame."""
        return self._covariances.of_poses(indices)

    def chain_covariances(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3, 3) marginal covariance of each pose, and of each with the one after it.

        Each in its own frame; after the last pose there is none, the cross covariance is 0.
        """
        return self._covariances.of_chain()

    def _check_known(self, landmark: int) -> None:
        if landmark not in self._solver.log:
            raise GraphError(f"landmark {landmark} is not in the graph; add it first")

    def _check_updated(self, landmark: int) -> None:
        waiting = self._solver.part.waiting()
        if (self._solver.log.landmarks[waiting] == landmark).any():
            raise GraphError(f"landmark {landmark}: update the graph before it is taken out")

    def _misfits(self, rows: IntArray, place: FloatArray) -> FloatArray:
        """(k,) chi-squares of sightings, if their landmark were at a place (2,)."""
        log = self._solver.log
        return misfits2(
            self.poses(log.poses[rows]),
            np.tile(place, (len(rows), 1)),
            log.polar(rows),
            log.covariances(rows),
        )

    def _restart(self, estimate: GraphEstimate) -> None:
        self._solver.start_from(estimate)
        self._covariances.forget()
