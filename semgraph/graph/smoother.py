"""The graph beside the fast estimator: sightings in, smoothed trajectory and map out.

A fast estimator with a short memory follows each object while it is in sight; such a stretch is a
*track*, and each track starts as a landmark of its own. Whether it is an older landmark seen again
is decided by the graph's own uncertainty, and then both become one; if what comes later speaks
against that, they are two again. What moves is taken out; what is not seen often enough stays
tentative, out of the map; what is no longer seen where it should be is gone.
"""

import gc
from array import array
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import FloatArray, IntArray
from semgraph.decisions import Decision, DecisionLog, What
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.absence import Look, count_misses
from semgraph.graph.existence import Tally
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.graph.graph_log import Sighted
from semgraph.graph.growing import Ragged
from semgraph.graph.keyframes import Keyframes
from semgraph.graph.landmark_registry import LandmarkRegistry
from semgraph.graph.merging import Merging
from semgraph.graph.strays import Likeness
from semgraph.graph.tracks import Track
from semgraph.landmarks import Gone, Kind, Landmark, Perceptions
from semgraph.measurement_model import CHI2_2DOF_999, mahalanobis2
from sensors.views import View


class SmootherSettings(BaseModel):
    """Settings of the graph."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    start_sigma_m: float = Field(1e-3, gt=0.0)
    start_sigma_rad: float = Field(1e-4, gt=0.0)
    min_sightings: int = Field(3, ge=1)
    least_seconds: float = Field(0.85, ge=0.0)
    update_every_scans: int = Field(5, ge=1)
    closure_odds: float = Field(100.0, gt=1.0)
    duplicate_odds: float = Field(10.0, gt=1.0)
    in_sight_scans: int = Field(10, ge=0)
    window_scans: int = Field(40, ge=0)

    def start(self, map_T_start: Pose2) -> UncertainPose2:
        """Where the run starts, as surely as the settings say."""
        sigmas = np.array([self.start_sigma_m, self.start_sigma_m, self.start_sigma_rad])
        return UncertainPose2(map_T_start, np.diag(sigmas**2))


# What a run keeps is no garbage: after 80,000 scans each look through all of it took 0.37 s.
_KEPT_SCANS: Final = 500
# Among fewer things nobody can tell whether the robot or the thing moves.
_LEAST_TO_JUDGE: Final = 3
# Of two neighbours a sighting is of the one that explains it better, by however little: which of
# them a track was on before says nothing of where it slipped.
_BETTER_LOG_ODDS: Final = 0.0
# How often what a neighbour explains better is looked for at the end; nearly all is found at first.
_HAND_OVERS: Final = 3


class Smoother:
    """Builds the graph scan by scan."""

    def __init__(self, settings: SmootherSettings, map_T_start: Pose2) -> None:
        self._settings = settings
        self._graph = FactorGraph(settings.start(map_T_start), settings.window_scans)
        self._keyframes = Keyframes()
        self._registry = LandmarkRegistry()
        self._moving: list[Track] = []
        self._looks = {kind: Tally() for kind in Kind}
        self._reliabilities = dict.fromkeys(Kind, (0, 0.0))
        self._stamps_ns = array("q")
        self._tracker_ids = Ragged()
        # By scan, of tracks whose sightings were of something else: of which track's landmark.
        self._instead: dict[int, dict[int, int]] = {}
        self._last_fast: Pose2 | None = None
        self._guess = map_T_start
        self._decided = DecisionLog()
        self._merging = Merging(
            self._graph,
            self._registry,
            self._decided,
            settings.closure_odds,
            settings.duplicate_odds,
        )

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """What was decided of landmarks, in order."""
        return self._decided.all()

    @property
    def events(self) -> tuple[str, ...]:
        """What was decided, and what went wrong and was mended, one line each."""
        return (*map(str, self._decided.all()), *self._graph.incidents)

    def add(self, step: FastStep, perceptions: Perceptions, views: Sequence[View]) -> None:
        """Takes in one scan of the fast estimator.

        Args:
            step: of the fast estimator.
            perceptions: that the step was made with.
            views: how far lasers saw; without, nothing is ever missed.
        """
        if len(self._stamps_ns) % _KEPT_SCANS == 0:
            gc.freeze()
        self._move(step)
        rows = np.flatnonzero(step.landmark_ids >= 0).tolist()
        tracks = [
            self._registry.track(int(step.landmark_ids[row]), perceptions, row) for row in rows
        ]
        self._look_for_movers(tracks, rows, step, perceptions)
        self._moving += [track for track in tracks if track.is_moving]
        standing = [
            (track, row) for track, row in zip(tracks, rows, strict=True) if not track.is_moving
        ]
        if standing or self._keyframes.is_bent:
            self._keyframes.add_pose(self._graph.add_pose(self._keyframes.since_last, self._guess))
        else:
            self._keyframes.add_between(self._graph.num_poses - 1)
        for track, row in standing:
            self._sight(track, step.map_T_base.pose, perceptions, row)
        if len(self._stamps_ns) % self._settings.update_every_scans == 0:
            self._update()
            if views:
                self._miss(Look(step.map_T_base.pose, self._guess, perceptions, views))

    def finish(self, note: Callable[[str], None]) -> None:
        """The batch optimum, with duplicates that only the whole run reveals made one.

        Args:
            note: told what is being done.
        """
        note("settling")
        gc.unfreeze()
        self._graph.polish()
        self._merging.close_gaps(max(self._settings.in_sight_scans, 1), note)
        self._merging.merge_duplicates(set(self._registry.landmarks), note)
        merged = [
            (landmark, merge)
            for landmark in self._registry.landmarks
            for merge in self._registry.merges(landmark)
        ]
        if self._merging.take_back(merged):
            self._graph.polish()
        note("settling, sightings that fit something else or nothing")
        for _ in range(_HAND_OVERS):
            changed = self._hand_over()
            if not changed:
                break
            self._graph.polish()
            self._merging.merge_duplicates(changed, note)
        self._leave_out_strays()

    def _hand_over(self) -> set[int]:
        """The landmarks that gained or lost sightings which a neighbour explains better."""
        landmarks = self._registry.landmarks
        likenesses = {
            k: Likeness(known.kind, known.diameter())
            for k, known in landmarks.items()
            if not known.identity
        }
        changed = set[int]()
        handed = self._graph.hand_over_to_neighbours(likenesses, _BETTER_LOG_ODDS)
        for old, _, sighted in handed:
            leaving = self._keyframes.scans_of(sighted.poses).tolist()
            landmarks[old].scans.difference_update(leaving)
        for old, new, sighted in handed:
            self._take_instead(sighted, self._registry.tracks(new)[0].number)
            landmarks[new].scans.update(self._keyframes.scans_of(sighted.poses).tolist())
            count = len(sighted) + self._graph.num_sightings(old)
            why = f"{len(sighted)} of {count} sightings"
            self._decided.add(What.HANDED_OVER, landmarks[old].kind, old, new, why=why)
            changed |= {old, new}
        return changed

    def _take_instead(self, sighted: Sighted, number: int) -> None:
        """These are sightings of the landmark of the track of that number, -1 for none."""
        scans = self._keyframes.scans_of(sighted.poses).tolist()
        for scan, track in zip(scans, sighted.tracks.tolist(), strict=True):
            self._instead.setdefault(scan, {})[track] = number

    def _leave_out_strays(self) -> None:
        """An identity says more than where something is seen: what has one keeps its sightings."""
        nameless = {k for k, known in self._registry.landmarks.items() if not known.identity}
        for landmark, strays in self._graph.leave_out_strays(nameless).items():
            self._take_instead(strays, -1)
            count = len(strays) + self._graph.num_sightings(landmark)
            kind, why = self._registry.landmarks[landmark].kind, f"{len(strays)} of {count}"
            self._decided.add(What.LEFT_OUT, kind, landmark, why=why)

    def latest(self) -> Pose2:
        """map_T_base of the last scan: by the last update, and by the fast estimates since."""
        return self._guess

    def trajectory(self) -> Trajectory:
        """The smoothed pose of each scan."""
        self._catch_up()
        poses = self._graph.estimate().map_T_bases
        return Trajectory(
            np.array(self._stamps_ns, dtype=np.int64), self._keyframes.trajectory(poses)
        )

    def covariances(self) -> FloatArray:
        """(n, 3, 3) of the trajectory's poses, each in its own frame."""
        self._catch_up()
        return self._keyframes.covariances(*self._graph.chain_covariances())

    def associations(self) -> dict[int, IntArray]:
        """By stamp, the landmark that each perception was taken for in the end, -1 for none.

        What was taken out since it moves is none, nor is a sighting that fitted nothing.
        """
        return {
            stamp_ns: self._registry.landmark_ids(ids, self._instead.get(scan))
            for scan, (stamp_ns, ids) in enumerate(
                zip(self._stamps_ns, self._tracker_ids, strict=True)
            )
        }

    def landmarks(self) -> tuple[Landmark, ...]:
        """The map: all confirmed landmarks of the graph with their marginal covariances."""
        self._catch_up()
        return self._as_landmarks(self._confirmed())

    def gone(self) -> tuple[Gone, ...]:
        """What was confirmed once and is no longer there."""
        landmarks = self._registry.landmarks
        gone = [
            landmark
            for landmark, known in landmarks.items()
            if known.existence.is_gone and known.existence.was_there and self._is_established(known)
        ]
        return tuple(
            Gone(landmark, landmarks[landmark.id].existence.num_misses)
            for landmark in self._as_landmarks(gone)
        )

    def _catch_up(self) -> None:
        """Takes in the scans since the last update."""
        if not self._graph.is_updated:
            self._graph.update()

    def _as_landmarks(self, landmarks: list[int]) -> tuple[Landmark, ...]:
        """Values with their marginal covariances."""
        covariances = self._graph.landmark_covariances(landmarks)
        known = [self._registry.landmarks[landmark] for landmark in landmarks]
        return tuple(
            Landmark(
                landmark,
                its.semantics(),
                self._graph.landmark(landmark),
                covariance,
                self._graph.num_sightings(landmark),
                self._reliability(its),
            )
            for landmark, its, covariance in zip(landmarks, known, covariances, strict=True)
        )

    def _confirmed(self) -> list[int]:
        """The landmarks of the map: neither tentative nor gone.

        What is in sight of a standing robot needs not be seen from apart.
        """
        in_sight = {track.landmark for track in self._in_sight()}
        return [
            landmark
            for landmark, known in self._registry.landmarks.items()
            if self._is_established(known)
            and (
                known.existence.is_there
                or (landmark in in_sight and known.existence.log_odds > 0.0)
            )
        ]

    def _is_established(self, known: GraphLandmark) -> bool:
        """Whether it was sighted often and long enough, and rather is what it seems than not.

        Long without the time between: somebody may walk by the same place twice, and is within
        half a metre of it for 0.83 s each time. An identity is the same whenever it is sighted.
        """
        stayed_ns = known.stayed_ns
        if known.identity:
            stayed_ns = self._stamps_ns[known.scans.last] - self._stamps_ns[known.scans.first]
        return (
            known.num_sightings >= self._settings.min_sightings
            and stayed_ns >= self._settings.least_seconds * 1e9
            and self._reliability(known) > 0.5
        )

    def _reliability(self, known: GraphLandmark) -> float:
        count, total = self._reliabilities[known.kind]
        return known.evidence.reliability(total / max(count, 1))

    @property
    def _scan(self) -> int:
        """The number of the last scan."""
        return len(self._stamps_ns) - 1

    def _move(self, step: FastStep) -> None:
        """The robot goes on by the motion model alone; the fast estimate says where to start.

        The closed form has used the sightings that enter the graph themselves, so only its value
        seeds the pose: as a factor it would count them twice.
        """
        fast = step.map_T_base.pose
        last_T_current = (
            step.motion.pose if self._last_fast is None else self._last_fast.between(fast)
        )
        self._last_fast = fast
        self._guess = self._guess @ last_T_current
        self._keyframes.move(step.motion)
        self._stamps_ns.append(step.stamp_ns)
        self._decided.scan = self._scan
        self._tracker_ids.append(step.landmark_ids)

    def _look_for_movers(
        self, tracks: list[Track], rows: list[int], step: FastStep, perceptions: Perceptions
    ) -> None:
        """Notes what moves; where most seem to, it is the robot's pose that jumped.

        A scan that shows too little to judge by does not say well where things are either.
        """
        if len(tracks) < _LEAST_TO_JUDGE:
            return
        places, covariances = step.map_T_base.transform(
            perceptions.base_t_landmarks(), perceptions.base_covariances()
        )
        moved = [
            track.moved(step.stamp_ns, places[row], covariances[row])
            for track, row in zip(tracks, rows, strict=True)
        ]
        distances2 = mahalanobis2(*(np.array(each) for each in zip(*moved, strict=True)))
        away = (distances2 > CHI2_2DOF_999).tolist()
        if 2 * sum(away) < len(away):
            for track, is_away in zip(tracks, away, strict=True):
                track.note(is_away=is_away)

    def _sight(self, track: Track, odom_T_base: Pose2, perceptions: Perceptions, row: int) -> None:
        """One sighting more; an unreliable one weighs less."""
        if track.landmark not in self._registry.landmarks:
            guess = self._guess.transform(perceptions.base_t_landmarks()[[row]])[0]
            self._graph.add_landmark(track.landmark, guess)
            self._registry.landmarks[track.landmark] = track.known
        reliability = float(perceptions.reliabilities[row])
        kind = track.known.kind
        track.known.existence.hit(odom_T_base, reliability, self._looks[kind])
        track.sight(self._scan, perceptions, row)
        count, total = self._reliabilities[kind]
        self._reliabilities[kind] = (count + 1, total + reliability)
        self._graph.add_sighting(
            Sighting.of(perceptions, row, self._graph.num_poses - 1, track.landmark, track.number)
        )

    def _in_sight(self) -> list[Track]:
        """The tracks sighted lately, of what does not move."""
        since_scan = self._scan - self._settings.in_sight_scans
        return self._registry.in_sight(since_scan, self._stamps_ns[-1])

    def _drop_moving(self) -> None:
        """Takes out what has turned out to move; what an older landmark was taken for stays."""
        for track in self._moving:
            if self._registry.drop(track):
                self._graph.remove(track.landmark)
                why = f"first sighted at scan {track.known.scans.first}"
                self._decided.add(What.MOVING, track.known.kind, track.landmark, why=why)
        self._moving.clear()

    def _miss(self, look: Look) -> None:
        """Counts against all landmarks that the scan should show and did not."""
        reach_m = max(view.reach_m for view in look.views)
        landmarks, least = self._registry.landmarks, self._settings.min_sightings
        places = self._graph.near(look.map_T_base.as_array()[:2], reach_m)
        known = {k: landmarks[k] for k in places if landmarks[k].num_sightings >= least}
        in_sight = {track.landmark for track in self._in_sight()}.intersection(known)
        for landmark in count_misses(look, known, places, in_sight, self._looks):
            gone = known[landmark]
            if gone.existence.was_there:
                why = (
                    f"last sighted at scan {gone.scans.last}, "
                    f"{gone.existence.num_misses} looks in vain"
                )
                self._decided.add(What.GONE, gone.kind, landmark, why=why)

    def _update(self) -> None:
        """One iSAM2 update for the scans since the last, then a look for closed loops."""
        self._graph.update()
        self._drop_moving()
        in_sight = self._in_sight()
        recent = sorted({track.landmark for track in in_sight})
        if self._merging.take_back(self._registry.due(recent, self._scan)):
            self._graph.update(relinearize=True)
        if due := {track.landmark for track in in_sight if track.is_due}:
            self._merging.close_loops(recent, due)
            for track in in_sight:
                track.tested = track.known.num_sightings
        last = self._graph.pose(self._graph.num_poses - 1)
        self._guess = last @ self._keyframes.since_last.pose
