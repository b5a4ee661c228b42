from dataclasses import replace

import numpy as np
import pytest

from evaluation.consistency import (
    bounds_of_mean,
    gauge,
    landmark_nees,
    normalized_squares,
    observed_coverage,
    pose_nees,
)
from evaluation.landmarks import compare_map
from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2
from tests.evaluation.course import START, make_run


@pytest.mark.parametrize(
    ("dof", "num_runs", "low", "high"),
    [
        (3, 20, 2.02, 4.17),
        (3, 50, 2.36, 3.72),
        (3, 100, 2.54, 3.50),
        (3, 200, 2.67, 3.35),
        (2, 50, 1.48, 2.59),
        (2, 100, 1.63, 2.41),
    ],
)
def test_published_bounds(dof: int, num_runs: int, low: float, high: float) -> None:
    np.testing.assert_allclose(bounds_of_mean(dof, num_runs), (low, high), atol=0.006)


def test_hand_computed_squares() -> None:
    errors = np.array([[1.0, 2.0], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    covariances = np.array(
        [np.diag([1.0, 4.0]), [[2.0, 1.0], [1.0, 2.0]], np.full((2, 2), np.nan), np.zeros((2, 2))]
    )
    np.testing.assert_allclose(
        normalized_squares(errors, covariances), [2.0, 2.0 / 3.0, np.nan, np.nan]
    )


@pytest.mark.parametrize("dof", [2, 3])
def test_samples_of_a_covariance_are_consistent_with_it_and_not_with_a_smaller_one(
    dof: int,
) -> None:
    rng = np.random.default_rng(dof)
    root = rng.normal(size=(dof, dof))
    covariance = root @ root.T + 0.1 * np.eye(dof)
    errors = rng.multivariate_normal(np.zeros(dof), covariance, 500)
    covariances = np.tile(covariance, (500, 1, 1))
    low, high = bounds_of_mean(dof, 500, 0.999)
    honest = normalized_squares(errors, covariances)
    assert low < honest.mean() < high
    assert observed_coverage(honest, dof) == pytest.approx(0.95, abs=0.03)
    overconfident = normalized_squares(errors, 0.5 * covariances)
    assert overconfident.mean() > high
    assert observed_coverage(overconfident, dof) < 0.9


def nees_of_runs(num_runs: int, *, headings: bool = True) -> FloatArray:
    means = []
    for seed in range(num_runs):
        result, truth = make_run(seed)
        path = truth.path if headings or truth.path is None else replace(truth.path, headings=None)
        assert path is not None
        world_T_map = gauge(result.smoothed, path)
        assert world_T_map is not None
        means.append(
            np.nanmean(pose_nees(result.smoothed, result.smoothed_covariances, path, world_T_map))
        )
    return np.array(means)


def test_poses_drawn_from_their_covariances_are_consistent() -> None:
    low, high = bounds_of_mean(3, 20 * 199, 0.999)
    assert low < nees_of_runs(20).mean() < high


def test_positions_without_headings_are_consistent_too() -> None:
    mean = nees_of_runs(20, headings=False).mean()
    assert mean == pytest.approx(2.0, abs=0.15)


def test_covariances_in_the_wrong_frame_are_found_out() -> None:
    result, truth = make_run(0)
    assert truth.path is not None
    assert truth.path.headings is not None
    world_T_map = gauge(result.smoothed, truth.path)
    assert world_T_map is not None
    thin = np.diag([1e-2, 1e-6, 1e-6])
    rng = np.random.default_rng(1)
    map_T_world = START.inverse()
    poses = []
    for (x, y), theta in zip(truth.path.world_t_reference, truth.path.headings, strict=True):
        error = Pose2.from_array(rng.multivariate_normal(np.zeros(3), thin))
        poses.append((map_T_world @ Pose2(float(x), float(y), float(theta)) @ error).as_array())
    estimate = replace(result.smoothed, map_T_bases=np.array(poses))
    turns = [pose.adjoint()[:2, :2] for pose in map(Pose2.from_array, estimate.map_T_bases)]
    in_map = np.tile(thin, (len(poses), 1, 1))
    in_map[:, :2, :2] = [R @ thin[:2, :2] @ R.T for R in turns]
    in_body = np.tile(thin, (len(poses), 1, 1))
    right = pose_nees(estimate, in_body, truth.path, START)
    wrong = pose_nees(estimate, in_map, truth.path, START)
    assert right.mean() == pytest.approx(3.0, abs=0.6)
    assert wrong.mean() > 100.0


def test_the_noise_of_the_reference_is_allowed_for() -> None:
    result, truth = make_run(7, sigma_m=1e-4)
    assert truth.path is not None
    rng = np.random.default_rng(7)
    noisy = truth.path.world_t_reference + rng.normal(0.0, 0.1, truth.path.world_t_reference.shape)
    path = replace(truth.path, world_t_reference=noisy, headings=None)
    means = []
    for sigma_m in (0.0, 0.1):
        told = replace(path, sigma_m=sigma_m)
        squares = pose_nees(result.smoothed, result.smoothed_covariances, told, START)
        means.append(np.nanmean(squares))
    assert means[0] > 1000.0
    assert means[1] == pytest.approx(1.0, abs=0.3)


def test_without_headings_the_map_is_turned_about_the_first_good_fix() -> None:
    result, truth = make_run(3, sigma_m=1e-6)
    assert truth.path is not None
    move = Pose2(7.0, 8.0, -2.0)
    moved = move.transform(truth.path.world_t_reference)
    moved[0] += 137.0
    path = replace(truth.path, world_t_reference=moved, headings=None, has_outliers=True)
    world_T_map = gauge(result.smoothed, path)
    assert world_T_map is not None
    assert np.abs(world_T_map.between(move @ START).as_array()).max() < 1e-3


def test_landmarks_drawn_from_their_covariances_are_consistent() -> None:
    squares = []
    for seed in range(20):
        result, truth = make_run(seed)
        assert truth.landmarks is not None
        matched = compare_map(result.landmarks, truth, START)
        assert matched is not None
        squares.append(landmark_nees(result.landmarks, truth.landmarks, matched, START))
    low, high = bounds_of_mean(2, 600, 0.999)
    assert low < np.concatenate(squares).mean() < high
