"""A given map grown and refined by a run that was localized in it.

Each stretch in which the localizer holds the robot, by whichever estimator, is a session of one
batch. It starts from the localizer's poses; what a tracker follows are landmarks, and those that
are the map's have the map's covariances as priors. At the optimum the map's errors, which one look
cannot tell from the pose's, are told by all looks together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastEstimator, FastSettings
from semgraph.files.run_log import LogRecorder, RunLog
from semgraph.geometry import UncertainPose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Landmark, Perceptions
from semgraph.localizer import Localized
from semgraph.offline.batch import Batch, Belief, Prior
from semgraph.offline.landmark_histories import histories
from semgraph.offline.map_changes import Change, Fate, changes
from semgraph.offline.map_matching import match_maps
from semgraph.offline.prior_map import PriorMap
from semgraph.offline.reassociation import with_places, without_strays
from semgraph.offline.refinement import Refined, refine, refined
from sensors.views import View

_HELD_FROM: Final = 0.95
_LOST_BELOW: Final = 0.5
# What ends sooner was no place held.
_LEAST_SCANS: Final = 10
# As well as a pose is known when it is first held: the map's landmarks say how well.
START_COVARIANCE: Final = np.diag([1.0, 1.0, 0.1]) ** 2
_HELD_SIGMA_M: Final = 0.3
_MAX_MATCHINGS: Final = 5


@dataclass(frozen=True, slots=True, eq=False)
class Grown:
    """What came of a run and its map together.

    Attributes:
        trajectory: of all stretches in which the robot was held.
        covariances: (n, 3, 3) of its poses, each in its own frame.
        landmarks: the map: what was seen is refined, what is new added, what is gone left out.
        changes: of each landmark of the given map, and what was added.
    """

    trajectory: Trajectory
    covariances: FloatArray
    landmarks: tuple[Landmark, ...]
    changes: tuple[Change, ...]


class Stretches:
    """Gathers what is seen as long as the robot is held."""

    def __init__(self, tracker: FastSettings) -> None:
        self._settings = tracker
        self._logs: list[RunLog] = []
        self._current: _Stretch | None = None

    def add(
        self,
        perceptions: Perceptions,
        odometry: UncertainPose2 | None,
        views: Sequence[View],
        found: Localized,
    ) -> None:
        """One scan, and where the localizer found the robot."""
        if self._current is not None and found.quality < _LOST_BELOW:
            self._end()
        if self._current is None and found.quality >= _HELD_FROM:
            self._current = _Stretch(self._settings, found)
            odometry = None
        if self._current is not None:
            self._current.add(perceptions, odometry, views, found)

    def logs(self) -> tuple[RunLog, ...]:
        """All stretches, the last one ended."""
        self._end()
        return tuple(self._logs)

    def _end(self) -> None:
        if self._current is not None and len(self._current) >= _LEAST_SCANS:
            self._logs.append(self._current.log())
        self._current = None


class _Stretch:
    """One stretch: a tracker follows what is in sight."""

    def __init__(self, tracker: FastSettings, found: Localized) -> None:
        start = found.map_T_base.pose
        self._tracker = FastEstimator(tracker, start)
        self._recorder = LogRecorder(UncertainPose2(start, START_COVARIANCE))
        self._found: list[Localized] = []
        self._associations: dict[int, IntArray] = {}

    def add(
        self,
        perceptions: Perceptions,
        odometry: UncertainPose2 | None,
        views: Sequence[View],
        found: Localized,
    ) -> None:
        step = self._tracker.step(perceptions, odometry)
        self._recorder.add(step, perceptions, views)
        self._associations[step.stamp_ns] = step.landmark_ids
        self._found.append(found)

    def __len__(self) -> int:
        return len(self._found)

    def log(self) -> RunLog:
        poses = np.array([each.map_T_base.pose.as_array() for each in self._found])
        stamps_ns = np.array([each.stamp_ns for each in self._found])
        return self._recorder.log(Trajectory(stamps_ns, poses), self._associations)


def grow(
    landmarks: Sequence[Landmark],
    logs: Sequence[RunLog],
    settings: SmootherSettings,
    note: Callable[[str], None],
) -> Grown | None:
    """The run and its map at their joint optimum; None where the robot was never held.

    Args:
        landmarks: of the given map.
        logs: of the stretches.
        settings: of the graph.
        note: told what is being done.

    Raises:
        GraphError: the batch cannot be solved.
    """
    if not logs:
        return None
    prior = PriorMap.of_landmarks(landmarks)
    batch, belief = _together(logs)
    now = _optimum(batch, belief, prior, settings, note)
    note("what became of the map")
    fates = changes(now.batch, now.belief, now.landmarks, now.tentative, prior)
    trajectory = Trajectory(batch.stamps_ns, now.belief.map_T_bases)
    return Grown(trajectory, now.pose_covariances, _grown(landmarks, now, fates), fates)


def _together(logs: Sequence[RunLog]) -> tuple[Batch, Belief]:
    """All stretches in the map's frame, each with landmarks of its own."""
    batch, poses, labels = Batch.of(logs[0]), [], []
    next_label = 0
    for number, log in enumerate(logs):
        batch = batch.joined(Batch.of(log), log.start) if number else batch
        poses.append(log.trajectory.map_T_bases)
        labels.append(np.where(log.landmarks >= 0, log.landmarks + next_label, -1))
        next_label += int(log.landmarks.max(initial=-1)) + 1
    bases = np.concatenate(poses)
    each = without_strays(np.concatenate(labels))
    return batch, with_places(batch, Belief(bases, each, {}), each)


