"""The Gaussian of EKF-SLAM against numerical derivatives and the textbook's dense matrices."""

import numpy as np
import pytest

from evaluation.estimators.pose_and_map import PoseAndMap
from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2, UncertainPose2, rotation
from semgraph.landmarks import polar_covariances
from semgraph.measurement_model import predict

NOISE = polar_covariances(np.full(6, 0.03), np.full(6, 0.005))


def made(seed: int = 0) -> PoseAndMap:
    """Six landmarks seen from an unsure pose, after some driving."""
    rng = np.random.default_rng(seed)
    state = PoseAndMap(UncertainPose2(Pose2(1.0, -2.0, 0.7), np.diag([0.02, 0.01, 0.004])))
    state.add(rng.uniform(2.0, 12.0, 6), rng.uniform(-2.0, 2.0, 6), NOISE)
    for _ in range(3):
        state.move(UncertainPose2(Pose2(0.4, 0.02, 0.1), np.diag([4e-4, 1e-4, 1e-4])))
    return state


def moved(state: PoseAndMap, error: FloatArray) -> tuple[Pose2, FloatArray]:
    """The state with an error (3 + 2n,) added as its covariance means it."""
    pose = state.pose @ Pose2.from_array(error[:3])
    return pose, state.map_t_landmarks + error[3:].reshape(-1, 2)


def jacobian(state: PoseAndMap, rows: IntArray) -> FloatArray:
    """(2k, 3 + 2n) by central differences."""
    size, step = 3 + 2 * len(state), 1e-6
    columns = []
    for k in range(size):
        error = np.zeros(size)
        error[k] = step
        ahead, behind = (
            predict(pose, landmarks[rows])
            for pose, landmarks in (moved(state, error), moved(state, -error))
        )
        columns.append((ahead - behind).ravel() / (2.0 * step))
    return np.column_stack(columns)


def block(noise: FloatArray) -> FloatArray:
    whole = np.zeros((2 * len(noise), 2 * len(noise)))
    for k, each in enumerate(noise):
        whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = each
    return whole


def test_what_is_expected_is_as_unsure_as_the_whole_state_says() -> None:
    state, rows = made(), np.array([4, 0, 2])
    H = jacobian(state, rows)
    joint = H @ state.covariance @ H.T
    np.testing.assert_allclose(state.joint_covariance(rows), joint, rtol=1e-5, atol=1e-9)
    _, each = state.expected(rows)
    for k in range(3):
        own = joint[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        np.testing.assert_allclose(each[k], own, rtol=1e-5, atol=1e-9)


def test_a_correction_is_the_textbooks() -> None:
    state, rows = made(1), np.array([5, 1])
    H, P, noise = jacobian(state, rows), np.array(state.covariance), block(NOISE[:2])
    before = made(1)
    innovations = np.array([[0.05, -0.004], [-0.02, 0.003]])
    state.correct(rows, innovations, noise)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
    pose, landmarks = moved(before, K @ innovations.ravel())
    np.testing.assert_allclose(state.pose.as_array(), pose.as_array(), atol=1e-7)
    np.testing.assert_allclose(state.map_t_landmarks, landmarks, atol=1e-7)
    turned = np.eye(len(P))
    turned[:2, :2] = rotation(-float((K @ innovations.ravel())[2]))
    after = turned @ (P - K @ H @ P) @ turned.T
    np.testing.assert_allclose(state.covariance, after, rtol=1e-4, atol=1e-8)


def test_a_new_landmark_is_where_and_as_unsure_as_pose_and_measurement_say() -> None:
    state = PoseAndMap(UncertainPose2(Pose2(1.0, -2.0, 0.7), np.diag([2e-4, 1e-4, 4e-5])))
    P = np.array(state.covariance)
    state.add(np.array([5.0]), np.array([0.6]), NOISE[:1])
    rng = np.random.default_rng(0)
    errors = rng.multivariate_normal(np.zeros(3), P, 20_000)
    measured = rng.multivariate_normal([5.0, 0.6], NOISE[0], 20_000)
    unit = np.column_stack([np.cos(measured[:, 1]), np.sin(measured[:, 1])])
    places = np.array(
        [
            (state.pose @ Pose2.from_array(error)).transform(point[None])[0]
            for error, point in zip(errors, measured[:, :1] * unit, strict=True)
        ]
    )
    sampled = np.cov(np.column_stack([errors, places]).T)
    np.testing.assert_allclose(state.map_t_landmarks[0], places.mean(axis=0), atol=2e-3)
    np.testing.assert_allclose(state.covariance, sampled, atol=0.05 * sampled.max())


def test_it_stays_symmetric_and_definite_over_a_thousand_corrections() -> None:
    state, rng = made(2), np.random.default_rng(2)
    for _ in range(1000):
        state.move(UncertainPose2(Pose2(0.01, 0.0, 0.01), np.diag([1e-6, 1e-6, 1e-8])))
        rows = np.sort(rng.choice(6, 3, replace=False))
        innovations = rng.normal(0.0, [0.03, 0.005], (3, 2))
        state.correct(rows, innovations, block(NOISE[:3] * 1e-4))
    P = state.covariance
    np.testing.assert_allclose(P, P.T, atol=1e-12 * P.max())
    assert np.linalg.eigvalsh(0.5 * (P + P.T))[0] > 0.0


def test_what_is_forgotten_changes_nothing_else() -> None:
    state, whole = made(3), made(3)
    rows = np.array([0, 2, 5])
    state.keep(rows)
    np.testing.assert_array_equal(state.map_t_landmarks, whole.map_t_landmarks[rows])
    np.testing.assert_array_equal(state.landmark_covariances(), whole.landmark_covariances()[rows])
    assert state.covariance.shape == (9, 9)
    np.testing.assert_array_equal(state.map_T_base.covariance, whole.map_T_base.covariance)


def test_moving_composes_as_poses_do() -> None:
    start = UncertainPose2(Pose2(1.0, -2.0, 0.7), np.diag([0.02, 0.01, 0.004]))
    motion = UncertainPose2(Pose2(0.4, 0.02, 0.1), np.diag([4e-4, 1e-4, 1e-4]))
    state = PoseAndMap(start)
    state.move(motion)
    together = start @ motion
    assert state.pose.as_array() == pytest.approx(together.pose.as_array())
    np.testing.assert_allclose(state.map_T_base.covariance, together.covariance, atol=1e-12)
