import numpy as np
import pytest

from semgraph.geometry import Pose2
from semgraph.measurement_model import innovations, jacobians, predict
from semgraph.particle_maps import MOST_LANDMARKS, ParticleMaps

COVARIANCE = np.array([[0.04, 0.001], [0.001, 0.0009]])
POSES = np.array([[1.0, -2.0, 0.7], [1.2, -1.9, 0.6]])
SIGMA_M = 0.05


def one_landmark() -> ParticleMaps:
    maps = ParticleMaps(2, SIGMA_M)
    maps.insert(np.arange(2), POSES, (3.0, 0.4), COVARIANCE, 7)
    return maps


def test_a_new_landmark_is_expected_where_it_was_seen() -> None:
    predicted = one_landmark().predict(POSES, 3.0, 0.4, COVARIANCE)
    assert predicted.range_error == pytest.approx(np.zeros((2, 1)))
    assert predicted.bearing_error == pytest.approx(np.zeros((2, 1)))


def test_a_second_sighting_is_the_kalman_update() -> None:
    """Mean and likelihood agree with the textbook's matrices, for each particle."""
    maps = one_landmark()
    moved = POSES + np.array([0.3, 0.1, 0.02])
    predicted = maps.predict(moved, 2.9, 0.35, COVARIANCE)
    logs = predicted.log_likelihoods()
    maps.sight(np.arange(2), np.zeros(2, dtype=np.int64), predicted)
    after = maps.predict(moved, 2.9, 0.35, COVARIANCE)
    for row in range(2):
        first, pose = Pose2.from_array(POSES[row]), Pose2.from_array(moved[row])
        mean = first.transform(3.0 * np.array([[np.cos(0.4), np.sin(0.4)]]))
        by_landmark = jacobians(first, mean)[1][0]
        P = np.linalg.inv(by_landmark) @ COVARIANCE @ np.linalg.inv(by_landmark).T
        H = jacobians(pose, mean)[1][0]
        S = H @ (P + SIGMA_M**2 * np.eye(2)) @ H.T + COVARIANCE
        e = innovations(predict(pose, mean), np.array([2.9]), np.array([0.35]))[0]
        expected = -0.5 * e @ np.linalg.solve(S, e) - 0.5 * np.log(np.linalg.det(2.0 * np.pi * S))
        assert logs[row, 0] == pytest.approx(expected)
        updated = mean[0] + P @ H.T @ np.linalg.solve(S, e)
        left = innovations(predict(pose, updated[None]), np.array([2.9]), np.array([0.35]))[0]
        assert after.range_error[row, 0] == pytest.approx(left[0], abs=1e-9)
        assert after.bearing_error[row, 0] == pytest.approx(left[1], abs=1e-9)
        assert after.S11[row, 0] < predicted.S11[row, 0]


def test_what_lies_beyond_the_gate_explains_nothing() -> None:
    assert one_landmark().predict(POSES, 6.0, 0.4, COVARIANCE).log_likelihoods().max() == -np.inf


def test_a_full_map_forgets_what_is_farthest_away() -> None:
    maps = ParticleMaps(1, SIGMA_M)
    for number in range(MOST_LANDMARKS):
        maps.insert(np.array([0]), POSES[:1], (1.0 + number, 0.0), COVARIANCE, number)
    maps.insert(np.array([0]), POSES[:1], (5.0, 1.0), COVARIANCE, 1000)
    expected = {*range(MOST_LANDMARKS - 1), 1000}
    assert set(maps.numbers[0].tolist()) == expected
