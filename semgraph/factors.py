"""What the graph is made of: odometry and sightings, as values and as GTSAM's factors."""

from dataclasses import dataclass, field
from typing import Final, Self

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from semgraph.arrays import FloatArray
from semgraph.errors import GraphError
from semgraph.geometry import Pose2, UncertainPose2, frozen_covariance
from semgraph.landmarks import Perceptions

# A sighting within this chi-square is taken as it is, one beyond it ever less (DCS; Agarwal 2013).
ROBUST_CHI2: Final = 13.8155
_LEAST_RANGE_M: Final = 1e-3
_LEAST_RELIABILITY: Final = 0.05


@dataclass(slots=True, eq=False)
class Sighting:
    """One bearing-range factor: pose `pose` saw landmark `landmark`.

    `covariance` (2, 2) is of (range, bearing). `landmark` changes when landmarks are merged,
    `track` tells the stretch of sightings that it came with, `slot` is its place in iSAM2.
    """

    pose: int
    landmark: int
    range_m: float
    bearing: float
    covariance: FloatArray
    track: int = -1
    slot: int = field(default=-1, init=False)

    @classmethod
    def of(
        cls, perceptions: Perceptions, row: int, pose: int, landmark: int, track: int = -1
    ) -> Self:
        """A perception as a sighting; the less reliable, the less it weighs."""
        reliability = max(float(perceptions.reliabilities[row]), _LEAST_RELIABILITY)
        return cls(
            pose,
            landmark,
            float(perceptions.ranges_m[row]),
            float(perceptions.bearings[row]),
            perceptions.covariances[row] / reliability,
            track,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """One between factor: `motion` is start_T_end."""

    start: int
    end: int
    motion: UncertainPose2


def check_sighting(sighting: Sighting) -> None:
    """Raises GraphError where GTSAM would take nonsense in silence."""
    if not (_LEAST_RANGE_M <= sighting.range_m < np.inf and np.isfinite(sighting.bearing)):
        raise GraphError(
            f"sighting of landmark {sighting.landmark}: expected a positive range and a finite "
            f"bearing, got {sighting.range_m} m and {sighting.bearing} rad"
        )
    if _is_surely_definite(sighting.covariance):
        return
    covariance = frozen_covariance("sighting covariance", sighting.covariance, 2)
    check_definite(f"sighting of landmark {sighting.landmark}", covariance)


def _is_surely_definite(covariance: FloatArray) -> bool:
    """Whether a (2, 2) is well-behaved; there are millions, and numpy takes its time for each."""
    if covariance.shape != (2, 2):
        return False
    (a, b), (c, d) = covariance.tolist()
    return bool(0.0 < a < np.inf and 0.0 < d < np.inf and b == c and a * d - b * b > 1e-9 * a * d)


def check_definite(name: str, covariance: FloatArray) -> None:
    """Raises GraphError where a covariance is not positive definite."""
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise GraphError(f"{name}: expected a positive definite covariance") from None


def prior_factor(map_T_start: UncertainPose2) -> gtsam.PriorFactorPose2:
    """Where the start is."""
    noise = gtsam.noiseModel.Gaussian.Covariance(map_T_start.covariance)
    return gtsam.PriorFactorPose2(X(0), to_gtsam(map_T_start.pose), noise)


def odometry_factor(odometry: Odometry) -> gtsam.BetweenFactorPose2:
    """The motion between two poses."""
    noise = gtsam.noiseModel.Gaussian.Covariance(odometry.motion.covariance)
    motion = to_gtsam(odometry.motion.pose)
    return gtsam.BetweenFactorPose2(X(odometry.start), X(odometry.end), motion, noise)


def sighting_factor(sighting: Sighting, *, is_firm: bool = False) -> gtsam.BearingRangeFactor2D:
    """A sighting; GTSAM's order is bearing first.

    Args:
        sighting: that passed `check_sighting`.
        is_firm: without the robust kernel, however far off it is.
    """
    noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(
        sighting.covariance[::-1, ::-1]
    )
    if not is_firm:
        kernel = gtsam.noiseModel.mEstimator.DCS.Create(ROBUST_CHI2)
        noise = gtsam.noiseModel.Robust.Create(kernel, noise)
    return gtsam.BearingRangeFactor2D(
        X(sighting.pose),
        L(sighting.landmark),
        gtsam.Rot2(sighting.bearing),
        sighting.range_m,
        noise,
    )


def to_gtsam(pose: Pose2) -> gtsam.Pose2:
    """The same pose."""
    return gtsam.Pose2(pose.x, pose.y, pose.theta)
