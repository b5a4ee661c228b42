"""What several sensors or detectors show at one moment, each thing once."""

from collections.abc import Sequence
from functools import reduce
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.landmarks import Perceptions, concatenate
from semgraph.measurement_model import CHI2_2DOF_999, diameters_contradict, mahalanobis2

# How well it is known where sensors are on a robot, one axis.
_MOUNTED_SIGMA_M: Final = 0.03


def each_once(stamp_ns: int, parts: Sequence[Perceptions]) -> Perceptions:
    """All perceptions of one moment; of those of one thing in several parts the surest.

    Within a part nothing is one thing. Two parts may have looked at the same measurement, so what
    both show is no surer for it.
    """
    whole = concatenate(stamp_ns, parts[:1])
    return reduce(lambda known, part: _with(stamp_ns, known, part), parts[1:], whole)


def _with(stamp_ns: int, known: Perceptions, part: Perceptions) -> Perceptions:
    rows, others = _pairs(known, part)
    is_surer = _is_surer(known, rows, part, others)
    first, second = np.ones(len(known), dtype=np.bool_), np.ones(len(part), dtype=np.bool_)
    first[rows[~is_surer]] = False
    second[others[is_surer]] = False
    return concatenate(stamp_ns, [known.select(first), part.select(second)])


def _pairs(first: Perceptions, second: Perceptions) -> tuple[IntArray, IntArray]:
    """(k,) rows of each that are one thing: of its kind each is the other's nearest."""
    from scipy.spatial import KDTree

    places = first.base_t_landmarks(), second.base_t_landmarks()
    pairs = np.zeros((0, 2), dtype=np.int64)
    for kind in np.intersect1d(first.kinds, second.kinds).tolist():
        rows, others = (np.flatnonzero(each.kinds == kind) for each in (first, second))
        trees = KDTree(places[0][rows]), KDTree(places[1][others])
        nearest = trees[1].query(trees[0].data)[1]
        is_mutual = trees[0].query(trees[1].data)[1][nearest] == np.arange(len(rows))
        both = np.column_stack([rows[is_mutual], others[nearest[is_mutual]]])
        pairs = np.concatenate([pairs, both])
    rows, others = pairs.T
    is_one = _may_be(first, rows, second, others) & ~_are_apart(
        places[0][rows] - places[1][others], first, rows, second, others
    )
    return rows[is_one], others[is_one]


def _may_be(first: Perceptions, rows: IntArray, second: Perceptions, others: IntArray) -> BoolArray:
    """(k,) whether neither identities nor diameters speak against it."""
    names, other_names = first.identities[rows], second.identities[others]
    is_named_alike: BoolArray = (names == other_names) | (names == "") | (other_names == "")
    return is_named_alike & ~diameters_contradict(
        first.diameters_m[rows],
        first.diameter_sigmas_m[rows],
        second.diameters_m[others],
        second.diameter_sigmas_m[others],
    )


def _are_apart(
    offsets: FloatArray, first: Perceptions, rows: IntArray, second: Perceptions, others: IntArray
) -> BoolArray:
    """(k,) whether one is beside the other, as far as anybody knows."""
    covariances = first.base_covariances()[rows] + second.base_covariances()[others]
    distances2 = mahalanobis2(offsets, covariances + _MOUNTED_SIGMA_M**2 * np.eye(2))
    touching_m = 0.5 * np.nan_to_num(first.diameters_m[rows] + second.diameters_m[others])
    is_beside: BoolArray = np.hypot(offsets[:, 0], offsets[:, 1]) > touching_m
    return is_beside & (distances2 > CHI2_2DOF_999)


def _is_surer(
    first: Perceptions, rows: IntArray, second: Perceptions, others: IntArray
) -> BoolArray:
    """(k,) whether the first of each pair says more: a name, or else a smaller variance."""
    names = first.identities[rows] != "", second.identities[others] != ""
    variances = (
        np.trace(each.base_covariances()[which], axis1=1, axis2=2)
        for each, which in ((first, rows), (second, others))
    )
    is_smaller = np.less_equal(*variances)
    return np.asarray(np.where(names[0] == names[1], is_smaller, names[0]))