def _optimum(
    batch: Batch,
    belief: Belief,
    prior: PriorMap,
    settings: SmootherSettings,
    note: Callable[[str], None],
) -> Refined:
    """By turns: which landmarks are the map's, and where everything is then."""
    priors = _priors(prior, _as_held(batch, belief))
    for number in range(1, _MAX_MATCHINGS + 1):
        note(f"map matched {number} times, {len(priors)} of its landmarks seen")
        belief, rounds = refine(batch, replace(belief, priors=priors), settings, note)
        now = refined(batch, belief, settings, rounds)
        again = _priors(prior, PriorMap.of_landmarks([*now.landmarks, *now.tentative]))
        if _names(again) == _names(priors):
            break
        priors = again
    return now


def _as_held(batch: Batch, belief: Belief) -> PriorMap:
    """What was seen, as well as the localizer's poses have it."""
    known = histories(batch, belief)
    seen = [
        Landmark(
            label,
            each.semantics(),
            belief.map_t_landmarks[label],
            _HELD_SIGMA_M**2 * np.eye(2),
            each.num_sightings,
            1.0,
        )
        for label, each in known.items()
    ]
    return PriorMap.of_landmarks(seen)


def _priors(prior: PriorMap, seen: PriorMap) -> tuple[Prior, ...]:
    """Of what is in both."""
    pairs = match_maps(prior, seen)
    return tuple(
        Prior(int(seen.names[column]), prior.map_t_landmarks[row], prior.covariances[row])
        for row, column in enumerate(pairs.tolist())
        if column >= 0
    )


def _names(priors: Sequence[Prior]) -> set[tuple[int, bytes]]:
    return {(each.landmark, each.map_t_landmark.tobytes()) for each in priors}


def _grown(
    landmarks: Sequence[Landmark], now: Refined, fates: Sequence[Change]
) -> tuple[Landmark, ...]:
    """The map as the fates of its landmarks have it; added ones get new numbers."""
    given = {str(each.id): each for each in landmarks}
    of_run = {each.id: each for each in (*now.landmarks, *now.tentative)}
    next_id = 1 + max(each.id for each in landmarks)
    made: list[Landmark] = []
    for change in fates:
        if change.fate is Fate.GONE:
            continue
        if change.landmark < 0:
            made.append(given[change.prior])
        elif change.fate is Fate.ADDED:
            made.append(replace(of_run[change.landmark], id=next_id))
            next_id += 1
        else:
            made.append(_refined(given[change.prior], of_run[change.landmark]))
    return tuple(made)


def _refined(given: Landmark, seen: Landmark) -> Landmark:
    """A landmark of the map where it is now; what it is the map knows better, if it says it."""
    says = given.semantics.diameter is not None or seen.semantics.diameter is None
    return replace(
        given,
        semantics=given.semantics if says else seen.semantics,
        map_t_landmark=seen.map_t_landmark,
        covariance=seen.covariance,
        num_sightings=given.num_sightings + seen.num_sightings,
    )
