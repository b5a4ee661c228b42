"""SE(2): poses, their composition, and how their covariances travel.

Tangent vectors and covariances have the order (x, y, theta) and live in the pose's own body frame,
as in GTSAM's Pose2.
"""

import math
from dataclasses import dataclass
from typing import Self, overload

import numpy as np

from semgraph.arrays import FloatArray, frozen_floats
from semgraph.errors import InputError


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: FloatArray) -> FloatArray: ...
def wrap_angle(angle: float | FloatArray) -> float | FloatArray:
    """The same angle in [-pi, pi)."""
    wrapped = (angle + math.pi) % (2.0 * math.pi) - math.pi
    # Just below -pi the remainder rounds up to a full turn.
    return wrapped - 2.0 * math.pi * (wrapped >= math.pi)


def pose_in_degrees(x: float, y: float, yaw_deg: float) -> "Pose2":
    """The pose that a person wrote: m and degrees."""
    return Pose2(x, y, wrap_angle(math.radians(yaw_deg)))


def rotation(theta: float) -> FloatArray:
    """The (2, 2) matrix that turns by `theta`, counter-clockwise."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, slots=True)
class Pose2:
    """A pose or motion in the plane: `map_T_base` takes coordinates in base to map.

    Raises:
        InputError: a component is not finite.
    """

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.x + self.y + self.theta):
            raise InputError(f"pose: expected finite x, y, theta, got {self}")

    def __matmul__(self, other: "Pose2") -> "Pose2":
        """a_T_c = a_T_b @ b_T_c."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.theta + other.theta),
        )

    def inverse(self) -> "Pose2":
        """b_T_a of a_T_b."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.theta))

    def between(self, other: "Pose2") -> "Pose2":
        """b_T_c of map_T_b and map_T_c: the motion from this pose to the other."""
        return self.inverse() @ other

    def transform(self, points: FloatArray) -> FloatArray:
        """a_t_points (n, 2) of b_t_points (n, 2)."""
        return points @ rotation(self.theta).T + (self.x, self.y)

    def adjoint(self) -> FloatArray:
        """The (3, 3) matrix that takes a tangent vector from frame b of a_T_b to frame a."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return np.array([[c, -s, self.y], [s, c, -self.x], [0.0, 0.0, 1.0]])

    def as_array(self) -> FloatArray:
        """(3,) x, y, theta."""
        return np.array([self.x, self.y, self.theta])

    @classmethod
    def from_array(cls, values: FloatArray) -> Self:
        """The pose of (3,) x, y, theta."""
        x, y, theta = (float(value) for value in values)
        return cls(x, y, theta)


@dataclass(frozen=True, slots=True, eq=False)
class UncertainPose2:
    """A pose with the (3, 3) covariance of its tangent (x, y, theta) in the pose's own frame.

    Raises:
        InputError: the covariance is not a finite, symmetric, positive semi-definite (3, 3).
    """

    pose: Pose2
    covariance: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "covariance", frozen_covariance("pose covariance", self.covariance, 3)
        )

    def __matmul__(self, other: "UncertainPose2") -> "UncertainPose2":
        """a_T_c of independent a_T_b and b_T_c, to first order.

        Source: Barfoot and Furgale 2014, eq. 38 without the fourth-order terms.
        """
        c_Ad_b = other.pose.inverse().adjoint()
        covariance = c_Ad_b @ self.covariance @ c_Ad_b.T + other.covariance
        return UncertainPose2(self.pose @ other.pose, covariance)

    def inverse(self) -> "UncertainPose2":
        """b_T_a of a_T_b, its covariance brought into frame a."""
        a_Ad_b = self.pose.adjoint()
        return UncertainPose2(self.pose.inverse(), a_Ad_b @ self.covariance @ a_Ad_b.T)

    def transform(
        self, points: FloatArray, covariances: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """a_t_points (n, 2) of b_t_points (n, 2), and their covariances (n, 2, 2) in a.

        Each of the pose's and its own together, to first order; what the points share by the pose
        is left out.
        """
        jacobians = np.zeros((len(points), 2, 3))
        jacobians[:, 0, 0] = jacobians[:, 1, 1] = 1.0
        jacobians[:, 0, 2], jacobians[:, 1, 2] = -points[:, 1], points[:, 0]
        in_b = covariances + jacobians @ self.covariance @ jacobians.transpose(0, 2, 1)
        a_R_b = rotation(self.pose.theta)
        return self.pose.transform(points), a_R_b @ in_b @ a_R_b.T


def frozen_covariance(name: str, values: FloatArray, size: int) -> FloatArray:
    """A read-only (size, size) covariance, made exactly symmetric.

    Raises:
        InputError: not finite, not symmetric, or not positive semi-definite.
    """
    covariance = frozen_floats(name, values, (size, size))
    sizes = np.abs(covariance)
    scale = float(sizes.max(initial=0.0))
    if not (np.abs(covariance - covariance.T) <= 1e-9 * scale + 1e-6 * sizes).all():
        raise InputError(f"{name}: expected a symmetric matrix")
    symmetric = 0.5 * (covariance + covariance.T)
    if float(np.linalg.eigvalsh(symmetric)[0]) < -1e-9 * scale:
        raise InputError(f"{name}: expected a positive semi-definite matrix")
    symmetric.flags.writeable = False
    return symmetric


def transform_points(map_T_bases: FloatArray, base_t_points: FloatArray) -> FloatArray:
    """map_t_points (n, 2) of poses (n, 3) and a point (n, 2) or (2,) in each pose's frame."""
    c, s = np.cos(map_T_bases[:, 2]), np.sin(map_T_bases[:, 2])
    x, y = base_t_points[..., 0], base_t_points[..., 1]
    return map_T_bases[:, :2] + np.column_stack([c * x - s * y, s * x + c * y])


def relative_poses(map_T_a: FloatArray, map_T_b: FloatArray) -> FloatArray:
    """a_T_b (n, 3) of two rows of poses (n, 3)."""
    delta = map_T_b - map_T_a
    c, s = np.cos(map_T_a[:, 2]), np.sin(map_T_a[:, 2])
    return np.column_stack(
        [
            c * delta[:, 0] + s * delta[:, 1],
            -s * delta[:, 0] + c * delta[:, 1],
            wrap_angle(delta[:, 2]),
        ]
    )


def composed_poses(a_T_b: FloatArray, b_T_c: FloatArray) -> FloatArray:
    """a_T_c (n, 3) of rows a_T_b and b_T_c (n, 3)."""
    headings = wrap_angle(a_T_b[:, 2] + b_T_c[:, 2])
    return np.column_stack([transform_points(a_T_b, b_T_c[:, :2]), headings])


def points_from(map_T_bases: FloatArray, map_t_points: FloatArray) -> FloatArray:
    """base_t_points (n, 2) of points (n, 2), each as seen from a pose of (n, 3)."""
    x, y = (map_t_points - map_T_bases[:, :2]).T
    c, s = np.cos(map_T_bases[:, 2]), np.sin(map_T_bases[:, 2])
    return np.column_stack([c * x + s * y, c * y - s * x])
