"""How the fast estimator thinks the robot moves: without wheels, unseen, at first."""

import math

import numpy as np
import pytest

from semgraph.estimates import NoEstimate, NoEstimateReason
from semgraph.fast_estimator import FastSettings
from semgraph.geometry import Pose2, UncertainPose2, wrap_angle
from semgraph.motion_model import MotionNoise, constant_motion
from tests.semgraph.circles import (
    BEST,
    BOTH_RULES,
    SCAN_NS,
    START,
    arc,
    errors,
    exact_wheels,
    followed,
    seen,
    stand,
)


def test_a_start_from_standstill_is_caught_up_with() -> None:
    """Without wheels the prior first says that the robot stands: centimetres, not more."""
    poses, trees = arc(150), stand(2)
    steps, _ = followed(BEST, [seen(k, pose, trees) for k, pose in enumerate(poses)])
    off = np.abs(errors(steps, poses))
    assert off[:, :2].max() < 0.05
    assert off[:, 2].max() < 0.01


@BOTH_RULES
def test_a_gap_in_time_is_bridged_by_the_last_movement(settings: FastSettings) -> None:
    poses, trees = arc(120), stand()
    kept = [k for k in range(120) if not 50 <= k < 58]
    scans = [seen(k, poses[k], trees) for k in kept]
    steps, _ = followed(settings, scans)
    assert np.abs(errors(steps, [poses[k] for k in kept])).max() < 0.1
    ids = {step.stamp_ns: step.landmark_ids for step in steps}
    assert len(np.intersect1d(ids[49 * SCAN_NS], ids[58 * SCAN_NS])) > 5


def test_before_anything_is_seen_it_may_drive_as_fast_as_robots_do() -> None:
    """As unsure after four seconds of nothing as one motion of four seconds: 5 m/s and more."""
    steps, _ = followed(FastSettings(), [seen(k, START, np.zeros((0, 2))) for k in range(41)])
    variances = sum(float(step.motion.covariance[0, 0]) for step in steps[1:])
    assert variances**0.5 == pytest.approx(5.0 * 40 * SCAN_NS * 1e-9, rel=0.1)


def test_the_longer_nothing_is_matched_the_less_a_motion_is_sure() -> None:
    """One place halves a wandering velocity's error, two after each other tell the velocity."""
    trees, poses = stand(), arc(30)
    scans = [
        seen(k, pose, trees, 12.0 if k < 15 or k > 24 else 0.5) for k, pose in enumerate(poses)
    ]
    assert [len(scan) for scan in scans[15:25]] == [0] * 10
    steps, _ = followed(FastSettings(), scans)
    sigmas = np.sqrt([step.motion.covariance[0, 0] for step in steps])
    seconds = SCAN_NS * 1e-9
    noise = MotionNoise()
    steps_free = np.append(np.arange(1, 12), 1.0 + 0.25 * 10)
    expected = noise.floor_m + noise.acceleration * seconds**2 * steps_free
    np.testing.assert_allclose(sigmas[15:27], expected, rtol=1e-6)
    assert sigmas[27] == pytest.approx(sigmas[14])


def test_the_drift_that_the_first_match_takes_back_was_not_driven_in_that_step() -> None:
    """Unseen it drives 5 cm farther each tenth of a second than before and after.

    A velocity that wandered for 11 steps to leave 0.5 m is off by 1.5 * 0.5 m / 11 in a step.
    """
    trees, poses = stand(), arc(16)
    step = poses[0].between(poses[1])
    unseen = Pose2(step.x + 0.05, step.y, step.theta)
    for k in range(16, 34):
        poses.append(poses[-1] @ (unseen if k < 26 else step))
    scans = [seen(k, pose, trees, 0.5 if 16 <= k < 26 else 12.0) for k, pose in enumerate(poses)]
    steps, _ = followed(FastSettings(), scans)
    assert np.hypot(*errors(steps, poses)[25, :2]) > 0.4
    assert np.abs(errors(steps, poses)[26:, :2]).max() < 0.02
    speeds = np.array([each.motion.pose.x for each in steps[27:]])
    assert speeds[0] == pytest.approx(step.x + 1.5 * 0.5 / 11, abs=0.01)
    np.testing.assert_allclose(speeds[1:], step.x, atol=0.01)


