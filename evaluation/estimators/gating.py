"""Which landmarks perceptions may be, by the uncertainty of pose and map together."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.estimators.pose_and_map import PoseAndMap
from evaluation.estimators.sighted import Sighted
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import wrap_angle
from semgraph.landmarks import Perceptions
from semgraph.measurement_model import CHI2_2DOF_99, mahalanobis2

# Nearer than this to anything of its kind, nothing is new. A run has 1e4 perceptions and more: at
# 99.99 % one tree in forty got a twin, and the two shared all that followed.
NEW_CHI2: Final = -2.0 * float(np.log(1e-6))
_LEAST_RELIABILITY: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Gated:
    """Perceptions (n) beside landmarks (k).

    Attributes:
        innovations: (n, k, 2) of range and bearing.
        distances2: (n, k) their squared Mahalanobis distances.
        log_likelihoods: (n, k) but for a constant.
        allowed: (n, k) whether the one may be the other: by the 99 % gate, kind, identity and
            diameter.
        is_new: (n,) far from all landmarks of its kind, and of an identity that none bears.
    """

    innovations: FloatArray
    distances2: FloatArray
    log_likelihoods: FloatArray
    allowed: BoolArray
    is_new: BoolArray


def gate(
    state: PoseAndMap,
    rows: IntArray,
    known: Sighted,
    numbers: IntArray,
    perceptions: Perceptions,
    scan: int,
) -> Gated:
    """What is perceived beside landmarks.

    Args:
        state: at the time of the perceptions.
        rows: (k,) of the landmarks in the state.
        known: beside where they are.
        numbers: (k,) of the same landmarks in `known`.
        perceptions: relative to base.
        scan: its number.
    """
    expected, covariances = state.expected(rows)
    innovations = measured(perceptions)[:, None] - expected[None]
    innovations[..., 1] = wrap_angle(innovations[..., 1])
    S = covariances[None] + weighed_covariances(perceptions)[:, None]
    distances2 = mahalanobis2(innovations, S)
    is_possible = known.compatible(perceptions, numbers)
    # A diameter perceived all wrong does not make a new thing of one that stands there.
    is_there = known.same_kind(perceptions, numbers) & (distances2 <= NEW_CHI2)
    return Gated(
        innovations,
        distances2,
        -0.5 * (distances2 + np.log(np.linalg.det(S))),
        is_possible & (distances2 <= CHI2_2DOF_99),
        np.asarray(~is_there.any(axis=1)) & ~known.is_borne(perceptions, scan),
    )


def measured(perceptions: Perceptions) -> FloatArray:
    """(n, 2) range and bearing."""
    return np.column_stack([perceptions.ranges_m, perceptions.bearings])


def weighed_covariances(perceptions: Perceptions) -> FloatArray:
    """(n, 2, 2) of range and bearing; as in the graph, the less reliable weigh less."""
    reliabilities = np.maximum(perceptions.reliabilities, _LEAST_RELIABILITY)
    covariances: FloatArray = perceptions.covariances / reliabilities[:, None, None]
    return covariances
