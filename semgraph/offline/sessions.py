"""Several sessions at one place, laid onto each other by the landmarks that they share."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from semgraph.errors import InputError
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Landmark
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.map_matching import locate, match_maps, moved_map
from semgraph.offline.map_update import START_COVARIANCE, moved, moved_landmark
from semgraph.offline.prior_map import PriorMap
from semgraph.offline.refinement import Refined

_LEAST_SHARED: Final = 2


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Sessions in the map of the first; `landmarks` are those of all."""

    batch: Batch
    belief: Belief
    landmarks: tuple[Landmark, ...]


def join(sessions: Sequence[Refined]) -> Joined:
    """All sessions in the map of the first, what they share under one number.

    Each begins in a frame that is known to a metre.

    Raises:
        InputError: a session that shares fewer than two landmarks with those before.
    """
    first = sessions[0]
    joined = Joined(first.batch, first.belief, first.landmarks)
    for number, session in enumerate(sessions[1:], start=2):
        joined = _with(joined, session, number)
    return joined


def _with(joined: Joined, session: Refined, number: int) -> Joined:
    if not joined.landmarks or not session.landmarks:
        raise InputError(f"session {number}: expected landmarks in all sessions, there are none")
    before = PriorMap.of_landmarks(joined.landmarks)
    own = PriorMap.of_landmarks(session.landmarks)
    map_T_own = locate(before, own, Pose2())
    pairs = match_maps(before, moved_map(own, map_T_own))
    shared = np.flatnonzero(pairs >= 0)
    if len(shared) < _LEAST_SHARED:
        raise InputError(
            f"session {number}: expected {_LEAST_SHARED} landmarks or more that an earlier session "
            f"shows within a metre, got {len(shared)}; start both at one place"
        )
    offset = 1 + max(joined.belief.map_t_landmarks)
    name = {landmark: landmark + offset for landmark in session.belief.map_t_landmarks}
    for row in shared.tolist():
        name[session.landmarks[pairs[row]].id] = joined.landmarks[row].id
    taken = set(pairs[shared].tolist())
    added = [
        replace(moved_landmark(each, map_T_own), id=name[each.id])
        for k, each in enumerate(session.landmarks)
        if k not in taken
    ]
    start = UncertainPose2(map_T_own @ session.batch.starts[0].pose, START_COVARIANCE)
    return Joined(
        joined.batch.joined(session.batch, start),
        _joined_belief(joined.belief, moved(session.belief, map_T_own), name),
        (*joined.landmarks, *added),
    )


def _joined_belief(one: Belief, other: Belief, name: dict[int, int]) -> Belief:
    """Both, the landmarks of the other under new names."""
    renamed = np.array([name.get(k, -1) for k in other.landmarks.tolist()], dtype=np.int64)
    places = {name[k]: place for k, place in other.map_t_landmarks.items()}
    return Belief(
        np.concatenate([one.map_T_bases, other.map_T_bases]),
        np.concatenate([one.landmarks, renamed]),
        {**places, **one.map_t_landmarks},
    )
