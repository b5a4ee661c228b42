import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, UncertainPose2, relative_poses, transform_points
from semgraph.motion_model import (
    STANDSTILL_COVARIANCE,
    MotionHabit,
    MotionNoise,
    OdometryAccumulator,
    constant_motion,
    corrected,
    odometry_covariance,
    span_s2,
)
from sensors.measurements import OdometryNoise, WheelOdometry

BARE = MotionNoise(floor_m=1e-6)
NOISE = OdometryNoise(0.05, 0.02, 0.01, 0.05)
MOTIONS = st.builds(Pose2, st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-math.pi, math.pi))


def arc(length_m: float, turn: float, num_steps: int) -> list[Pose2]:
    """Poses along an arc, from the origin, both ends included."""
    angles = np.linspace(0.0, turn, num_steps + 1)
    radius = length_m / turn
    return [
        Pose2(radius * math.sin(angle), radius * (1.0 - math.cos(angle)), angle)
        for angle in angles.tolist()
    ]


def taken(poses: list[Pose2], noise: OdometryNoise = NOISE) -> UncertainPose2:
    accumulator = OdometryAccumulator(noise)
    for k, pose in enumerate(poses):
        accumulator.add(WheelOdometry(k, pose))
    return accumulator.take()


def test_variances_grow_with_distance_and_turn_in_the_order_x_y_theta() -> None:
    np.testing.assert_allclose(
        odometry_covariance(Pose2(3.0, 4.0, -2.0), NOISE),
        np.diag([0.05**2 * 5.0, 0.02**2 * 5.0, 0.01**2 * 5.0 + 0.05**2 * 2.0]),
    )


@given(MOTIONS, st.integers(1, 20))
def test_equal_variances_whatever_number_of_straight_steps(motion: Pose2, parts: int) -> None:
    """The along, across and heading variances of the steps add up to those of the whole."""
    part = Pose2(motion.x / parts, motion.y / parts, motion.theta / parts)
    np.testing.assert_allclose(
        parts * odometry_covariance(part, NOISE), odometry_covariance(motion, NOISE), atol=1e-12
    )


@given(st.lists(MOTIONS, min_size=2, max_size=8))
def test_the_motion_taken_leads_from_the_first_to_the_last_pose(poses: list[Pose2]) -> None:
    expected = poses[0].between(poses[-1])
    motion = taken(poses).pose
    assert (motion.x, motion.y) == pytest.approx((expected.x, expected.y), abs=1e-9)
    assert math.cos(motion.theta - expected.theta) == pytest.approx(1.0)


def test_taking_starts_anew_and_loses_nothing() -> None:
    poses = arc(10.0, 1.5, 20)
    accumulator = OdometryAccumulator(NOISE)
    pose = poses[0]
    for k, odom_T_base in enumerate(poses):
        accumulator.add(WheelOdometry(k, odom_T_base))
        if k % 7 == 3:
            pose = pose @ accumulator.take().pose
    pose = pose @ accumulator.take().pose
    np.testing.assert_allclose(pose.as_array(), poses[-1].as_array(), atol=1e-12)
    rest = accumulator.take()
    assert rest.pose == Pose2()
    np.testing.assert_array_equal(rest.covariance, STANDSTILL_COVARIANCE)


def test_how_often_the_wheels_are_read_does_not_matter() -> None:
    often, seldom = (taken(arc(10.0, 1.5, steps)).covariance for steps in (800, 200))
    scale = np.sqrt(np.outer(np.diag(often), np.diag(often)))
    np.testing.assert_allclose(often / scale, seldom / scale, atol=0.02)


def drawn_ends(poses: list[Pose2], count: int, rng: np.random.Generator) -> FloatArray:
    """(count, 3) ends of the way, each step with its own error drawn in the frame at its end."""
    ends = np.zeros((count, 3))
    for before, after in pairwise(poses):
        step = before.between(after)
        for motion in (
            np.tile(step.as_array(), (count, 1)),
            rng.multivariate_normal(np.zeros(3), odometry_covariance(step, NOISE), count),
        ):
            ends = np.column_stack(
                [transform_points(ends, motion[:, :2]), ends[:, 2] + motion[:, 2]]
            )
    return ends


def test_the_covariance_taken_is_that_of_monte_carlo() -> None:
    poses = arc(6.0, 1.2, 30)
    ends = drawn_ends(poses, 20_000, np.random.default_rng(1))
    claimed = taken(poses)
    errors = relative_poses(np.tile(claimed.pose.as_array(), (len(ends), 1)), ends)
    root = np.linalg.cholesky(claimed.covariance - STANDSTILL_COVARIANCE)
    np.testing.assert_allclose(np.cov(np.linalg.solve(root, errors.T)), np.eye(3), atol=0.06)


@pytest.mark.parametrize(("last_seconds", "seconds"), [(0.1, 0.1), (0.1, 0.3), (0.5, 0.1)])
def test_the_last_movement_is_scaled_to_the_time_passed(
    last_seconds: float, seconds: float
) -> None:
    motion = constant_motion(Pose2(0.4, -0.1, 0.2), last_seconds, seconds, MotionNoise())
    factor = seconds / last_seconds
    np.testing.assert_allclose(motion.pose.as_array(), factor * np.array([0.4, -0.1, 0.2]))


