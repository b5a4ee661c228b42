"""The closed-form motion estimate between perceived and mapped landmarks (section 3.3, step 2)."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.estimates import NoEstimate, NoEstimateReason
from semgraph.geometry import (
    Pose2,
    UncertainPose2,
    composed_poses,
    points_from,
    relative_poses,
    rotation,
)


class Solve(Enum):
    """Which closed form: the rigid optimum, or the paper's four free unknowns."""

    RIGID = "rigid"
    SIMILARITY = "similarity"


@dataclass(frozen=True, slots=True)
class Alignment:
    """The estimate with its covariance, and the scale of the paper's solve.

    |scale - 1| is an alarm for wrong matches, since distances between landmarks stay fixed.
    """

    map_T_base: UncertainPose2
    scale: float


def align(
    base_t_landmarks: FloatArray,
    map_t_landmarks: FloatArray,
    variances: FloatArray,
    solve: Solve = Solve.RIGID,
) -> Alignment | NoEstimate:
    """Weighted rigid fit of perceived landmarks to mapped ones: R p + t = l.

    Args:
        base_t_landmarks: (n, 2) m. Row k pairs with row k of the map.
        map_t_landmarks: (n, 2) m.
        variances: (n,) m2, per axis, of each pair's difference.
        solve: RIGID, or the paper's least squares over (cos, sin, u, v) with equal weights.

    Returns:
        map_T_base with its covariance; or NoEstimate below 2 landmarks or if they coincide.

    Raises:
        InputError: shapes disagree.

    Source: paper section 3.3, second step, where x solves R p + t = l although the text says
    R l + t = p. Differs: rigid; after atan2 the angle is the same, the translation is better.
    """
    n = len(map_t_landmarks)
    shapes = (base_t_landmarks.shape, map_t_landmarks.shape, variances.shape)
    if shapes != ((n, 2), (n, 2), (n,)):
        raise InputError(f"alignment: shapes disagree: {shapes[0]}, {shapes[1]}, {shapes[2]}")
    if n < 2:
        return NoEstimate(NoEstimateReason.TOO_FEW_MATCHES)
    weights = 1.0 / variances if solve is Solve.RIGID else np.ones(len(variances))
    p_mean, l_mean = (
        weights @ each / weights.sum() for each in (base_t_landmarks, map_t_landmarks)
    )
    p, q = base_t_landmarks - p_mean, map_t_landmarks - l_mean
    spread = float(weights @ (p**2).sum(axis=1))
    cosine = float(weights @ (p * q).sum(axis=1))
    sine = float(weights @ (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))
    # Where the spread is below one sigma the heading is noise.
    is_degenerate = float(((p**2).sum(axis=1) / variances).sum()) < len(p)
    if is_degenerate or np.hypot(cosine, sine) < 1e-12:
        return NoEstimate(NoEstimateReason.DEGENERATE_GEOMETRY)
    theta = float(np.arctan2(sine, cosine))
    scale = float(np.hypot(cosine, sine)) / spread
    map_R_base = rotation(theta) * (1.0 if solve is Solve.RIGID else scale)
    x, y = l_mean - map_R_base @ p_mean
    covariance = _covariance(base_t_landmarks, variances, solve)
    return Alignment(UncertainPose2(Pose2(float(x), float(y), theta), covariance), scale)


def _covariance(base_t_landmarks: FloatArray, variances: FloatArray, solve: Solve) -> FloatArray:
    """(3, 3) in the pose's body tangent; the paper's solve pays for its free scale and weights."""
    if solve is Solve.RIGID:
        return np.linalg.inv(
            pose_information(base_t_landmarks, np.eye(2) / variances[:, None, None])
        )
    J = np.concatenate([point_jacobians(base_t_landmarks), base_t_landmarks[:, :, None]], axis=2)
    J = J.reshape(-1, 4)
    # Of x = (J^T J)^-1 J^T b, where b has these variances.
    gain = np.linalg.inv(J.T @ J) @ J.T
    covariance: FloatArray = (gain * np.repeat(variances, 2) @ gain.T)[:3, :3]
    return covariance


