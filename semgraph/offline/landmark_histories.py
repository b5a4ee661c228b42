"""What all sightings of a batch together say of each landmark beside its position."""

from typing import Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2
from semgraph.graph.existence import Tally
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Kind
from semgraph.offline.batch import Batch, Belief

# Of a gap between two sightings half a second counts as stayed; a longer one ends the visit.
_GAP_NS: Final = 500_000_000
_VISIT_ENDS_NS: Final = 5_000_000_000


def histories(batch: Batch, belief: Belief) -> dict[int, GraphLandmark]:
    """By landmark what its perceptions say, in the order of time."""
    looks = {kind: Tally() for kind in Kind}
    known: dict[int, GraphLandmark] = {}
    for row in np.flatnonzero(belief.assigned()).tolist():
        landmark, scan = int(belief.landmarks[row]), int(batch.scans[row])
        kind = Kind(int(batch.seen.kinds[row]))
        if landmark not in known:
            known[landmark] = GraphLandmark(kind, str(batch.seen.identities[row]))
        known[landmark].sight(scan, batch.seen, row)
        pose = Pose2.from_array(belief.map_T_bases[scan])
        known[landmark].existence.hit(pose, float(batch.seen.reliabilities[row]), looks[kind])
    for each in known.values():
        _count_visits(each, batch.stamps_ns[sorted(each.scans)])
    return known


def confirmed(
    batch: Batch, known: dict[int, GraphLandmark], settings: SmootherSettings
) -> set[int]:
    """Those that are in the map, by the rules of the smoother."""
    probable = reliabilities(batch, known)
    return {
        landmark
        for landmark, each in known.items()
        if each.num_sightings >= settings.min_sightings
        and _stayed_ns(batch, each) >= settings.least_seconds * 1e9
        and probable[landmark] > 0.5
        and each.existence.is_there
    }


def reliabilities(batch: Batch, known: dict[int, GraphLandmark]) -> dict[int, float]:
    """By landmark how probable it is what it was perceived as."""
    usual = {
        kind: float(batch.seen.reliabilities[batch.seen.kinds == kind].mean())
        for kind in {each.kind for each in known.values()}
    }
    return {
        landmark: each.evidence.reliability(usual[each.kind]) for landmark, each in known.items()
    }


def diameters(batch: Batch, landmarks: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """The landmarks (k,) of perceptions (m,), mean diameters, and sigmas of one perception of it.

    NaN where none has a diameter.
    """
    ids, rows = np.unique(landmarks[landmarks >= 0], return_inverse=True)
    seen_m = batch.seen.diameters_m[landmarks >= 0]
    weights = batch.seen.diameter_sigmas_m[landmarks >= 0] ** -2
    has = np.isfinite(seen_m)
    weight, weighed, count = (
        np.bincount(rows[has], values, len(ids))
        for values in (weights[has], (weights * seen_m)[has], None)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return ids, weighed / weight, np.sqrt(count / weight)


def _count_visits(known: GraphLandmark, stamps_ns: IntArray) -> None:
    gaps_ns = np.diff(stamps_ns)
    is_same_visit = (gaps_ns >= 0) & (gaps_ns <= _VISIT_ENDS_NS)
    known.stayed_ns = int(np.minimum(gaps_ns[is_same_visit], _GAP_NS).sum())
    known.num_tracks = 1 + int((~is_same_visit).sum())
    known.num_views = min(known.num_tracks, known.num_diameters)


def _stayed_ns(batch: Batch, known: GraphLandmark) -> int:
    """For how long it was there; an identity is the same whenever it is sighted."""
    if known.identity:
        return int(np.ptp(batch.stamps_ns[list(known.scans)]))
    return known.stayed_ns