def test_without_a_last_movement_it_stands_still() -> None:
    assert constant_motion(Pose2(), 0.0, 0.1, MotionNoise()).pose == Pose2()


@pytest.mark.parametrize("seconds", [0.05, 0.2, 1.0])
def test_a_change_of_velocity_lies_within_the_noise_claimed(seconds: float) -> None:
    """At constant acceleration a the second movement differs from the first by a t^2."""
    noise = MotionNoise(acceleration=1.0, angular_acceleration=0.5)
    claimed = constant_motion(Pose2(1.0, 0.0, 0.0), seconds, seconds, noise).covariance
    assert claimed[0, 0] == pytest.approx((1.0 * seconds**2 + noise.floor_m) ** 2)
    assert claimed[1, 1] == claimed[0, 0]
    assert claimed[2, 2] == pytest.approx((0.5 * seconds**2 + noise.floor_rad) ** 2)


@given(st.floats(0.01, 5.0), st.floats(0.01, 5.0), st.floats(1.0, 4.0))
def test_the_longer_the_gap_the_less_is_known(
    last_seconds: float, seconds: float, longer: float
) -> None:
    short, long = (
        np.diag(constant_motion(Pose2(), last_seconds, span, MotionNoise()).covariance)
        for span in (seconds, longer * seconds)
    )
    assert (short <= long).all()


def test_a_velocity_that_wanders_unseen_is_as_far_off_as_the_motions_one_after_the_other() -> None:
    """Each repeats the last; every tenth of a second the velocity changes by chance."""
    rng = np.random.default_rng(5)
    noise = replace(BARE, unknown_speed=1e3)
    changes = rng.normal(scale=2.0 * 0.1, size=(20_000, 45))
    wandered_m = (changes.cumsum(axis=1) * 0.1).sum(axis=1)
    motion = Pose2(0.1, 0.0, 0.0)
    composed = UncertainPose2(Pose2(), np.zeros((3, 3)))
    for k in range(45):
        step = constant_motion(motion, 0.1, 0.1, noise, 0.1 * k)
        composed = composed @ UncertainPose2(motion, np.diag([*np.diag(step.covariance)[:2], 0.0]))
    assert composed.covariance[0, 0] ** 0.5 == pytest.approx(wandered_m.std(), rel=0.03)


def test_an_unknown_speed_leaves_open_what_it_would_in_one_motion() -> None:
    steps = [constant_motion(Pose2(), 0.0, 0.1, BARE, 0.1 * k).covariance for k in range(40)]
    whole = constant_motion(Pose2(), 0.0, 4.0, BARE).covariance
    np.testing.assert_allclose(np.sum(steps, axis=0)[:2, :2], whole[:2, :2], rtol=1e-3)


def habit(acceleration: float, turn: float, count: int) -> MotionNoise:
    """Learned from so many movements of 3 s whose velocity changed by as much."""
    rng = np.random.default_rng(3)
    learned, span = MotionHabit(MotionNoise()), span_s2(3.0, 3.0)
    for x, y, theta in (rng.normal(size=(count, 3)) * span).tolist():
        off = Pose2(acceleration * x, acceleration * y, turn * theta)
        learned.note(Pose2(3.0, 0.2, 0.1), Pose2(3.0, 0.2, 0.1) @ off, span)
    return learned.noise()


def test_a_habit_is_twice_what_was_usual_within_what_may_be() -> None:
    most = MotionNoise()
    assert habit(0.2, 0.04, 9) == most
    usual = habit(0.2, 0.1, 300)
    assert usual.acceleration == pytest.approx(0.4, rel=0.3)
    assert usual.angular_acceleration == pytest.approx(0.2, rel=0.3)
    assert habit(50.0, 0.1, 20).acceleration == most.acceleration
    steady = habit(0.0, 0.0, 20)
    assert (steady.acceleration, steady.angular_acceleration) == pytest.approx((0.1, 0.075))


def test_a_habit_is_of_the_last_movements() -> None:
    learned = MotionHabit(MotionNoise())
    for k in range(400):
        learned.note(Pose2(), Pose2(4.0 if k < 100 else 1.0, 0.0, 0.0), 4.0)
    assert learned.noise().acceleration == pytest.approx(2.0 * 0.25 / math.sqrt(2.0), rel=1e-3)


def test_what_a_place_takes_back_after_a_stretch_was_mostly_driven_before() -> None:
    """The gain of a Kalman filter with white acceleration over the stretch, to first order."""
    expected, moved = Pose2(0.2, 0.0, 0.02), Pose2(0.2, 0.0, 0.02) @ Pose2(0.4, -0.2, 0.1)
    assert corrected(expected, moved, 0.1).as_array() == pytest.approx(moved.as_array())
    after = corrected(expected, moved, 0.1, 1.9).as_array()
    seconds, steps = 0.1, 20
    transition = np.array([[1.0, seconds], [0.0, 1.0]])
    covariance = np.zeros((2, 2))
    for _ in range(steps):
        noise = np.array([[seconds**3 / 3.0, seconds**2 / 2.0], [seconds**2 / 2.0, seconds]])
        covariance = transition @ covariance @ transition.T + noise
    gain = covariance[1, 0] / covariance[0, 0] * seconds
    off = expected.between(Pose2.from_array(after)).as_array()
    assert off == pytest.approx(gain * np.array([0.4, -0.2, 0.1]), rel=1e-9)
