"""The graph beside the fast estimator: sightings in, smoothed trajectory and map out.

A fast estimator with a short memory follows each object while it is in sight; such a stretch is a
*track*, and each track starts as a landmark of its own. Whether it is an older landmark seen again
is decided by the graph's own uncertainty, and then both become one. What moves is taken out again;
what is not seen often enough stays tentative, out of the map; what is no longer seen where it
should be is gone.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.absence import Look, count_misses
from semgraph.arrays import FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.existence import Tally
from semgraph.factor_graph import FactorGraph
from semgraph.factors import Sighting
from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Gone, Kind, Landmark, Perceptions
from semgraph.loop_closure import Closure, GraphLandmark, duplicates, find_closures
from semgraph.tracks import Track
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

    def start(self, map_T_start: Pose2) -> UncertainPose2:
        """Where the run starts, as surely as the settings say."""
        sigmas = np.array([self.start_sigma_m, self.start_sigma_m, self.start_sigma_rad])
        return UncertainPose2(map_T_start, np.diag(sigmas**2))


# Fewer scans without a sighting are an interruption, not a loop.
_LOOP_SCANS: Final = 100
# Among fewer things nobody can tell whether the robot or the thing moves.
_LEAST_TO_JUDGE: Final = 3


class Smoother:
    """Builds the graph scan by scan."""

    def __init__(self, settings: SmootherSettings, map_T_start: Pose2) -> None:
        self._settings = settings
        self._graph = FactorGraph(settings.start(map_T_start))
        self._landmarks: dict[int, GraphLandmark] = {}
        self._tracks: dict[int, Track] = {}
        self._moving: list[Track] = []
        self._looks = {kind: Tally() for kind in Kind}
        self._reliabilities = dict.fromkeys(Kind, (0, 0.0))
        self._by_identity: dict[tuple[Kind, str], Track] = {}
        self._stamps_ns: list[int] = []
        self._tracker_ids: list[IntArray] = []
        self._next_landmark = 0
        self._last_fast: Pose2 | None = None
        self._guess = map_T_start
        self._events: list[str] = []

    @property
    def events(self) -> tuple[str, ...]:
        """What was decided, one line each, in order."""
        return (*self._events, *self._graph.incidents)

    def add(self, step: FastStep, perceptions: Perceptions, views: Sequence[View]) -> None:
        """Takes in one scan of the fast estimator.

        Args:
            step: of the fast estimator.
            perceptions: that the step was made with.
            views: how far lasers saw; without, nothing is ever missed.
        """
        self._move(step)
        scan = len(self._stamps_ns) - 1
        odom_T_base = step.map_T_base.pose
        rows = np.flatnonzero(step.landmark_ids >= 0).tolist()
        tracks = [self._track(int(step.landmark_ids[row]), perceptions, row) for row in rows]
        self._look_for_movers(tracks, rows, step, perceptions)
        for track, row in zip(tracks, rows, strict=True):
            if track.is_moving:
                self._moving.append(track)
            else:
                kind = track.known.kind
                reliability = float(perceptions.reliabilities[row])
                track.known.existence.hit(odom_T_base, reliability, self._looks[kind])
                self._sight(track, scan, perceptions, row)
        if len(self._stamps_ns) % self._settings.update_every_scans == 0:
            self._update()
            if views:
                self._miss(Look(odom_T_base, self._guess, perceptions, views))

    def finish(self, note: Callable[[str], None]) -> None:
        """The batch optimum, with duplicates that only the whole run reveals made one.

        Args:
            note: told what is being done.
        """
        note("settling")
        self._graph.polish()
        odds = float(np.log(self._settings.duplicate_odds))
        changed = set(self._landmarks)
        while closures := duplicates(self._graph, self._landmarks, changed, odds):
            note(f"settling, {len(closures)} pairs of landmarks found to be one")
            self._merge(closures)
            # Not only for the optimum: in a graph built anew, joint covariances cost a tenth.
            self._graph.polish()
            changed = {closure.old for closure in closures}

    def trajectory(self) -> Trajectory:
        """The smoothed pose of each scan."""
        poses = self._graph.estimate().map_T_bases[1:]
        return Trajectory(np.array(self._stamps_ns, dtype=np.int64), poses)

    def covariances(self) -> FloatArray:
        """(n, 3, 3) of the trajectory's poses, each in its own frame."""
        return self._graph.pose_covariances(range(1, len(self._stamps_ns) + 1))

    def associations(self) -> dict[int, IntArray]:
        """By stamp, the landmark that each perception was taken for in the end, -1 for none.

        What was taken out since it moves is none.
        """
        landmark_of = {
            number: track.landmark if track.landmark in self._landmarks else -1
            for number, track in self._tracks.items()
        }
        landmark_of[-1] = -1
        return {
            stamp_ns: np.array([landmark_of[k] for k in ids.tolist()], dtype=np.int64)
            for stamp_ns, ids in zip(self._stamps_ns, self._tracker_ids, strict=True)
        }

    def landmarks(self) -> tuple[Landmark, ...]:
        """The map: all confirmed landmarks of the graph with their marginal covariances."""
        return self._as_landmarks(self._confirmed())

    def gone(self) -> tuple[Gone, ...]:
        """What was confirmed once and is no longer there."""
        gone = [
            landmark
            for landmark, known in self._landmarks.items()
            if known.existence.is_gone and known.existence.was_there and self._is_established(known)
        ]
        return tuple(
            Gone(landmark, self._landmarks[landmark.id].existence.num_misses)
            for landmark in self._as_landmarks(gone)
        )

    def _as_landmarks(self, landmarks: list[int]) -> tuple[Landmark, ...]:
        """Values with their marginal covariances."""
        covariances = self._graph.landmark_covariances(landmarks)
        return tuple(
            Landmark(
                landmark,
                self._landmarks[landmark].semantics(),
                self._graph.landmark(landmark),
                covariance,
                len(self._graph.sightings(landmark)),
                self._reliability(self._landmarks[landmark]),
            )
            for landmark, covariance in zip(landmarks, covariances, strict=True)
        )

    def _confirmed(self) -> list[int]:
        """The landmarks of the map: neither tentative nor gone.

        What is in sight of a standing robot needs not be seen from apart.
        """
        in_sight = {track.landmark for track in self._in_sight()}
        return [
            landmark
            for landmark, known in self._landmarks.items()
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
            stayed_ns = self._stamps_ns[max(known.scans)] - self._stamps_ns[min(known.scans)]
        return (
            known.num_sightings >= self._settings.min_sightings
            and stayed_ns >= self._settings.least_seconds * 1e9
            and self._reliability(known) > 0.5
        )

    def _reliability(self, known: GraphLandmark) -> float:
        count, total = self._reliabilities[known.kind]
        return known.evidence.reliability(total / max(count, 1))

    def _move(self, step: FastStep) -> None:
        """A new pose, reached by the motion model alone; the fast estimate says where to start.

        The closed form has used the sightings that enter the graph themselves, so only its value
        seeds the pose: as a factor it would count them twice.
        """
        fast = step.map_T_base.pose
        last_T_current = (
            step.motion.pose if self._last_fast is None else self._last_fast.between(fast)
        )
        self._last_fast = fast
        self._guess = self._guess @ last_T_current
        self._graph.add_pose(step.motion, self._guess)
        self._stamps_ns.append(step.stamp_ns)
        self._tracker_ids.append(step.landmark_ids)

    def _look_for_movers(
        self, tracks: list[Track], rows: list[int], step: FastStep, perceptions: Perceptions
    ) -> None:
        """Notes what moves; where most seem to, it is the robot's pose that jumped."""
        places, covariances = step.map_T_base.transform(
            perceptions.base_t_landmarks(), perceptions.base_covariances()
        )
        away = [
            track.look(step.stamp_ns, places[row], covariances[row])
            for track, row in zip(tracks, rows, strict=True)
        ]
        if len(away) >= _LEAST_TO_JUDGE and 2 * sum(away) < len(away):
            for track, is_away in zip(tracks, away, strict=True):
                track.note(is_away=is_away)

    def _sight(self, track: Track, scan: int, perceptions: Perceptions, row: int) -> None:
        """One sighting more; an unreliable one weighs less."""
        if track.landmark not in self._landmarks:
            guess = self._guess.transform(perceptions.base_t_landmarks()[[row]])[0]
            self._graph.add_landmark(track.landmark, guess)
            self._landmarks[track.landmark] = track.known
        track.last_scan = scan
        track.known.sight(scan, perceptions, row)
        track.stay(perceptions.stamp_ns)
        count, total = self._reliabilities[track.known.kind]
        reliability = float(perceptions.reliabilities[row])
        self._reliabilities[track.known.kind] = (count + 1, total + reliability)
        sighting = Sighting(
            pose=scan + 1,
            landmark=track.landmark,
            range_m=float(perceptions.ranges_m[row]),
            bearing=float(perceptions.bearings[row]),
            covariance=perceptions.covariances[row] / max(reliability, 0.05),
        )
        self._graph.add_sighting(sighting)

    def _track(self, tracker_id: int, perceptions: Perceptions, row: int) -> Track:
        """The track that goes on; or a new one, of a landmark that may be new as well."""
        track = self._tracks.get(tracker_id)
        if track is not None:
            return track
        kind, identity = Kind(perceptions.kinds[row]), str(perceptions.identities[row])
        named = self._by_identity.get((kind, identity)) if identity else None
        if named is not None:
            track = Track(named.landmark, named.known, perceptions.stamp_ns)
            track.known.num_tracks += 1
        else:
            track = Track(self._next_landmark, GraphLandmark(kind, identity), perceptions.stamp_ns)
            self._next_landmark += 1
        if identity:
            self._by_identity[(kind, identity)] = track
        self._tracks[tracker_id] = track
        return track

    def _in_sight(self) -> list[Track]:
        """The tracks sighted lately, of what does not move."""
        scan = len(self._stamps_ns) - 1
        reach = self._settings.in_sight_scans
        return [
            track
            for track in self._tracks.values()
            if scan - track.last_scan <= reach and not track.is_moving
        ]

    def _drop_moving(self) -> None:
        """Takes out what has turned out to move; what an older landmark was taken for stays."""
        for track in self._moving:
            known = self._landmarks.get(track.landmark)
            if known is track.known and known.num_tracks == 1:
                self._events.append(
                    f"moving at scan {len(self._stamps_ns) - 1}: {known.kind.label} "
                    f"{track.landmark}, first sighted at scan {min(known.scans)}"
                )
                self._graph.remove(track.landmark)
                self._by_identity.pop((known.kind, known.identity), None)
                del self._landmarks[track.landmark]
        self._moving.clear()

    def _miss(self, look: Look) -> None:
        """Counts against all landmarks that the scan should show and did not."""
        least = self._settings.min_sightings
        known = {k: each for k, each in self._landmarks.items() if each.num_sightings >= least}
        in_sight = {track.landmark for track in self._in_sight()}.intersection(known)
        places = self._graph.estimate().map_t_landmarks
        for landmark in count_misses(look, known, places, in_sight, self._looks):
            gone = known[landmark]
            if gone.existence.was_there:
                self._events.append(
                    f"gone at scan {len(self._stamps_ns) - 1}: {gone.kind.label} {landmark}, last "
                    f"sighted at scan {max(gone.scans)}, {gone.existence.num_misses} looks in vain"
                )

    def _update(self) -> None:
        """One iSAM2 update for the scans since the last, then a look for closed loops."""
        self._graph.update()
        self._drop_moving()
        in_sight = self._in_sight()
        if any(track.is_due for track in in_sight):
            recent = sorted({track.landmark for track in in_sight})
            odds = float(np.log(self._settings.closure_odds))
            self._close(find_closures(self._graph, self._landmarks, recent, odds))
            for track in in_sight:
                track.tested = track.known.num_sightings
        self._guess = self._graph.pose(self._graph.num_poses - 1)

    def _close(self, closures: list[Closure]) -> None:
        """Makes each pair one landmark; everything else follows in the next solution."""
        if closures:
            self._merge(closures)
            self._graph.update(relinearize=True)

    def _merge(self, closures: list[Closure]) -> None:
        for closure in closures:
            self._record(closure)
            self._graph.merge(closure.recent, closure.old)
            self._landmarks[closure.old].absorb(self._landmarks.pop(closure.recent))
            for track in self._tracks.values():
                if track.landmark == closure.recent:
                    track.landmark, track.known = closure.old, self._landmarks[closure.old]

    def _record(self, closure: Closure) -> None:
        recent, old = self._landmarks[closure.recent], self._landmarks[closure.old]
        unseen = min(recent.scans) - max(old.scans)
        what = "loop closed" if unseen > _LOOP_SCANS else "track resumed"
        self._events.append(
            f"{what} at scan {len(self._stamps_ns) - 1}: {old.kind.label} {closure.recent} is "
            f"{closure.old}, unseen for {unseen} scans, log odds {closure.log_odds:.1f}"
        )
