"""What has become of a prior map: kept, moved, gone, not visited; and what was added."""

from collections.abc import Sequence, Set
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.landmarks import Kind, Landmark
from semgraph.measurement_model import CHI2_2DOF_999
from semgraph.nearest import nearest_to_each_other
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.map_looks import MapLooks
from semgraph.offline.map_matching import match_maps
from semgraph.offline.prior_map import PriorMap

# A map is right of nine landmarks in ten; gone and there are more probable than nine to one.
_BEFORE: Final = float(np.log(9.0))
_GONE: Final = -float(np.log(9.0))
# A thing of unknown diameter may be as thin as one in ten: thin ones show less often.
_THIN: Final = 0.1
# What is gone, and stands anew within this, was moved.
_MOVED_WITHIN_M: Final = 1.0
# Where nobody knows any diameter: rather small, then fewer looks count against a thing.
_SOME_DIAMETER_M: Final = 0.1


class Fate(Enum):
    """What became of a landmark. UNSURE: looked at, but too little to say."""

    KEPT = "kept"
    MOVED = "moved"
    GONE = "gone"
    UNSURE = "unsure"
    NOT_VISITED = "not visited"
    ADDED = "added"


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """What became of one landmark of the prior map, or that it is new.

    Attributes:
        fate: of it.
        kind: of it.
        prior: what the prior map calls it, empty if it is added.
        landmark: of the refined map, -1 for none.
        map_t_landmark: (2,) m where it is; where there is none, where it was.
        moved_m: how far it is from where it was, NaN where there are not both.
        significance: chi-square of that with 2 degrees of freedom, NaN where there are not both.
        looks: sightings; of what was not found, looks in vain.
        log_odds: of being there.
    """

    fate: Fate
    kind: Kind
    prior: str
    landmark: int
    map_t_landmark: FloatArray
    moved_m: float
    significance: float
    looks: int
    log_odds: float


def changes(
    batch: Batch,
    belief: Belief,
    landmarks: Sequence[Landmark],
    tentative: Sequence[Landmark],
    prior: PriorMap,
) -> tuple[Change, ...]:
    """Of every landmark of the prior map, then those that were added.

    Args:
        batch: what was measured.
        belief: in the frame of the prior map.
        landmarks: the refined map, in the same frame.
        tentative: seen too little to be in it, but for a prior map that holds them.
        prior: from before.
    """
    pairs = _pairs(prior, landmarks)
    made = {row: _kept(prior, row, landmarks[k]) for row, k in pairs.items()}
    # What is hardly a tree, say, may still be one where the map has one.
    probable = [each for each in tentative if _BEFORE + _log_odds(each) > 0.0]
    for row, k in _pairs(prior, probable, set(pairs)).items():
        made[row] = _kept(prior, row, probable[k])
    lost = np.setdiff1d(np.arange(len(prior)), list(made))
    there, usual_m = _there(landmarks)
    diameters_m = np.nan_to_num(prior.diameters_m[lost], nan=float(np.quantile(usual_m, _THIN)))
    looks = MapLooks(batch, belief, there, usual_m)
    absence = looks.absence(prior.map_t_landmarks[lost], prior.covariances[lost], diameters_m)
    log_odds = _BEFORE + absence.log_odds
    free = np.setdiff1d(np.arange(len(landmarks)), list(pairs.values()))
    moved = _moved(prior, lost[log_odds < 0.0], landmarks, free)
    for row, count, odds in zip(
        lost.tolist(), absence.looks.tolist(), log_odds.tolist(), strict=True
    ):
        made[row] = (
            _kept(prior, row, landmarks[moved[row]], Fate.MOVED)
            if row in moved
            else _lost(prior, row, count, odds)
        )
    added = [_added(landmarks[k]) for k in np.setdiff1d(free, list(moved.values())).tolist()]
    return (*(made[row] for row in sorted(made)), *added)


