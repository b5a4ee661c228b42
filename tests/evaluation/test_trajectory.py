import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.alignment import Alignment
from evaluation.trajectory import (
    PathErrors,
    comparable_rows,
    compare_path,
    frame_errors,
    relative_errors,
    rmse,
    trajectory_difference,
)
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2
from sensors.truth import TruePath
from tests.evaluation.course import make_run

SECOND_NS = 1_000_000_000
ALIGNMENTS = list(Alignment)


def compared(
    estimate: Trajectory, truth: TruePath, alignment: Alignment = Alignment.RIGID
) -> PathErrors:
    errors = compare_path(estimate, truth, alignment)
    assert errors is not None
    return errors


def straight(seconds: list[float], truth_s: list[float]) -> tuple[Trajectory, TruePath]:
    """Both drive along x at 1 m/s."""
    stamps_ns = np.array([round(s * SECOND_NS) for s in seconds], dtype=np.int64)
    poses = np.column_stack([seconds, np.zeros((len(seconds), 2))])
    truth_ns = np.array([round(s * SECOND_NS) for s in truth_s], dtype=np.int64)
    return Trajectory(stamps_ns, poses), TruePath(
        truth_ns, np.column_stack([truth_s, np.zeros(len(truth_s))]), np.zeros(len(truth_s))
    )


def moved(path: TruePath, move: Pose2) -> TruePath:
    assert path.headings is not None
    return replace(
        path,
        world_t_reference=move.transform(path.world_t_reference),
        headings=path.headings + move.theta,
    )


def test_times_outside_and_in_gaps_are_left_out_and_counted() -> None:
    estimate, truth = straight(
        [1.0, 2.0, 4.0, 6.1, 7.0], [0.5, 1.0, 1.5, 3.0, 4.0, 5.0, 6.1, 6.5, 7.0, 7.001]
    )
    errors = compared(estimate, truth)
    np.testing.assert_array_equal(errors.rows, [1, 2, 3, 4, 6, 7, 8])
    assert errors.num_left_out == 3
    assert errors.distances.max() < 1e-12


@pytest.mark.parametrize("seconds", [[], [1.0], [1.0, 1.5]])
def test_too_little_in_common_is_no_comparison(seconds: list[float]) -> None:
    estimate, truth = straight([1.0, 1.2][: len(seconds)], [1.0, 3.0])
    assert compare_path(estimate, truth) is None


def test_hand_computed_errors() -> None:
    estimate, truth = straight([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 3.0])
    poses = np.array(estimate.map_T_bases)
    poses[:, 1] += [0.0, 0.3, 0.0, 0.4]
    poses[:, 2] = [0.0, 0.1, 0.0, 0.2]
    estimate = replace(estimate, map_T_bases=poses)
    errors = compared(estimate, truth, Alignment.NONE)
    np.testing.assert_allclose(errors.distances, [0.0, 0.3, 0.0, 0.4])
    assert rmse(errors.errors) == pytest.approx(math.sqrt(0.25 / 4))
    assert errors.heading_errors is not None
    np.testing.assert_allclose(errors.heading_errors, [0.0, 0.1, 0.0, 0.2])


def test_the_compared_point_is_the_reference_point() -> None:
    stamps_ns = np.arange(3) * SECOND_NS
    turning = Trajectory(stamps_ns, np.array([[0.0, 0.0, 0.0], [0, 0, np.pi / 2], [0, 0, 3.0]]))
    antenna = np.array([2.0, 1.0])
    seen = np.array([[2.0, 1.0], [-1.0, 2.0], [0.0, 0.0]])
    truth = TruePath(stamps_ns, seen, None, antenna)
    errors = compared(turning, truth, Alignment.NONE)
    np.testing.assert_allclose(errors.distances[:2], 0.0, atol=1e-12)
    assert errors.distances[2] == pytest.approx(math.hypot(2.0, 1.0))


@given(
    x=st.floats(-100, 100),
    y=st.floats(-100, 100),
    theta=st.floats(-3.1, 3.1),
    seed=st.integers(0, 9),
)
def test_moving_the_world_changes_no_aligned_error(
    x: float, y: float, theta: float, seed: int
) -> None:
    result, truth = make_run(seed)
    assert truth.path is not None
    for alignment in (Alignment.RIGID, Alignment.ORIGIN):
        here = compared(result.fast, truth.path, alignment)
        there = compared(result.fast, moved(truth.path, Pose2(x, y, theta)), alignment)
        np.testing.assert_allclose(there.distances, here.distances, atol=1e-9)


def test_moving_the_world_shows_without_alignment() -> None:
    estimate, truth = straight([0.0, 1.0], [0.0, 1.0])
    errors = compared(estimate, moved(truth, Pose2(3.0, 4.0, 0.0)), Alignment.NONE)
    np.testing.assert_allclose(errors.distances, 5.0)


def test_the_first_pose_lies_upon_the_first() -> None:
    result, truth = make_run(1)
    assert truth.path is not None
    errors = compared(result.fast, truth.path, Alignment.ORIGIN)
    assert errors.heading_errors is not None
    assert errors.distances[0] < 1e-9
    assert abs(errors.heading_errors[0]) < 1e-9


