"""The h(x) of a sighting, its Jacobians, and the gates that all estimators share.

The graph's own h(x) is GTSAM's bearing-range factor.
"""

from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.geometry import Pose2, points_from, wrap_angle

# Chi-square quantiles of 2 degrees of freedom, the gates of one sighting.
CHI2_2DOF_99: Final = 9.2103
CHI2_2DOF_999: Final = 13.8155
CHI2_3DOF_999: Final = 16.2662
# Diameters of one object may differ by three sigma; 5 % is what its outline itself varies.
_DIAMETER_GATE: Final = 9.0
_LOG_DIAMETER_SIGMA: Final = 0.05


def predict(map_T_base: Pose2, map_t_landmarks: FloatArray) -> FloatArray:
    """(n, 2) expected (range, bearing) of landmarks (n, 2) from a pose."""
    base_t_landmarks = map_T_base.inverse().transform(map_t_landmarks)
    return np.column_stack(
        [
            np.hypot(base_t_landmarks[:, 0], base_t_landmarks[:, 1]),
            np.arctan2(base_t_landmarks[:, 1], base_t_landmarks[:, 0]),
        ]
    )


def innovations(predicted: FloatArray, ranges_m: FloatArray, bearings: FloatArray) -> FloatArray:
    """(n, 2) measured minus predicted (range, bearing), the bearing wrapped."""
    return np.column_stack([ranges_m - predicted[:, 0], wrap_angle(bearings - predicted[:, 1])])


def misfits2(
    map_T_bases: FloatArray, map_t_landmarks: FloatArray, polar: FloatArray, covariances: FloatArray
) -> FloatArray:
    """(n,) squared Mahalanobis distances of sightings, each from a pose and of a landmark.

    Args:
        map_T_bases: (n, 3).
        map_t_landmarks: (n, 2) m.
        polar: (n, 2) range and bearing, as measured.
        covariances: (n, 2, 2) of those.
    """
    x, y = points_from(map_T_bases, map_t_landmarks).T
    predicted = np.column_stack([np.hypot(x, y), np.arctan2(y, x)])
    return mahalanobis2(innovations(predicted, *polar.T), covariances)


def jacobians(map_T_base: Pose2, map_t_landmarks: FloatArray) -> tuple[FloatArray, FloatArray]:
    """d(range, bearing) by the pose (n, 2, 3), body tangent, and by the landmark (n, 2, 2), map.

    Source: Dellaert and Kaess 2017, section 2; the pose columns follow from the body-frame tangent.
    """
    delta = map_t_landmarks - (map_T_base.x, map_T_base.y)
    ranges_m = np.hypot(delta[:, 0], delta[:, 1])
    unit = delta / ranges_m[:, None]
    across = np.column_stack([-unit[:, 1], unit[:, 0]]) / ranges_m[:, None]
    by_landmark = np.stack([unit, across], axis=1)
    c, s = np.cos(map_T_base.theta), np.sin(map_T_base.theta)
    map_R_base = np.array([[c, -s], [s, c]])
    by_pose = np.zeros((len(delta), 2, 3))
    by_pose[:, :, :2] = -by_landmark @ map_R_base
    by_pose[:, 1, 2] = -1.0
    return by_pose, by_landmark


def mahalanobis2(differences: FloatArray, covariances: FloatArray) -> FloatArray:
    """(...) squared Mahalanobis distances of (..., k) differences with (..., k, k) covariances."""
    solved = np.linalg.solve(covariances, differences[..., None])[..., 0]
    distances2: FloatArray = np.einsum("...k,...k->...", differences, solved)
    return distances2


def are_apart(
    offsets: FloatArray,
    covariances: FloatArray,
    diameters_m: FloatArray | float,
    other_diameters_m: FloatArray,
) -> BoolArray:
    """(n,) whether of two things one is beside the other, neither the same nor a part of it.

    Args:
        offsets: (n, 2) m from the one to the other.
        covariances: (n, 2, 2) m2 of those.
        diameters_m: (n,) of the one, or of all; NaN where unknown.
        other_diameters_m: (n,) of the other.
    """
    touching_m = 0.5 * np.nan_to_num(diameters_m + other_diameters_m)
    is_beside = np.hypot(offsets[:, 0], offsets[:, 1]) > touching_m
    return np.asarray(is_beside & (mahalanobis2(offsets, covariances) > CHI2_2DOF_999))


def log_odds_of_pairs(
    differences: FloatArray, covariances: FloatArray, densities: FloatArray | float
) -> FloatArray:
    """(...) ln N(difference; 0, S) - ln density of pairs, each for itself; -inf outside the gate.

    Args:
        differences: (..., 2) m.
        covariances: (..., 2, 2) m2 of those.
        densities: (...) of unknown landmarks, per m2.
    """
    distances2 = mahalanobis2(differences, covariances)
    determinants = np.linalg.det(covariances)
    # Rounding makes of what is nearly singular something without a likelihood.
    is_possible = (distances2 <= CHI2_2DOF_999) & (distances2 >= 0.0) & (determinants > 0.0)
    scales = (2.0 * np.pi) ** 2 * np.where(is_possible, determinants, 1.0)
    log_likelihoods = -0.5 * distances2 - 0.5 * np.log(scales)
    return np.where(is_possible, log_likelihoods - np.log(densities), -np.inf)


def diameters_contradict(
    first_m: FloatArray | float,
    first_sigmas_m: FloatArray | float,
    second_m: FloatArray | float,
    second_sigmas_m: FloatArray | float,
) -> BoolArray:
    """Whether diameters (broadcast together) cannot be of one object; an unknown one (NaN) can."""
    with np.errstate(invalid="ignore"):
        variances = (
            (first_sigmas_m / first_m) ** 2
            + (second_sigmas_m / second_m) ** 2
            + _LOG_DIAMETER_SIGMA**2
        )
        return np.asarray(np.log(first_m / second_m) ** 2 > _DIAMETER_GATE * variances)


def diameter_log_likelihoods(
    first_m: FloatArray,
    first_sigmas_m: FloatArray,
    second_m: FloatArray,
    second_sigmas_m: FloatArray,
) -> FloatArray:
    """Ln N of the differences of diameters (broadcast together) of one object; NaN if unknown."""
    variances = first_sigmas_m**2 + second_sigmas_m**2 + (_LOG_DIAMETER_SIGMA * second_m) ** 2
    log_likelihoods: FloatArray = -0.5 * (
        (first_m - second_m) ** 2 / variances + np.log(2.0 * np.pi * variances)
    )
    return log_likelihoods