def pose_information(base_t_landmarks: FloatArray, weights: FloatArray) -> FloatArray:
    """(3, 3) information on the pose in its body tangent, from pairs weighted (n, 2, 2) in base.

    From d(R p + t) = R (dt + dtheta (-p_y, p_x)).
    """
    J = point_jacobians(base_t_landmarks)
    information: FloatArray = (J.transpose(0, 2, 1) @ weights @ J).sum(axis=0)
    return information


def point_jacobians(base_t_landmarks: FloatArray) -> FloatArray:
    """(n, 2, 3): how a point fixed to base moves, in base, with the pose's body tangent."""
    J = np.zeros((len(base_t_landmarks), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2] = -base_t_landmarks[:, 1]
    J[:, 1, 2] = base_t_landmarks[:, 0]
    return J


def fuse_with_prior(
    map_T_base: Pose2,
    prior: UncertainPose2,
    base_t_landmarks: FloatArray,
    map_t_landmarks: FloatArray,
    base_covariances: FloatArray,
) -> UncertainPose2:
    """The pose that the motion model and the matched landmarks agree on, weighted by covariance.

    Args:
        map_T_base: where to start, e.g. the closed form.
        prior: the motion model's map_T_base.
        base_t_landmarks: (n, 2) perceived, n >= 0.
        map_t_landmarks: (n, 2) of the map.
        base_covariances: (n, 2, 2) of each pair's difference, in base.

    Source: Gauss-Newton on SE(2); for one landmark it is what the closed form cannot give.
    """
    J = point_jacobians(base_t_landmarks)
    JT_W = J.transpose(0, 2, 1) @ np.linalg.inv(base_covariances)
    prior_information = np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(prior_information + (JT_W @ J).sum(axis=0))
    flat = JT_W.transpose(1, 0, 2).reshape(3, -1)
    pose = map_T_base
    for _ in range(3):
        residuals = pose.inverse().transform(map_t_landmarks) - base_t_landmarks
        to_prior = pose.between(prior.pose).as_array()
        gradient = flat @ residuals.ravel() + prior_information @ to_prior
        pose = pose @ Pose2.from_array(covariance @ gradient)
    return UncertainPose2(pose, covariance)


def fuse_with_priors(
    map_T_bases: FloatArray,
    priors: FloatArray,
    prior_covariance: FloatArray,
    owners: IntArray,
    base_t_landmarks: FloatArray,
    map_t_landmarks: FloatArray,
    base_covariances: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """The same for h poses (h, 3) at once, and covariances (h, 3, 3), in base.

    Args:
        map_T_bases: (h, 3) where to start.
        priors: (h, 3) the motion model's.
        prior_covariance: (3, 3) of each of them, in base.
        owners: (n,) whose of the poses each landmark is.
        base_t_landmarks: (n, 2) perceived.
        map_t_landmarks: (n, 2) of the map.
        base_covariances: (n, 2, 2) of each pair's difference, in base.
    """
    is_of = (owners == np.arange(len(priors))[:, None]).astype(np.float64)
    J = point_jacobians(base_t_landmarks)
    JT_W = J.transpose(0, 2, 1) @ np.linalg.inv(base_covariances)
    prior_information = np.linalg.inv(prior_covariance)
    information = prior_information + (is_of @ (JT_W @ J).reshape(-1, 9)).reshape(-1, 3, 3)
    covariances = np.linalg.inv(information)
    poses = map_T_bases
    for _ in range(3):
        mapped = points_from(poses[owners], map_t_landmarks)
        by_landmarks = (JT_W @ (mapped - base_t_landmarks)[:, :, None])[:, :, 0]
        gradients = is_of @ by_landmarks + relative_poses(poses, priors) @ prior_information
        poses = composed_poses(poses, (covariances @ gradients[:, :, None])[:, :, 0])
    return poses, covariances
