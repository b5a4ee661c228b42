"""How the robot moves between two scans: wheel odometry, or the last movement once more."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, UncertainPose2
from sensors.measurements import OdometryNoise, WheelOdometry


def odometry_covariance(motion: Pose2, noise: OdometryNoise) -> FloatArray:
    """(3, 3) covariance of one short odometry step, in the frame at its end.

    Variances grow with the distance and with the angle turned, so that the sum over many short
    steps does not depend on how often the wheels are read.
    """
    distance = float(np.hypot(motion.x, motion.y))
    turned = abs(motion.theta)
    heading = noise.heading_per_sqrt_m**2 * distance + noise.heading_per_sqrt_rad**2 * turned
    along = noise.along_per_sqrt_m**2 * distance
    across = noise.across_per_sqrt_m**2 * distance
    return np.diag([along, across, heading])


# Wheels that stand still may still slip: what any odometry between two scans leaves open.
STANDSTILL_COVARIANCE = np.diag([1e-3**2, 1e-3**2, 2e-4**2])


@dataclass(slots=True)
class OdometryAccumulator:
    """Composes wheel odometry between two scans, mean and covariance."""

    noise: OdometryNoise
    _last: Pose2 | None = None
    _motion: UncertainPose2 = field(
        default_factory=lambda: UncertainPose2(Pose2(), np.zeros((3, 3)))
    )

    def add(self, sample: WheelOdometry) -> None:
        """Appends the motion since the sample before."""
        if self._last is not None:
            step = self._last.between(sample.odom_T_base)
            covariance = odometry_covariance(step, self.noise)
            self._motion = self._motion @ UncertainPose2(step, covariance)
        self._last = sample.odom_T_base

    def take(self) -> UncertainPose2:
        """The motion since the last `take`; the next one starts from here."""
        motion = self._motion
        self._motion = UncertainPose2(Pose2(), np.zeros((3, 3)))
        return UncertainPose2(motion.pose, motion.covariance + STANDSTILL_COVARIANCE)


# The standard deviation of a heading that may be any: uniform over the circle.
_UNKNOWN_HEADING: Final = np.pi / np.sqrt(3.0)


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """How much a velocity may change, where nothing measures the motion (1 sigma).

    After a long gap the speed is as unknown as before the first movement.
    """

    acceleration: float = 2.0
    angular_acceleration: float = 1.5
    floor_m: float = 0.02
    floor_rad: float = 0.01
    unknown_speed: float = 5.0
    unknown_turn_rate: float = 1.0


# So many changes of velocity are remembered, and so many must be.
_REMEMBERED: Final = 30
_LEAST: Final = 10
# Twice what was usual, and never less than this share of the most, for habits change.
_USUAL: Final = 2.0
_LEAST_SHARE: Final = 0.05


@dataclass(slots=True)
class MotionHabit:
    """How much the velocity has changed lately, as far as that was perceived.

    Args:
        most: how much it may.
    """

    most: MotionNoise
    _count: int = 0
    _accelerations2: FloatArray = field(default_factory=lambda: np.zeros(2))

    def note(self, expected: Pose2, moved: Pose2, span_s2: float) -> None:
        """One movement more, and what it would have been once more; (s^2) by which it errs."""
        off = expected.between(moved)
        changes2 = np.array([0.5 * (off.x**2 + off.y**2), off.theta**2]) / span_s2**2
        self._count += 1
        self._accelerations2 += (changes2 - self._accelerations2) / min(self._count, _REMEMBERED)

    def noise(self) -> MotionNoise:
        """By what is usual; the most until that is known."""
        if self._count < _LEAST:
            return self.most
        most = np.array([self.most.acceleration, self.most.angular_acceleration])
        usual = _USUAL * np.sqrt(self._accelerations2)
        linear, angular = np.clip(usual, _LEAST_SHARE * most, most).tolist()
        return replace(self.most, acceleration=linear, angular_acceleration=angular)


def span_s2(last_seconds: float, seconds: float) -> float:
    """What an acceleration is to be multiplied by, for the error of `constant_motion`."""
    return seconds * max(seconds, last_seconds)


def constant_motion(
    last_motion: Pose2,
    last_seconds: float,
    seconds: float,
    noise: MotionNoise,
    unseen_seconds: float = 0.0,
) -> UncertainPose2:
    """The last movement once more, scaled to the time that has passed.

    Before the first movement the speed is unknown altogether. Where for `unseen_seconds` nothing
    showed how the robot moved, the velocity had as long to change in: motions one after the other,
    composed as if each erred for itself, then add up to what a velocity that wanders, or that is
    unknown, leaves open.

    Source: paper section 3.3, the proposed frame. The covariance is this project's.
    """
    if last_seconds <= 0.0:
        # As far off as one motion over all the time would be.
        unknown = (seconds * (seconds + 2.0 * unseen_seconds)) ** 0.5
        sigma_m = noise.unknown_speed * unknown + noise.floor_m
        sigma_rad = min(noise.unknown_turn_rate * unknown + noise.floor_rad, _UNKNOWN_HEADING)
        return UncertainPose2(Pose2(), np.diag([sigma_m**2, sigma_m**2, sigma_rad**2]))
    scale = seconds / last_seconds
    motion = Pose2(last_motion.x * scale, last_motion.y * scale, last_motion.theta * scale)
    span = span_s2(last_seconds, seconds) + seconds * unseen_seconds
    sigma_m = min(noise.acceleration * span, noise.unknown_speed * seconds) + noise.floor_m
    sigma_rad = min(noise.angular_acceleration * span, noise.unknown_turn_rate * seconds)
    sigma_rad = min(sigma_rad + noise.floor_rad, _UNKNOWN_HEADING)
    return UncertainPose2(motion, np.diag([sigma_m**2, sigma_m**2, sigma_rad**2]))


def corrected(expected: Pose2, moved: Pose2, seconds: float, unseen_seconds: float = 0.0) -> Pose2:
    """The movement that a place found now leaves for the next: where it is, and how fast.

    What was unseen for T s and is found beside where it was expected did not get there in the
    last step. Of a velocity that wanders, the best estimate takes 3 / (2 T) of the distance.

    Args:
        expected: last_T_current by the motion model.
        moved: the same as it was found.
        seconds: between the two.
        unseen_seconds: before, for which nothing showed how the robot moved.

    Source: the Kalman gain of a velocity that wanders, P_vx / P_xx = (T^2 / 2) / (T^3 / 3).
    """
    share = min(1.0, 1.5 * seconds / (unseen_seconds + seconds))
    off = expected.between(moved)
    return expected @ Pose2(share * off.x, share * off.y, share * off.theta)
