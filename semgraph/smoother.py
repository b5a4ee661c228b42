"""The graph beside the fast estimator: sightings in, smoothed trajectory and map out.

A fast estimator with a short memory follows each object while it is in sight; such a stretch is a
*track*, and each track starts as a landmark of its own. Whether it is an older landmark seen again
is decided by the graph's own uncertainty, and then both become one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import FloatArray
from semgraph.estimates import Trajectory
from semgraph.factor_graph import FactorGraph, Sighting
from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Kind, Landmark, Perceptions
from semgraph.loop_closure import Closure, GraphLandmark, duplicates, find_closures


class SmootherSettings(BaseModel):
    """Settings of the graph."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    start_sigma_m: float = Field(1e-3, gt=0.0)
    start_sigma_rad: float = Field(1e-4, gt=0.0)
    min_sightings: int = Field(3, ge=1)
    update_every_scans: int = Field(5, ge=1)
    closure_odds: float = Field(100.0, gt=1.0)
    duplicate_odds: float = Field(10.0, gt=1.0)
    in_sight_scans: int = Field(10, ge=0)


# Fewer scans without a sighting are an interruption, not a loop.
_LOOP_SCANS: Final = 100


@dataclass(slots=True)
class _Track:
    """One object while it stays in sight."""

    landmark: int
    known: GraphLandmark
    last_scan: int
    tested: int = 0

    @property
    def is_due(self) -> bool:
        """Whether there is so much new evidence that looking for older selves may pay."""
        return self.known.num_sightings > 1.3 * self.tested


class Smoother:
    """Builds the graph scan by scan."""

    def __init__(self, settings: SmootherSettings, map_T_start: Pose2) -> None:
        sigmas = [settings.start_sigma_m, settings.start_sigma_m, settings.start_sigma_rad]
        self._settings = settings
        self._graph = FactorGraph(UncertainPose2(map_T_start, np.diag(sigmas) ** 2))
        self._landmarks: dict[int, GraphLandmark] = {}
        self._tracks: dict[int, _Track] = {}
        self._by_identity: dict[tuple[Kind, str], int] = {}
        self._stamps_ns: list[int] = []
        self._next_landmark = 0
        self._last_fast: Pose2 | None = None
        self._guess = map_T_start
        self._events: list[str] = []

    @property
    def events(self) -> tuple[str, ...]:
        """What was decided, one line each, in order."""
        return (*self._events, *self._graph.incidents)

    def add(self, step: FastStep, perceptions: Perceptions) -> None:
        """Takes in one scan of the fast estimator."""
        self._move(step)
        scan = len(self._stamps_ns) - 1
        for row in np.flatnonzero(step.landmark_ids >= 0).tolist():
            self._sight(scan, int(step.landmark_ids[row]), perceptions, row)
        if len(self._stamps_ns) % self._settings.update_every_scans == 0:
            self._update()

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
        return np.array(
            [self._graph.pose_covariance(scan + 1) for scan in range(len(self._stamps_ns))]
        ).reshape(-1, 3, 3)

    def landmarks(self) -> tuple[Landmark, ...]:
        """The map: all landmarks of the graph with their marginal covariances."""
        return tuple(
            Landmark(
                landmark,
                known.semantics(),
                self._graph.landmark(landmark),
                self._graph.landmark_covariance([landmark]),
                len(self._graph.sightings(landmark)),
                1.0 - known.unreliability,
            )
            for landmark, known in ((each, self._landmarks[each]) for each in self._confirmed())
        )

    def _confirmed(self) -> list[int]:
        """The landmarks sighted often enough to be believed."""
        least = self._settings.min_sightings
        return [
            landmark for landmark, known in self._landmarks.items() if known.num_sightings >= least
        ]

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

    def _sight(self, scan: int, tracker_id: int, perceptions: Perceptions, row: int) -> None:
        track = self._track(scan, tracker_id, perceptions, row)
        if track.landmark not in self._landmarks:
            guess = self._guess.transform(perceptions.base_t_landmarks()[[row]])[0]
            self._graph.add_landmark(track.landmark, guess)
            self._landmarks[track.landmark] = track.known
        track.last_scan = scan
        track.known.sight(scan, perceptions, row)
        sighting = Sighting(
            pose=scan + 1,
            landmark=track.landmark,
            range_m=float(perceptions.ranges_m[row]),
            bearing=float(perceptions.bearings[row]),
            covariance=perceptions.covariances[row],
        )
        self._graph.add_sighting(sighting)

    def _track(self, scan: int, tracker_id: int, perceptions: Perceptions, row: int) -> _Track:
        """The track that goes on; or a new one, of a landmark that may be new as well."""
        track = self._tracks.get(tracker_id)
        if track is not None:
            return track
        kind, identity = Kind(perceptions.kinds[row]), str(perceptions.identities[row])
        named = self._by_identity.get((kind, identity)) if identity else None
        if named is not None:
            track = _Track(named, self._landmarks[named], scan)
        else:
            track = _Track(self._next_landmark, GraphLandmark(kind, identity), scan)
            self._next_landmark += 1
        if identity:
            self._by_identity[(kind, identity)] = track.landmark
        self._tracks[tracker_id] = track
        return track

    def _update(self) -> None:
        """One iSAM2 update for the scans since the last, then a look for closed loops."""
        self._graph.update()
        scan = len(self._stamps_ns) - 1
        in_sight = [
            track
            for track in self._tracks.values()
            if scan - track.last_scan <= self._settings.in_sight_scans
        ]
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