def test_one_landmark_tells_more_than_the_motion_alone() -> None:
    """BEST fuses the single match that the closed form cannot use."""
    tree = START.transform(np.array([[6.0, 2.0]]))
    poses = arc(2)
    scans = [seen(k, pose, tree) for k, pose in enumerate(poses)]
    steps, _ = followed(BEST, scans)
    assert steps[1].closed_form == NoEstimate(NoEstimateReason.TOO_FEW_MATCHES)
    np.testing.assert_array_equal(steps[1].landmark_ids, [0])
    assert np.linalg.det(steps[1].map_T_base.covariance) < np.linalg.det(steps[1].motion.covariance)
    stands = START.between(poses[1])
    off = np.hypot(*errors(steps, poses)[1, :2])
    assert off < 0.7 * np.hypot(stands.x, stands.y)


def test_a_speed_that_one_landmark_alone_showed_is_no_known_speed() -> None:
    """It may have turned before it as well as driven past; the tracker goes on with what it has."""
    poses, tree = arc(24), START.transform(np.array([[4.0, 5.0]]))
    scans = [seen(k, pose, stand() if k > 11 else tree) for k, pose in enumerate(poses)]
    steps, _ = followed(BEST, scans)
    sigmas = np.sqrt([step.motion.covariance[0, 0] for step in steps[1:]])
    noise = MotionNoise()
    assert (sigmas[:12] > noise.unknown_speed * SCAN_NS * 1e-9).all()
    assert sigmas[-1] == pytest.approx(noise.floor_m + noise.acceleration * (SCAN_NS * 1e-9) ** 2)
    assert all(np.hypot(*(step.motion.pose.as_array()[:2])) > 0.05 for step in steps[2:12])


def test_the_motion_is_the_last_movement_once_more() -> None:
    poses, trees = arc(40), stand()
    kept = [k for k in range(40) if k not in (20, 21)]
    steps, _ = followed(BEST, [seen(k, poses[k], trees) for k in kept])
    noise = MotionNoise(BEST.acceleration, BEST.angular_acceleration)
    assert steps[0].motion.pose == steps[1].motion.pose == Pose2()
    for before, last, now in zip(steps, steps[1:], steps[2:], strict=False):
        moved = before.map_T_base.pose.between(last.map_T_base.pose)
        spans = np.diff([step.stamp_ns for step in (before, last, now)]) * 1e-9
        expected = constant_motion(moved, spans[0], spans[1], noise)
        np.testing.assert_allclose(now.motion.pose.as_array(), expected.pose.as_array(), atol=1e-12)
        np.testing.assert_allclose(now.motion.covariance, expected.covariance, rtol=1e-9)


def test_the_motion_is_that_of_the_wheels_where_there_are_any() -> None:
    poses, trees = arc(10), stand()
    wheels = exact_wheels(poses)
    steps, _ = followed(BEST, [seen(k, pose, trees) for k, pose in enumerate(poses)], wheels)
    assert all(step.motion is wheel for step, wheel in zip(steps, wheels, strict=True))


def test_wheels_that_are_off_are_corrected_within_the_search_radius() -> None:
    poses, trees = arc(60), stand()
    wheels = exact_wheels(poses)
    off = Pose2(0.4, -0.3, 0.06)
    wheels[30] = UncertainPose2(wheels[30].pose @ off, np.diag([0.5**2, 0.5**2, 0.1**2]))
    steps, _ = followed(BEST, [seen(k, pose, trees) for k, pose in enumerate(poses)], wheels)
    after = steps[30].map_T_base.pose.between(poses[30])
    assert math.hypot(after.x, after.y) < 0.01
    assert abs(wrap_angle(after.theta)) < 0.002