def test_jumps_of_the_reference_are_named_and_do_not_count() -> None:
    result, truth = make_run(2)
    assert truth.path is not None
    positions = np.array(truth.path.world_t_reference)
    positions[[20, 120]] += 137.0
    with_jumps = replace(truth.path, world_t_reference=positions, has_outliers=True)
    errors = compared(result.smoothed, with_jumps)
    np.testing.assert_array_equal(np.flatnonzero(errors.is_outlier), [20, 120])
    clean = compared(result.smoothed, truth.path)
    assert rmse(errors.errors[~errors.is_outlier]) < 1.1 * rmse(clean.errors)
    trusted = compared(result.smoothed, replace(with_jumps, has_outliers=False))
    assert not trusted.is_outlier.any()
    assert rmse(trusted.errors) > 10.0


def plain_ate(estimate: FloatArray, truth: FloatArray) -> float:
    """Umeyama by singular values, independent of the closed form in the plane."""
    a, b = truth - truth.mean(axis=0), estimate - estimate.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = U @ np.diag([1.0, np.linalg.det(U @ Vt)]) @ Vt
    return float(np.sqrt(np.mean(np.sum((a - b @ R.T) ** 2, axis=1))))


@pytest.mark.parametrize("seed", range(10))
def test_the_absolute_error_is_the_plain_definition(seed: int) -> None:
    result, truth = make_run(seed)
    assert truth.path is not None
    errors = compared(result.fast, truth.path)
    expected = plain_ate(result.fast.map_T_bases[:, :2], truth.path.world_t_reference)
    assert rmse(errors.errors) == pytest.approx(expected, abs=1e-9)


def matrix(x: float, y: float, theta: float) -> FloatArray:
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def plain_rpe(estimate: FloatArray, truth: FloatArray, length_m: float) -> tuple[int, float, float]:
    squares, turns = [], []
    for i in range(len(truth)):
        along, j = 0.0, i
        while along < length_m and j + 1 < len(truth):
            along += math.dist(truth[j, :2], truth[j + 1, :2])
            j += 1
        if along >= length_m:
            true = np.linalg.inv(matrix(*truth[i])) @ matrix(*truth[j])
            ours = np.linalg.inv(matrix(*estimate[i])) @ matrix(*estimate[j])
            E = np.linalg.inv(true) @ ours
            squares.append(E[0, 2] ** 2 + E[1, 2] ** 2)
            turns.append(math.atan2(E[1, 0], E[0, 0]) ** 2)
    return len(squares), math.sqrt(np.mean(squares)), math.sqrt(np.mean(turns))


@pytest.mark.parametrize("length_m", [1.1, 9.97])
def test_the_relative_error_is_the_plain_definition(length_m: float) -> None:
    result, truth = make_run(3)
    path = truth.path
    assert path is not None
    assert path.headings is not None
    (ours,) = relative_errors(result.fast, path, [length_m])
    true = np.column_stack([path.world_t_reference, path.headings])
    count, translation_m, turn = plain_rpe(result.fast.map_T_bases, true, length_m)
    assert ours.num_segments == count
    assert ours.translation_rmse_m == pytest.approx(translation_m, abs=1e-9)
    assert ours.heading_rmse == pytest.approx(turn, abs=1e-9)


def test_the_relative_error_of_frames_is_the_plain_definition() -> None:
    result, truth = make_run(3)
    path = truth.path
    assert path is not None
    assert path.headings is not None
    true = np.column_stack([path.world_t_reference, path.headings])
    for frames in (1, 3):
        ours = frame_errors(result.fast, path, frames)
        assert ours is not None
        errors = [
            np.linalg.inv(np.linalg.inv(matrix(*true[i])) @ matrix(*true[i + frames]))
            @ (np.linalg.inv(matrix(*result.fast.map_T_bases[i])))
            @ matrix(*result.fast.map_T_bases[i + frames])
            for i in range(0, len(true) - frames, frames)
        ]
        squares = [E[0, 2] ** 2 + E[1, 2] ** 2 for E in errors]
        assert ours.num_segments == len(errors)
        assert ours.translation_rmse_m == pytest.approx(math.sqrt(np.mean(squares)), abs=1e-12)
    assert frame_errors(result.fast, path, len(true)) is None
    assert frame_errors(result.fast, replace(path, headings=None)) is None


def test_lengths_never_driven_and_unknown_headings_have_no_relative_error() -> None:
    result, truth = make_run(3)
    assert truth.path is not None
    assert relative_errors(result.fast, truth.path, [1e4]) == ()
    assert relative_errors(result.fast, replace(truth.path, headings=None), [1.0]) == ()


def test_the_difference_of_trajectories_is_rigidly_invariant() -> None:
    result, _ = make_run(4)
    far = Pose2(10.0, 20.0, 1.0)
    poses = result.fast.map_T_bases[::2]
    other = Trajectory(
        result.fast.stamps_ns[::2], np.column_stack([far.transform(poses[:, :2]), poses[:, 2]])
    )
    assert trajectory_difference(result.fast, other) < 1e-9
    assert trajectory_difference(result.smoothed, other) > 0.01
    shifted = Trajectory(other.stamps_ns + 1, other.map_T_bases)
    with pytest.raises(InputError, match="common times"):
        trajectory_difference(result.fast, shifted)


def test_a_single_estimate_can_be_compared_at_its_own_time_only() -> None:
    estimate, truth = straight([1.0], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(comparable_rows(estimate, truth.stamps_ns), [1])
