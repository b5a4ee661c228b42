"""The rigid motion that lays an estimate onto the truth."""

import math
from enum import Enum

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2

OUTLIER_SIGMAS = 5.0
NEIGHBOURHOOD = 31

# Median of a Rayleigh distributed length, in standard deviations of one axis.
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))
# 95 % efficiency of the Cauchy weight on Gaussian residuals (Holland and Welsch 1977).
_CAUCHY_SIGMAS = 2.385
_MAX_ROUNDS = 100


class Alignment(Enum):
    """How an estimate is laid onto the truth before it is compared."""

    NONE = "as it is"
    ORIGIN = "first pose onto first pose"
    RIGID = "best rigid motion"


def rigid_alignment(
    world_t_points: FloatArray, map_t_points: FloatArray, weights: FloatArray | None = None
) -> Pose2:
    """world_T_map with the least (weighted) sum of squares over pairs of points (n, 2).

    Raises:
        InputError: the numbers of points disagree, or there are fewer than two.
    Source: Umeyama 1991 in the plane, without scale.
    """
    if world_t_points.shape != map_t_points.shape or len(world_t_points) < 2:
        raise InputError(
            "alignment: expected two or more pairs of points, "
            f"got {world_t_points.shape} and {map_t_points.shape}"
        )
    if weights is None:
        weights = np.ones(len(world_t_points))
    world_t_centre = np.average(world_t_points, axis=0, weights=weights)
    map_t_centre = np.average(map_t_points, axis=0, weights=weights)
    world = (world_t_points - world_t_centre) * weights[:, None]
    other = map_t_points - map_t_centre
    theta = math.atan2(
        float(np.sum(other[:, 0] * world[:, 1] - other[:, 1] * world[:, 0])),
        float(np.sum(other * world)),
    )
    x, y = world_t_centre - Pose2(0.0, 0.0, theta).transform(map_t_centre[None])[0]
    return Pose2(float(x), float(y), theta)


def robust_alignment(world_t_points: FloatArray, map_t_points: FloatArray) -> Pose2:
    """world_T_map that single wrong points hardly move.

    Least squares, weighted again and again with Cauchy's weight of each residual; its scale is
    the median residual's.

    Raises:
        InputError: as `rigid_alignment`.
    Source: Holland and Welsch 1977 (iteratively reweighted least squares).
    """
    world_T_map = rigid_alignment(world_t_points, map_t_points)
    for _ in range(_MAX_ROUNDS):
        lengths = _lengths(world_t_points - world_T_map.transform(map_t_points))
        scale = _CAUCHY_SIGMAS * residual_sigma(lengths)
        if scale < 1e-12:
            break
        before = world_T_map
        world_T_map = rigid_alignment(
            world_t_points, map_t_points, 1.0 / (1.0 + (lengths / scale) ** 2)
        )
        if np.abs(before.between(world_T_map).as_array()).max() < 1e-10:
            break
    return world_T_map


def reference_outliers(world_t_references: FloatArray, world_t_points: FloatArray) -> BoolArray:
    """Which points of a reference jump, (n,), beside an aligned estimate; both in order of time.

    Points that follow each other jump if each one's residual exceeds 5 sigma, and so does its
    difference from the median residual of the 31 points around it, and the reference moved at
    least 2.5 sigma farther than the estimate where they begin or end. Sigma is that of the median
    residual. So an estimate that drifts, bends or jumps itself is not excused.
    """
    from scipy.ndimage import label, median_filter

    residuals = world_t_references - world_t_points
    gate = OUTLIER_SIGMAS * residual_sigma(_lengths(residuals))
    around = median_filter(residuals, size=(NEIGHBOURHOOD, 1), mode="mirror")
    is_far = (_lengths(residuals) > gate) & (_lengths(residuals - around) > gate)
    steps = _lengths(np.diff(world_t_references, axis=0)) - _lengths(
        np.diff(world_t_points, axis=0)
    )
    jumps = np.concatenate([[False], steps > 0.5 * gate, [False]])
    groups, _ = label(is_far)
    jumping = groups[(jumps[:-1] | jumps[1:]) & is_far]
    is_outlier: BoolArray = is_far & np.isin(groups, jumping)
    return is_outlier


def residual_sigma(lengths: FloatArray) -> float:
    """The standard deviation of one axis that the median length of residuals (n,) tells."""
    return float(np.median(lengths)) / _RAYLEIGH_MEDIAN


def _lengths(vectors: FloatArray) -> FloatArray:
    lengths: FloatArray = np.linalg.norm(vectors, axis=1)
    return lengths
