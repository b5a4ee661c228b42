"""Whether covariances are honest: NEES, NIS, and the bounds that chance allows."""

from collections.abc import Sequence

import numpy as np

from evaluation.alignment import Alignment, rigid_alignment
from evaluation.landmarks import MapErrors
from evaluation.trajectory import comparable_rows, compare_path, compose, true_poses
from semgraph.arrays import FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2, relative_poses, rotation, transform_points
from semgraph.landmarks import Landmark
from sensors.truth import TrueLandmarks, TruePath


def normalized_squares(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """e^T P^-1 e (n,) of errors (n, d) and covariances (n, d, d): NEES, or NIS of innovations.

    NaN where a covariance is unknown or not positive definite.

    Source: Bar-Shalom, Li and Kirubarajan 2001, section 5.4.
    """
    known = np.flatnonzero(np.isfinite(covariances).all(axis=(1, 2)))
    usable = known[np.linalg.eigvalsh(covariances[known])[:, 0] > 0.0]
    squares = np.full(len(errors), np.nan)
    e = errors[usable][:, :, None]
    squares[usable] = (e.transpose(0, 2, 1) @ np.linalg.solve(covariances[usable], e))[:, 0, 0]
    return squares


def bounds_of_mean(dof: int, num_runs: int, coverage: float = 0.95) -> tuple[float, float]:
    """Between which the mean of `num_runs` independent chi-squares falls with that probability.

    The errors along one run are no independent samples; count runs, not poses.
    """
    tail = 0.5 * (1.0 - coverage)
    return (
        chi_square_quantile(tail, dof * num_runs) / num_runs,
        chi_square_quantile(1.0 - tail, dof * num_runs) / num_runs,
    )


def chi_square_quantile(probability: float, dof: int) -> float:
    """The value below which a chi-square of `dof` falls with that probability."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * dof, probability))


def observed_coverage(squares: FloatArray, dof: int, coverage: float = 0.95) -> float:
    """Which share of errors lies inside their own ellipses of that probability; NaN is left out."""
    known = squares[~np.isnan(squares)]
    return float(np.mean(known <= chi_square_quantile(coverage, dof)))


def gauge(estimate: Trajectory, truth: TruePath) -> Pose2 | None:
    """world_T_map that lays the start of the map onto the truth; None if they never meet.

    Covariances are relative to the start. With true headings the first pose is laid onto the
    first; without, its position, and the map is turned about it until the rest fits best.
    """
    start = compare_path(estimate, truth, Alignment.ORIGIN)
    if start is None:
        return None
    if truth.headings is not None:
        return start.world_T_map
    kept = ~start.is_outlier
    true = truth.world_t_reference[start.rows][kept]
    estimated = transform_points(start.world_T_bases, truth.base_t_reference)[kept]
    # Mirrored at the first point, the points keep their centroid there: only a turn is left.
    turn = rigid_alignment(_mirrored(true - true[0]), _mirrored(estimated - estimated[0]))
    to_true, from_estimated = (Pose2(*map(float, point)) for point in (true[0], -estimated[0]))
    return to_true @ Pose2(0.0, 0.0, turn.theta) @ from_estimated @ start.world_T_map


def pose_nees(
    estimate: Trajectory, covariances: FloatArray, truth: TruePath, world_T_map: Pose2
) -> FloatArray:
    """NEES (n,) at the compared times; 3 degrees of freedom with true headings, else 2.

    A pose between two estimates has the covariance of the nearer one. Covariances (m, 3, 3) are
    in each pose's own frame, and so are the errors. NaN where it cannot be told.
    """
    rows = comparable_rows(estimate, truth.stamps_ns)
    stamps_ns = truth.stamps_ns[rows]
    nearest = covariances[nearest_rows(estimate.stamps_ns, stamps_ns)]
    world_T_bases = compose(world_T_map, estimate.interpolate(stamps_ns))
    world_T_true = true_poses(truth)
    if world_T_true is not None:
        noise = np.diag([truth.sigma_m**2, truth.sigma_m**2, 0.0])
        errors = relative_poses(world_T_bases, world_T_true[rows])
        return normalized_squares(errors, nearest + noise)
    in_world = truth.world_t_reference[rows] - transform_points(
        world_T_bases, truth.base_t_reference
    )
    c, s = np.cos(world_T_bases[:, 2]), np.sin(world_T_bases[:, 2])
    along = c * in_world[:, 0] + s * in_world[:, 1]
    across = -s * in_world[:, 0] + c * in_world[:, 1]
    # The reference point moves with the pose: d(point) = [I | J base_t_reference] d(pose).
    x, y = truth.base_t_reference
    lever = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
    # Twice: this fix's own noise, and that of the first one, onto which the map was laid.
    noise = 2.0 * truth.sigma_m**2 * np.eye(2)
    return normalized_squares(np.column_stack([along, across]), lever @ nearest @ lever.T + noise)


def nearest_rows(stamps_ns: IntArray, wanted_ns: IntArray) -> IntArray:
    """The row (m,) of the time in (n,) nearest to each wanted time (m,); the earlier of two."""
    after = np.searchsorted(stamps_ns, wanted_ns).clip(max=len(stamps_ns) - 1)
    before = (after - 1).clip(min=0)
    nearer = wanted_ns - stamps_ns[before] <= stamps_ns[after] - wanted_ns
    return np.where(nearer, before, after)


def landmark_nees(
    landmarks: Sequence[Landmark], true: TrueLandmarks, matched: MapErrors, world_T_map: Pose2
) -> FloatArray:
    """NEES (k,) of the matched landmarks, 2 degrees of freedom, in the map as the gauge lays it."""
    found = [landmarks[row] for row in matched.map_rows]
    positions = np.array([landmark.map_t_landmark for landmark in found]).reshape(-1, 2)
    covariances = np.array([landmark.covariance for landmark in found]).reshape(-1, 2, 2)
    errors = world_T_map.transform(positions) - true.world_t_landmarks[matched.true_rows]
    R = rotation(world_T_map.theta)
    return normalized_squares(errors, R @ covariances @ R.T)


def _mirrored(points: FloatArray) -> FloatArray:
    return np.vstack([points, -points])
