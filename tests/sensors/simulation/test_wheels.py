"""Simulated wheels: how their errors grow, whatever the rate."""

import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.geometry import Pose2, UncertainPose2, relative_poses
from semgraph.motion_model import odometry_covariance
from sensors.measurements import OdometryNoise
from sensors.simulation.wheels import simulate_wheels
from tests.sensors.simulation.paths import circling, standing

SLIPPERY = OdometryNoise(0.03, 0.01, 0.005, 0.02)


def test_wheels_without_noise_tell_the_path() -> None:
    stamps_ns, poses = circling(70.0, 5.0)
    samples = simulate_wheels(stamps_ns, poses, OdometryNoise(0, 0, 0, 0), np.random.default_rng(0))
    odom_T_base = np.array([sample.odom_T_base.as_array() for sample in samples])
    expected = relative_poses(np.broadcast_to(poses[0], poses.shape), poses)
    np.testing.assert_allclose(odom_T_base[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.sin(odom_T_base[:, 2] - expected[:, 2]), 0.0, atol=1e-9)
    assert [sample.stamp_ns for sample in samples] == stamps_ns.tolist()


@pytest.mark.parametrize("rate_hz", [2.0, 20.0])
def test_the_drift_is_the_one_that_the_motion_model_predicts(rate_hz: float) -> None:
    """NEES of the last pose over runs; the prediction is composed step by step."""
    stamps_ns, poses = circling(10.0, rate_hz)
    predicted = UncertainPose2(Pose2(), np.zeros((3, 3)))
    for motion in map(Pose2.from_array, relative_poses(poses[:-1], poses[1:])):
        predicted = predicted @ UncertainPose2(motion, odometry_covariance(motion, SLIPPERY))
    rng = np.random.default_rng(101)
    errors = np.array(
        [
            predicted.pose.between(
                simulate_wheels(stamps_ns, poses, SLIPPERY, rng)[-1].odom_T_base
            ).as_array()
            for _ in range(200)
        ]
    )
    nees = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(predicted.covariance), errors)
    assert nees.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / 200))


def test_standing_wheels_stay_and_one_pose_is_enough() -> None:
    for seconds in (1.0, 5.0):
        samples = simulate_wheels(
            *standing(seconds, 1.0), OdometryNoise(), np.random.default_rng(0)
        )
        assert len(samples) == seconds
        assert {sample.odom_T_base for sample in samples} == {Pose2()}


def test_a_path_without_time_is_refused() -> None:
    with pytest.raises(InputError, match="simulated wheels: expected increasing stamps"):
        simulate_wheels(
            np.array([3, 3]), np.zeros((2, 3)), OdometryNoise(), np.random.default_rng(0)
        )
