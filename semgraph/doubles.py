"""What several sensors or detectors show at one moment, each thing once."""

from collections.abc import Sequence
from functools import reduce
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, IntArray
from semgraph.landmarks import Perceptions, concatenate
from semgraph.measurement_model import are_apart, diameters_contradict
from semgraph.nearest import nearest_to_each_other

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
    places = first.base_t_landmarks(), second.base_t_landmarks()
    rows, others = nearest_to_each_other(places[0], first.kinds, places[1], second.kinds)
    covariances = first.base_covariances()[rows] + second.base_covariances()[others]
    is_one = _may_be(first, rows, second, others) & ~are_apart(
        places[0][rows] - places[1][others],
        covariances + _MOUNTED_SIGMA_M**2 * np.eye(2),
        first.diameters_m[rows],
        second.diameters_m[others],
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
