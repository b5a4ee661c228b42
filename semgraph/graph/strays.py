"""Sightings that fit something else, or nothing, once all is known."""

from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Set
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from semgraph.arrays import FloatArray, IntArray
from semgraph.graph.graph_log import NOWHERE, GraphLog
from semgraph.graph.graph_states import GraphEstimate
from semgraph.measurement_model import CHI2_2DOF_999, diameter_log_likelihoods, misfits2

_LEAST_OF_A_TRACK: Final = 2
_NEIGHBOURS_WITHIN_M: Final = 1.0


@dataclass(frozen=True, slots=True)
class Likeness:
    """What a landmark is: one is only ever of another of its group.

    `diameter` is its mean and sigma in m, NaN where none was perceived.
    """

    group: Hashable
    diameter: tuple[float, float] = (np.nan, np.nan)


def of_neighbours(
    log: GraphLog,
    estimate: GraphEstimate,
    likenesses: Mapping[int, Likeness],
    least_log_odds: float,
) -> dict[int, int]:
    """The rows of sightings that a landmark beside theirs explains so much better, and which.

    Where it was not in sight from that pose as something else. A landmark that would lose half of
    its sightings is in doubt itself, and keeps all of them.

    Args:
        log: of the graph.
        estimate: where all is.
        likenesses: of each landmark that is asked about.
        least_log_odds: how much better.
    """
    close = list(_neighbours(estimate, likenesses))
    found: dict[int, tuple[float, int]] = {}
    for theirs, instead in [*close, *(pair[::-1] for pair in close)]:
        rows = log.rows(theirs)
        # Of two, one would be half.
        if len(rows) <= 2:
            continue
        now, then = (_misfits_of(log, estimate, rows, each) for each in (theirs, instead))
        is_free = ~np.isin(log.poses[rows], log.poses[log.rows(instead)])
        gain = now - then + _of_diameters(log, rows, likenesses[theirs], likenesses[instead])
        is_better = (gain > 2.0 * least_log_odds) & (then <= CHI2_2DOF_999) & is_free
        if 2 * np.count_nonzero(is_better) < len(rows):
            for row, misfit2 in zip(
                rows[is_better].tolist(), then[is_better].tolist(), strict=True
            ):
                found[row] = min(found.get(row, (np.inf, 0)), (misfit2, instead))
    # Several neighbours together may take what each alone leaves.
    owners = log.landmarks[list(found)].tolist()
    lost = Counter(owners)
    return {
        row: instead
        for owner, (row, (_, instead)) in zip(owners, found.items(), strict=True)
        if 2 * lost[owner] < len(log.rows(owner))
    }


def taken_for_each_other(
    log: GraphLog,
    estimate: GraphEstimate,
    likenesses: Mapping[int, Likeness],
    least_log_odds: float,
) -> list[tuple[int, int]]:
    """Pairs of rows, of two landmarks beside each other from one pose, that fit better swapped.

    Args:
        log: of the graph.
        estimate: where all is.
        likenesses: of each landmark that is asked about.
        least_log_odds: how much better both together.
    """
    found: list[tuple[int, int]] = []
    for pair in _neighbours(estimate, likenesses):
        rows = [log.rows(name) for name in pair]
        common, *at = np.intersect1d(log.poses[rows[0]], log.poses[rows[1]], return_indices=True)
        if not len(common):
            continue
        both = [each[places] for each, places in zip(rows, at, strict=True)]
        now, then = (
            [_misfits_of(log, estimate, each, name) for each, name in zip(both, order, strict=True)]
            for order in (pair, pair[::-1])
        )
        like = [likenesses[name] for name in pair]
        gain = sum(now) - sum(then)
        gain += _of_diameters(log, both[0], *like) + _of_diameters(log, both[1], *like[::-1])
        is_better = (gain > 2.0 * least_log_odds) & (np.maximum(*then) <= CHI2_2DOF_999)
        found += zip(both[0][is_better].tolist(), both[1][is_better].tolist(), strict=True)
    return found


def _neighbours(
    estimate: GraphEstimate, likenesses: Mapping[int, Likeness]
) -> Iterator[tuple[int, int]]:
    """Pairs of landmarks of one group that stand beside each other."""
    names = list(likenesses)
    if len(names) < 2:
        return
    tree = KDTree(np.array([estimate.map_t_landmarks[name] for name in names]))
    for one, other in tree.query_pairs(_NEIGHBOURS_WITHIN_M, output_type="ndarray").tolist():
        if likenesses[names[one]].group == likenesses[names[other]].group:
            yield names[one], names[other]


def _of_diameters(log: GraphLog, rows: IntArray, now: Likeness, then: Likeness) -> FloatArray:
    """(k,) by how much chi-squares fall, if sightings are of what is like `then`; 0 if unknown."""
    perceived = log.diameters(rows).T
    log_likelihoods = [
        diameter_log_likelihoods(*perceived, *(np.full(len(rows), each) for each in like.diameter))
        for like in (then, now)
    ]
    gains: FloatArray = np.nan_to_num(2.0 * (log_likelihoods[0] - log_likelihoods[1]))
    return gains


def _misfits_of(
    log: GraphLog, estimate: GraphEstimate, rows: IntArray, landmark: int
) -> FloatArray:
    """(k,) chi-squares of sightings, if they were of that landmark."""
    places = np.tile(estimate.map_t_landmarks[landmark], (len(rows), 1))
    return _misfits(log, estimate, rows, places)


def _misfits(
    log: GraphLog, estimate: GraphEstimate, rows: IntArray, places: FloatArray
) -> FloatArray:
    """(k,) chi-squares of sightings, if what was sighted is there (k, 2)."""
    poses = estimate.map_T_bases[log.poses[rows]]
    return misfits2(poses, places, log.polar(rows), log.covariances(rows))


def strays(log: GraphLog, estimate: GraphEstimate, landmarks: Set[int]) -> IntArray:
    """(k,) rows of sightings of these landmarks beyond the 99.9 % gate, two or more of a track.

    One in a thousand is there by chance. A landmark that half of its sightings do not fit is in
    doubt itself, and keeps all of them.
    """
    rows = np.flatnonzero(log.landmarks != NOWHERE)
    rows = rows[np.isin(log.landmarks[rows], list(landmarks))]
    names, numbers = np.unique(log.landmarks[rows], return_inverse=True)
    if not len(names):
        return rows
    places = np.array([estimate.map_t_landmarks[name] for name in names.tolist()])
    is_off = _misfits(log, estimate, rows, places[numbers]) > CHI2_2DOF_999
    share_off = np.bincount(numbers, is_off) / np.bincount(numbers)
    tracks = np.unique(log.tracks[rows], return_inverse=True)[1]
    is_no_chance = np.bincount(tracks, is_off)[tracks] >= _LEAST_OF_A_TRACK
    found: IntArray = rows[is_off & is_no_chance & (share_off[numbers] < 0.5)]
    return found
