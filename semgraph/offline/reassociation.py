"""Decides anew which landmark each perception is of, given where everything is."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.measurement_model import CHI2_2DOF_999, diameters_contradict
from semgraph.offline.assignment import one_to_one
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.landmark_histories import diameters

# The landmarks nearest to a perception that it may be of.
_NEAREST: Final = 4
# Perceptions of one thing lie within this, and nothing else of its kind does.
_TOGETHER_M: Final = 0.5
_LEAST_SIGHTINGS: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Appearances:
    """What landmarks look like, each by the perceptions that are taken for it.

    Attributes:
        kinds, identities: (c,) of each; -1 and empty where nothing is.
        diameters_m, sigmas_m: (c,) mean and sigma; NaN where none was perceived.
    """

    kinds: IntArray
    identities: NDArray[np.str_]
    diameters_m: FloatArray
    sigmas_m: FloatArray

    @classmethod
    def of(cls, batch: Batch, belief: Belief, ids: IntArray) -> Self:
        """Of the landmarks `ids` (c,), sorted."""
        seen = batch.seen
        kinds = np.full(len(ids), -1, dtype=np.int64)
        identities = np.full(len(ids), "", dtype=seen.identities.dtype)
        known, first = np.unique(belief.landmarks, return_index=True)
        first = first[known >= 0]
        at = np.searchsorted(ids, known[known >= 0])
        kinds[at], identities[at] = seen.kinds[first], seen.identities[first]
        means_m, sigmas_m = np.full(len(ids), np.nan), np.full(len(ids), np.nan)
        those, mean_m, sigma_m = diameters(batch, belief.landmarks)
        at = np.searchsorted(ids, those)
        means_m[at], sigmas_m[at] = mean_m, sigma_m
        return cls(kinds, identities, means_m, sigmas_m)

    def may_be(self, batch: Batch, rows: IntArray, columns: IntArray) -> BoolArray:
        """(k,) whether perceptions `rows` and landmarks `columns` are alike."""
        seen = batch.seen
        alike: BoolArray = (self.kinds[columns] == seen.kinds[rows]) & (
            self.identities[columns] == seen.identities[rows]
        )
        return alike & ~diameters_contradict(
            seen.diameters_m[rows],
            seen.diameter_sigmas_m[rows],
            self.diameters_m[columns],
            self.sigmas_m[columns],
        )


def reassociate(batch: Batch, belief: Belief) -> IntArray:
    """(m,) the landmark of each perception, -1 for none.

    The perceptions of one scan are of different landmarks, each within the 99.9 % gate, of its
    kind, identity and diameter; the sum of squared distances is the least, where being of none
    costs as much as the gate. So no decision lets the robust cost rise.
    """
    if not belief.map_t_landmarks:
        return np.full(len(batch.seen), -1, dtype=np.int64)
    ids = np.array(sorted(belief.map_t_landmarks), dtype=np.int64)
    rows, columns, distances2 = _candidates(batch, belief, ids)
    in_scan = np.unique(batch.scans[rows] * len(ids) + columns, return_inverse=True)[1]
    holds = one_to_one(rows, in_scan, distances2, CHI2_2DOF_999)
    chosen = np.full(len(batch.seen), -1, dtype=np.int64)
    chosen[rows[holds]] = ids[columns[holds]]
    return chosen


def torn(batch: Batch, belief: Belief, landmarks: IntArray, pool: BoolArray) -> IntArray:
    """(m,) `landmarks` with new ones for perceptions of none that lie together, apart from others.

    Beside a landmark of its kind there is no other: a perception that does not fit there is wrong.

    Args:
        batch: what was measured.
        belief: where everything is.
        landmarks: (m,) as decided, -1 for none.
        pool: (m,) which perceptions may be of something new.
    """
    from scipy.spatial import KDTree

    taken_for = np.array(landmarks)
    rows = _apart(batch, belief, np.flatnonzero(pool & (landmarks < 0)))
    if not len(rows):
        return taken_for
    places = batch.map_t_seen(belief.map_T_bases)[rows]
    near = KDTree(places).query_ball_point(places, _TOGETHER_M)
    order = sorted(range(len(rows)), key=lambda k: -len(near[k]))
    next_landmark = 1 + max(int(landmarks.max(initial=-1)), *belief.map_t_landmarks, -1)
    for k in order:
        group = rows[[j for j in near[k] if taken_for[rows[j]] < 0]]
        group = _of_one(batch, group, rows[k]) if taken_for[rows[k]] < 0 else group[:0]
        if len(group) >= _LEAST_SIGHTINGS:
            taken_for[group] = next_landmark
            next_landmark += 1
    return taken_for


def without_strays(landmarks: IntArray, least: int = 2) -> IntArray:
    """(m,) the same, but nothing of what has fewer perceptions than `least`."""
    ids, rows, counts = np.unique(landmarks, return_inverse=True, return_counts=True)
    return np.where((counts >= least)[rows], ids[rows], -1)


def with_places(batch: Batch, belief: Belief, landmarks: IntArray) -> Belief:
    """The belief with perceptions taken for other landmarks; new ones lie where they are seen."""
    places: dict[int, FloatArray] = dict(belief.map_t_landmarks)
    rows = np.flatnonzero((landmarks >= 0) & ~np.isin(landmarks, list(places)))
    rows = rows[np.argsort(landmarks[rows], kind="stable")]
    seen = batch.map_t_seen(belief.map_T_bases)[rows]
    new, starts = np.unique(landmarks[rows], return_index=True)
    for landmark, of_it in zip(new.tolist(), np.split(seen, starts[1:])[: len(new)], strict=True):
        places[landmark] = np.median(of_it, axis=0)
    known: Mapping[int, FloatArray] = places
    return Belief(belief.map_T_bases, belief.landmarks, known, belief.priors).taken_for(landmarks)


def _apart(batch: Batch, belief: Belief, rows: IntArray) -> IntArray:
    """Those of the perceptions that have no landmark of their kind around."""
    from scipy.spatial import KDTree

    places = batch.map_t_seen(belief.map_T_bases)[rows]
    ids, first = np.unique(belief.landmarks, return_index=True)
    first = first[ids >= 0]
    is_apart = np.ones(len(rows), dtype=np.bool_)
    for kind in np.unique(batch.seen.kinds[rows]).tolist():
        of_kind = belief.landmarks[first[batch.seen.kinds[first] == kind]]
        if len(of_kind):
            distances_m, _ = KDTree(belief.places(of_kind)).query(places)
            is_apart &= (batch.seen.kinds[rows] != kind) | (distances_m > _TOGETHER_M)
    return rows[is_apart]


def _candidates(
    batch: Batch, belief: Belief, ids: IntArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """(p,) perceptions, rows of `ids` near them, and squared distances; inf for what cannot be."""
    from scipy.spatial import KDTree

    places = belief.places(ids)
    count = min(_NEAREST, len(ids))
    near = KDTree(places).query(batch.map_t_seen(belief.map_T_bases), k=count)[1]
    columns = np.asarray(near, dtype=np.int64).ravel()
    rows = np.repeat(np.arange(len(batch.seen)), count)
    distances2 = batch.distances2(rows, belief.map_T_bases, places[columns])
    possible = Appearances.of(batch, belief, ids).may_be(batch, rows, columns)
    return rows, columns, np.where(possible, distances2, np.inf)


def _of_one(batch: Batch, rows: IntArray, centre: int) -> IntArray:
    """Of perceptions that lie together those like `centre`, the first of each scan."""
    seen = batch.seen
    alike = (seen.kinds[rows] == seen.kinds[centre]) & (
        seen.identities[rows] == seen.identities[centre]
    )
    alike &= ~diameters_contradict(
        seen.diameters_m[rows],
        seen.diameter_sigmas_m[rows],
        seen.diameters_m[centre],
        seen.diameter_sigmas_m[centre],
    )
    rows = np.sort(rows[alike])
    return rows[np.unique(batch.scans[rows], return_index=True)[1]]
