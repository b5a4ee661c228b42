"""What the graph is made of: odometry and sightings, as values and as GTSAM's factors."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Self

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.geometry import Pose2, UncertainPose2, frozen_covariance
from semgraph.graph.condensation import Condensed, linearized, whitened_errors
from semgraph.landmarks import Perceptions

# A sighting within this chi-square is taken as it is, one beyond it ever less (DCS; Agarwal 2013).
ROBUST_CHI2: Final = 13.8155
_KERNEL: Final = gtsam.noiseModel.mEstimator.DCS.Create(ROBUST_CHI2)
_LEAST_RANGE_M: Final = 1e-3
# How stiffly what rests holds the rest: about as sure as things near each other are of each other.
_HELD_M: Final = 0.01
_HELD_RAD: Final = 0.001
_LEAST_RELIABILITY: Final = 0.05
# A determinant that is this share of the diagonal's product is positive however it is rounded.
_SURELY: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One bearing-range factor: pose `pose` saw landmark `landmark`.

    `covariance` (2, 2) is of (range, bearing), `track` tells the stretch of sightings that it came
    with, `common_share` how much of the range's variance all sightings of the landmark share.
    The diameter is NaN where none was perceived.
    """

    pose: int
    landmark: int
    range_m: float
    bearing: float
    covariance: FloatArray
    track: int = -1
    common_share: float = 0.0
    diameter_m: float = np.nan
    diameter_sigma_m: float = np.nan

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
            float(perceptions.common_shares[row]),
            float(perceptions.diameters_m[row]),
            float(perceptions.diameter_sigmas_m[row]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """One between factor: `motion` is start_T_end."""

    start: int
    end: int
    motion: UncertainPose2


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """What holds poses and landmarks in the map: where one pose is, and the others beside it.

    Attributes:
        anchor: that pose.
        map_T_anchor: as surely as it is known.
        anchor_T_poses: of others, held stiffly.
        anchor_t_landmarks: (2,) the same.
    """

    anchor: int
    map_T_anchor: UncertainPose2
    anchor_T_poses: Mapping[int, Pose2] = field(default_factory=dict)
    anchor_t_landmarks: Mapping[int, FloatArray] = field(default_factory=dict)


def pose_key(pose: int) -> int:
    """What GTSAM calls a pose."""
    return int(X(pose))


def landmark_key(landmark: int) -> int:
    """What GTSAM calls a landmark."""
    return int(L(landmark))


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
    # As the log keeps it: what is nearly singular may be so no more in 32 bit.
    kept = covariance.astype(np.float32).astype(np.float64)
    check_definite(f"sighting of landmark {sighting.landmark}", kept)


def _is_surely_definite(covariance: FloatArray) -> bool:
    """Whether a (2, 2) is well-behaved; there are millions, and numpy takes its time for each."""
    if covariance.shape != (2, 2):
        return False
    (a, b), (c, d) = covariance.tolist()
    is_sound = 0.0 < a < np.inf and 0.0 < d < np.inf and b == c
    return bool(is_sound and a * d - b * b > _SURELY * a * d)


def _is_surely_definite_pose(covariance: FloatArray) -> bool:
    """The same of a (3, 3)."""
    (a, b, c), (_, d, e), (_, _, f) = covariance.tolist()
    is_sound = 0.0 < a < np.inf and 0.0 < d < np.inf and 0.0 < f < np.inf
    minor = a * d - b * b
    determinant = minor * f - a * e * e - d * c * c + 2.0 * b * c * e
    return bool(is_sound and minor > _SURELY * a * d and determinant > _SURELY * a * d * f)


def check_definite(name: str, covariance: FloatArray) -> None:
    """Raises GraphError where a covariance is not positive definite."""
    if len(covariance) == 3 and _is_surely_definite_pose(covariance):
        return
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise GraphError(f"{name}: expected a positive definite covariance") from None


def prior_factor(map_T_pose: UncertainPose2, pose: int = 0) -> gtsam.PriorFactorPose2:
    """Where a pose is, the start if not said otherwise."""
    noise = gtsam.noiseModel.Gaussian.Covariance(map_T_pose.covariance)
    return gtsam.PriorFactorPose2(X(pose), to_gtsam(map_T_pose.pose), noise)


def hold_factors(hold: Hold) -> Iterator[gtsam.NonlinearFactor]:
    """All that it is made of."""
    yield prior_factor(hold.map_T_anchor, hold.anchor)
    stiff = gtsam.noiseModel.Diagonal.Sigmas(np.array([_HELD_M, _HELD_M, _HELD_RAD]))
    for pose, anchor_T_pose in hold.anchor_T_poses.items():
        yield gtsam.BetweenFactorPose2(X(hold.anchor), X(pose), to_gtsam(anchor_T_pose), stiff)
    for landmark, (x, y) in hold.anchor_t_landmarks.items():
        range_m = max(float(np.hypot(x, y)), _LEAST_RANGE_M)
        sigmas = np.array([_HELD_M / range_m, _HELD_M])
        bearing = gtsam.Rot2(float(np.arctan2(y, x)))
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        yield gtsam.BearingRangeFactor2D(X(hold.anchor), L(landmark), bearing, range_m, noise)


def odometry_factor(odometry: Odometry) -> gtsam.BetweenFactorPose2:
    """The motion between two poses."""
    motion = odometry.motion
    return motion_factor(odometry.start, odometry.end, motion.pose.as_array(), motion.covariance)


def motion_factor(
    start: int, end: int, motion: FloatArray, covariance: FloatArray
) -> gtsam.BetweenFactorPose2:
    """The same of (3,) start_T_end and its (3, 3) covariance, both checked before."""
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return gtsam.BetweenFactorPose2(X(start), X(end), gtsam.Pose2(*motion.tolist()), noise)


def sighting_factor(sighting: Sighting, *, is_firm: bool = False) -> gtsam.BearingRangeFactor2D:
    """A sighting; GTSAM's order is bearing first.

    Args:
        sighting: that passed `check_sighting`.
        is_firm: without the robust kernel, however far off it is.
    """
    polar = (sighting.range_m, sighting.bearing)
    return polar_factor(
        sighting.pose, sighting.landmark, polar, sighting.covariance, is_firm=is_firm
    )


def polar_factor(
    pose: int,
    landmark: int,
    polar: Sequence[float],
    covariance: FloatArray,
    *,
    is_firm: bool = False,
) -> gtsam.BearingRangeFactor2D:
    """The same of range and bearing and their (2, 2) covariance, both checked before."""
    noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(covariance[::-1, ::-1])
    if not is_firm:
        noise = gtsam.noiseModel.Robust.Create(_KERNEL, noise)
    range_m, bearing = polar
    return gtsam.BearingRangeFactor2D(X(pose), L(landmark), gtsam.Rot2(bearing), range_m, noise)


def to_gtsam(pose: Pose2) -> gtsam.Pose2:
    """The same pose."""
    return gtsam.Pose2(pose.x, pose.y, pose.theta)


def condensed_factor(
    condensed: Condensed, first: int, last: int, landmarks: IntArray
) -> gtsam.CustomFactor:
    """A stretch between two poses; GTSAM has no such factor, so it is in Python.

    Args:
        condensed: of the stretch.
        first: pose of the graph.
        last: pose of the graph.
        landmarks: (n,) that its things are; several may be one.
    """
    names, columns = np.unique(landmarks, return_inverse=True)
    keys = [X(first), X(last), *(L(name) for name in names.tolist())]
    noise = gtsam.noiseModel.Unit.Create(condensed.size)
    is_each_own = np.array_equal(names, landmarks)

    def error(
        _: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any | None
    ) -> NDArray[np.float64]:
        first_pose, last_pose = values.atPose2(keys[0]), values.atPose2(keys[1])
        places = np.array([values.atPoint2(key) for key in keys[2:]]).reshape(-1, 2)
        where = (
            np.array([first_pose.x(), first_pose.y(), first_pose.theta()]),
            np.array([last_pose.x(), last_pose.y(), last_pose.theta()]),
            places[columns],
        )
        if jacobians is None:
            return np.asarray(whitened_errors(condensed, *where), dtype=np.float64)
        errors, by_first, by_last, by_things = linearized(condensed, *where)
        jacobians[0], jacobians[1] = by_first, by_last
        if not is_each_own:
            by_things = _summed(by_things, columns, len(names))
        for k in range(len(names)):
            jacobians[k + 2] = by_things[:, k]
        return np.asarray(errors, dtype=np.float64)

    return gtsam.CustomFactor(noise, keys, error)


def _summed(by_things: FloatArray, columns: IntArray, count: int) -> FloatArray:
    """(d, count, 2) of (d, n, 2): things that are one landmark move together."""
    summed = np.zeros((len(by_things), count, 2))
    for thing, column in enumerate(columns.tolist()):
        summed[:, column] += by_things[:, thing]
    return summed


def whitened(linear: gtsam.GaussianFactorGraph) -> tuple[csr_matrix, dict[int, IntArray]]:
    """The whitened Jacobian (m, n) of a linear graph, and the columns of each key."""
    row, column, value = linear.sparseJacobian_()
    widths = {key: 2 if key < X(0) else 3 for key in sorted(linear.keys())}
    starts = np.cumsum([0, *widths.values()])
    columns = {
        key: np.arange(start, start + width)
        for (key, width), start in zip(widths.items(), starts[:-1].tolist(), strict=True)
    }
    # The last column is the right side.
    whole = csr_matrix((value, (row.astype(np.int64) - 1, column.astype(np.int64) - 1)))
    return whole[:, : starts[-1]], columns