def _pairs(
    prior: PriorMap, landmarks: Sequence[Landmark], but: Set[int] = frozenset()
) -> dict[int, int]:
    """Rows of the prior map and of landmarks that are one, without some rows."""
    rows = np.setdiff1d(np.arange(len(prior)), list(but))
    if not landmarks or not len(rows):
        return {}
    found = match_maps(prior.select(rows), PriorMap.of_landmarks(landmarks))
    return {int(rows[k]): int(found[k]) for k in np.flatnonzero(found >= 0)}


def _there(landmarks: Sequence[Landmark]) -> tuple[IntArray, FloatArray]:
    """The landmarks of a map, and their diameters; an unknown one is as usual."""
    known = [each.semantics.diameter for each in landmarks if each.semantics.diameter]
    usual_m = float(np.median([each.mean_m for each in known])) if known else _SOME_DIAMETER_M
    diameters = [each.semantics.diameter for each in landmarks]
    return (
        np.array([each.id for each in landmarks], dtype=np.int64),
        np.array([each.mean_m if each else usual_m for each in diameters] or [usual_m]),
    )


def _moved(
    prior: PriorMap, gone: IntArray, landmarks: Sequence[Landmark], free: IntArray
) -> dict[int, int]:
    """What is gone and stands anew nearby: rows of the prior map and of `free` landmarks."""
    if not len(gone) or not len(free):
        return {}
    new = PriorMap.of_landmarks([landmarks[k] for k in free.tolist()])
    old_places = prior.map_t_landmarks[gone]
    old, anew = nearest_to_each_other(old_places, prior.kinds[gone], new.map_t_landmarks, new.kinds)
    apart_m = np.linalg.norm(old_places[old] - new.map_t_landmarks[anew], axis=1)
    is_moved = apart_m <= _MOVED_WITHIN_M
    return dict(zip(gone[old[is_moved]].tolist(), free[anew[is_moved]].tolist(), strict=True))


def _kept(prior: PriorMap, row: int, landmark: Landmark, fate: Fate = Fate.KEPT) -> Change:
    away = landmark.map_t_landmark - prior.map_t_landmarks[row]
    chi2 = _significance(away, prior.covariances[row], landmark.covariance)
    return Change(
        Fate.MOVED if chi2 > CHI2_2DOF_999 else fate,
        landmark.semantics.kind,
        prior.names[row],
        landmark.id,
        landmark.map_t_landmark,
        float(np.hypot(*away)),
        chi2,
        landmark.num_sightings,
        _log_odds(landmark),
    )


def _significance(away: FloatArray, prior: FloatArray, posterior: FloatArray) -> float:
    """Chi-square of a movement.

    Where the prior is part of the estimate, the movement's covariance is what the estimate is
    surer by; where it was left out since it contradicts, it is the sum of both.
    """
    is_part = float(away @ np.linalg.solve(prior, away)) <= CHI2_2DOF_999
    S = prior - posterior if is_part else prior + posterior
    values, vectors = np.linalg.eigh(S)
    # In a direction that nothing was learned of, nothing can have moved.
    known = values > 1e-3 * np.trace(prior)
    return float((((vectors.T @ away)[known]) ** 2 / values[known]).sum())


def _lost(prior: PriorMap, row: int, looks: int, log_odds: float) -> Change:
    fate = Fate.GONE if log_odds < _GONE else Fate.UNSURE if looks else Fate.NOT_VISITED
    return Change(
        fate,
        Kind(int(prior.kinds[row])),
        prior.names[row],
        -1,
        prior.map_t_landmarks[row],
        np.nan,
        np.nan,
        looks,
        log_odds,
    )


def _added(landmark: Landmark) -> Change:
    return Change(
        Fate.ADDED,
        landmark.semantics.kind,
        "",
        landmark.id,
        landmark.map_t_landmark,
        np.nan,
        np.nan,
        landmark.num_sightings,
        _log_odds(landmark),
    )


def _log_odds(landmark: Landmark) -> float:
    reliability = min(max(landmark.reliability, 1e-3), 1.0 - 1e-3)
    return float(np.log(reliability / (1.0 - reliability)))
