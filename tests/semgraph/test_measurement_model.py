import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, norm

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, wrap_angle
from semgraph.landmarks import Kind, Perceptions
from semgraph.measurement_model import (
    CHI2_2DOF_99,
    CHI2_2DOF_999,
    diameter_log_likelihoods,
    innovations,
    jacobians,
    mahalanobis2,
    predict,
)

POSES = st.builds(
    Pose2, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-math.pi, math.pi)
)
POLAR = st.lists(st.tuples(st.floats(0.5, 40.0), st.floats(-3.1, 3.1)), min_size=1, max_size=5).map(
    np.array
)


def landmarks_at(map_T_base: Pose2, polar: FloatArray) -> FloatArray:
    """map_t_landmarks (n, 2) that stand at (range, bearing) rows (n, 2)."""
    covariances = np.tile(np.eye(2), (len(polar), 1, 1))
    perceptions = Perceptions.from_arrays(0, Kind.TREE, polar[:, 0], polar[:, 1], covariances)
    return map_T_base.transform(perceptions.base_t_landmarks())


def change(after: FloatArray, before: FloatArray) -> FloatArray:
    return innovations(before, after[:, 0], after[:, 1])


@given(POSES, POLAR)
def test_what_stands_at_a_range_and_bearing_is_predicted_there(
    map_T_base: Pose2, polar: FloatArray
) -> None:
    predicted = predict(map_T_base, landmarks_at(map_T_base, polar))
    np.testing.assert_allclose(change(polar, predicted), 0.0, atol=1e-9)


def test_a_landmark_to_the_left_of_a_turned_robot() -> None:
    predicted = predict(Pose2(1.0, 1.0, math.pi / 2), np.array([[-3.0, 1.0]]))
    np.testing.assert_allclose(predicted, [[4.0, math.pi / 2]])


@given(POSES, POLAR)
def test_jacobians_by_the_pose_are_the_numerical_ones(map_T_base: Pose2, polar: FloatArray) -> None:
    landmarks = landmarks_at(map_T_base, polar)
    step = 1e-5
    numerical = np.zeros((len(polar), 2, 3))
    for axis in range(3):
        plus, minus = (
            predict(map_T_base @ Pose2.from_array(sign * step * np.eye(3)[axis]), landmarks)
            for sign in (1.0, -1.0)
        )
        numerical[:, :, axis] = change(plus, minus) / (2.0 * step)
    by_pose, _ = jacobians(map_T_base, landmarks)
    np.testing.assert_allclose(by_pose, numerical, atol=1e-6)


@given(POSES, POLAR)
def test_jacobians_by_the_landmark_are_the_numerical_ones(
    map_T_base: Pose2, polar: FloatArray
) -> None:
    landmarks = landmarks_at(map_T_base, polar)
    step = 1e-5
    numerical = np.zeros((len(polar), 2, 2))
    for axis in range(2):
        plus, minus = (
            predict(map_T_base, landmarks + sign * step * np.eye(2)[axis]) for sign in (1.0, -1.0)
        )
        numerical[:, :, axis] = change(plus, minus) / (2.0 * step)
    _, by_landmark = jacobians(map_T_base, landmarks)
    np.testing.assert_allclose(by_landmark, numerical, atol=1e-6)


@given(st.floats(-3.0 * math.pi, 3.0 * math.pi), st.floats(-math.pi, math.pi))
def test_innovations_take_the_short_way_round(measured: float, expected: float) -> None:
    difference = innovations(np.array([[5.0, expected]]), np.array([5.5]), np.array([measured]))
    assert difference[0, 0] == pytest.approx(0.5)
    assert -math.pi <= difference[0, 1] < math.pi
    assert wrap_angle(difference[0, 1] + expected - measured) == pytest.approx(0.0, abs=1e-9)


def test_distances_are_those_of_whitened_differences() -> None:
    rng = np.random.default_rng(3)
    roots = rng.standard_normal((4, 5, 2, 2)) + 2.0 * np.eye(2)
    covariances = roots @ roots.transpose(0, 1, 3, 2)
    differences = rng.standard_normal((4, 5, 2))
    distances2 = mahalanobis2(differences, covariances)
    assert distances2.shape == (4, 5)
    for place in np.ndindex(4, 5):
        whitened = np.linalg.solve(roots[place], differences[place])
        assert distances2[place] == pytest.approx(whitened @ whitened)


@pytest.mark.parametrize(("gate", "kept"), [(CHI2_2DOF_99, 0.99), (CHI2_2DOF_999, 0.999)])
def test_the_gates_keep_their_share_of_true_sightings(gate: float, kept: float) -> None:
    assert chi2.cdf(gate, 2) == pytest.approx(kept, abs=1e-6)
    rng = np.random.default_rng(4)
    covariance = np.array([[4e-4, 5e-5], [5e-5, 1e-4]])
    errors = rng.multivariate_normal(np.zeros(2), covariance, 100_000)
    share = (mahalanobis2(errors, np.tile(covariance, (len(errors), 1, 1))) <= gate).mean()
    assert share == pytest.approx(kept, abs=4.0 * math.sqrt(kept * (1.0 - kept) / len(errors)))


def test_diameters_of_one_object_differ_by_both_sigmas_and_its_outline() -> None:
    sigma_m = math.hypot(0.03, 0.02, 0.05 * 0.4)
    found = diameter_log_likelihoods(
        np.array([0.35, np.nan]), np.array([0.03, np.nan]), np.array([0.4]), np.array([0.02])
    )
    assert found[0] == pytest.approx(norm.logpdf(-0.05, 0.0, sigma_m))
    assert np.isnan(found[1])
