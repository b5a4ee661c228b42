"""A batch brought into the frame of a prior map, whose landmarks become priors of its own."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from semgraph.geometry import Pose2, UncertainPose2, rotation
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Landmark
from semgraph.offline.batch import Belief, Prior
from semgraph.offline.map_matching import locate, match_maps
from semgraph.offline.prior_map import PriorMap
from semgraph.offline.refinement import Refined, refine, refined

# How well anybody knows where in an older map a drive began.
START_COVARIANCE: Final = np.diag([1.0, 1.0, 0.1]) ** 2
_MAX_MATCHINGS: Final = 5


def update_map(
    of_itself: Refined,
    prior: PriorMap,
    settings: SmootherSettings,
    note: Callable[[str], None],
    prior_T_map: Pose2,
) -> Refined:
    """The batch in the frame of the prior map, as far as both hold the same landmarks.

    Args:
        of_itself: refined without the map.
        prior: from before.
        settings: of the graph.
        note: told what is being done.
        prior_T_map: about where the batch's own frame lies in the prior map, to a metre.

    Raises:
        GraphError: the batch cannot be solved.
    """
    if not of_itself.landmarks:
        return of_itself
    now, num_changes = of_itself, list(of_itself.changes)
    prior_T_map = locate(prior, PriorMap.of_landmarks(now.landmarks), prior_T_map)
    batch = replace(now.batch, starts=tuple(_lead(each, prior_T_map) for each in now.batch.starts))
    belief = moved(now.belief, prior_T_map)
    landmarks = tuple(moved_landmark(each, prior_T_map) for each in now.landmarks)
    for number in range(1, _MAX_MATCHINGS + 1):
        priors = _priors(prior, landmarks)
        note(f"map matched {number} times, {len(priors)} landmarks in it")
        if _names(priors) == _names(belief.priors):
            break
        belief, rounds = refine(batch, replace(belief, priors=priors), settings, note)
        num_changes += rounds
        now = refined(batch, belief, settings, num_changes)
        landmarks = now.landmarks
    return now if now is not of_itself else refined(batch, belief, settings, num_changes)


def moved(belief: Belief, to_T_from: Pose2) -> Belief:
    """The same belief in another frame, without its priors."""
    poses = [to_T_from @ Pose2.from_array(pose) for pose in belief.map_T_bases]
    ids = np.array(list(belief.map_t_landmarks), dtype=np.int64)
    places: Mapping[int, np.ndarray] = dict(
        zip(ids.tolist(), to_T_from.transform(belief.places(ids)), strict=True)
    )
    map_T_bases = np.array([pose.as_array() for pose in poses])
    return Belief(map_T_bases, belief.landmarks, places)


def _lead(start: UncertainPose2, to_T_from: Pose2) -> UncertainPose2:
    """Where the start is in a map that says itself where its landmarks are."""
    return UncertainPose2(to_T_from @ start.pose, START_COVARIANCE)


def moved_landmark(landmark: Landmark, to_T_from: Pose2) -> Landmark:
    """The same landmark in another frame."""
    place = to_T_from.transform(landmark.map_t_landmark[None])[0]
    R = rotation(to_T_from.theta)
    return replace(landmark, map_t_landmark=place, covariance=R @ landmark.covariance @ R.T)


def _names(priors: Sequence[Prior]) -> set[tuple[int, bytes]]:
    """Which landmark has which prior."""
    return {(each.landmark, each.map_t_landmark.tobytes()) for each in priors}


def _priors(prior: PriorMap, landmarks: Sequence[Landmark]) -> tuple[Prior, ...]:
    """Of what is in both maps."""
    pairs = match_maps(prior, PriorMap.of_landmarks(landmarks))
    return tuple(
        Prior(landmarks[column].id, prior.map_t_landmarks[row], prior.covariances[row])
        for row, column in enumerate(pairs.tolist())
        if column >= 0
    )
