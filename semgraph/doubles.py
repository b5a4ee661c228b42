"""What several sensors or detectors show at one moment, each thing once."""

from collections.abc import Sequence
from functools import reduce
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import wrap_angle
from semgraph.landmarks import LEAST_RANGE_M, Perceptions, concatenate
from semgraph.measurement_model import are_apart, diameters_contradict, innovations
from semgraph.nearest import nearest_to_each_other

# How well it is known where sensors are on a robot, one axis.
_MOUNTED_SIGMA_M: Final = 0.03


def each_once(
    stamp_ns: int, parts: Sequence[Perceptions], *, of_one_measurement: bool = False
) -> Perceptions:
    """All perceptions of one moment; those of one thing in several parts are one, their mean.

    Within a part nothing is one thing.

    Args:
        stamp_ns: of the moment.
        parts: of each sensor or detector, relative to base.
        of_one_measurement: whether all looked at the same: then they err alike, and what several
            show is no surer for it (covariance intersection; Julier and Uhlmann 1997).
    """
    doubt = 2.0 if of_one_measurement else 1.0
    whole = concatenate(stamp_ns, parts[:1])
    return reduce(lambda known, part: _with(known, part, doubt), parts[1:], whole)


def _with(known: Perceptions, part: Perceptions, doubt: float) -> Perceptions:
    rows, others = _pairs(known, part)
    left, new = np.ones(len(known), dtype=np.bool_), np.ones(len(part), dtype=np.bool_)
    left[rows], new[others] = False, False
    both = _mean(known.select(rows), part.select(others), doubt)
    return concatenate(known.stamp_ns, [both, known.select(left), part.select(new)])


def _mean(first: Perceptions, second: Perceptions, doubt: float) -> Perceptions:
    """Of perceptions (k,) of the same things each, weighted by their information.

    Not the surer one: of two alike that is the one that errs to the near side.
    """
    information = np.linalg.inv(first.covariances) + np.linalg.inv(second.covariances)
    covariances = np.linalg.inv(information)
    gain = covariances @ np.linalg.inv(second.covariances)
    off = innovations(
        np.column_stack([first.ranges_m, first.bearings]), second.ranges_m, second.bearings
    )
    moved = np.einsum("nij,nj->ni", gain, off)
    diameters_m, diameter_sigmas_m = _mean_diameters(first, second)
    return Perceptions(
        first.stamp_ns,
        first.kinds,
        np.maximum(first.ranges_m + moved[:, 0], LEAST_RANGE_M),
        wrap_angle(first.bearings + moved[:, 1]),
        doubt * 0.5 * (covariances + covariances.transpose(0, 2, 1)),
        diameters_m,
        diameter_sigmas_m,
        np.where(first.identities == "", second.identities, first.identities),
        np.maximum(first.reliabilities, second.reliabilities),
        np.maximum(first.common_shares, second.common_shares),
    )


def _mean_diameters(first: Perceptions, second: Perceptions) -> tuple[FloatArray, FloatArray]:
    """(k,) and their sigmas: no smaller than the surer one's, for both may see the same side."""
    sigmas_m = np.stack([first.diameter_sigmas_m, second.diameter_sigmas_m])
    weights = np.nan_to_num(sigmas_m**-2.0)
    diameters_m = np.nan_to_num([first.diameters_m, second.diameters_m])
    with np.errstate(invalid="ignore"):
        means_m = (weights * diameters_m).sum(axis=0) / weights.sum(axis=0)
    return means_m, np.fmin(*sigmas_m)


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
