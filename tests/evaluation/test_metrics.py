from dataclasses import replace

import numpy as np
import pytest

from evaluation.metrics import Direction, Metric, judge
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2
from semgraph.results import RunResult
from sensors.truth import Truth
from tests.evaluation.course import START, drawn_trajectory, make_run

PROMISED = {
    "trajectory_rmse_m",
    "trajectory_median_m",
    "trajectory_rmse_unaligned_m",
    "fast_trajectory_rmse_m",
    "fast_trajectory_median_m",
    "fast_trajectory_rmse_unaligned_m",
    "map_rmse_m",
    "landmarks_confirmed",
    "landmarks_missed",
    "landmarks_false",
    "landmarks_duplicate",
    "nees_mean",
    "landmark_nees_mean",
    "scans_per_second",
    "fast_latency_p99_ms",
    "num_loop_closures",
}


def by_name(result: RunResult, truth: Truth) -> dict[str, Metric]:
    metrics = judge(result, truth)
    names = [metric.name for metric in metrics]
    assert len(set(names)) == len(names)
    return {metric.name: metric for metric in metrics}


def test_every_promised_metric_is_there() -> None:
    metrics = by_name(*make_run(0))
    assert set(metrics) >= PROMISED
    assert metrics["trajectory_rmse_m"].unit == "m"
    assert metrics["scans_per_second"] == Metric("scans_per_second", 100.0, "1/s", Direction.HIGHER)
    assert metrics["num_loop_closures"].value == 1.0
    assert metrics["landmarks_confirmed"].value == metrics["landmarks_found"].value == 30.0
    assert metrics["nees_mean"].expected == 3.0
    assert metrics["nees_mean"].value == pytest.approx(3.0, abs=0.8)
    assert metrics["diameter_bias_m"].value == pytest.approx(0.02)


def test_the_smoothed_run_is_better_than_the_fast_one() -> None:
    metrics = by_name(*make_run(1))
    for name in ("trajectory_rmse_m", "trajectory_median_m", "heading_rmse_deg"):
        assert metrics[name].value < metrics[f"fast_{name}"].value


def test_what_needs_a_truth_that_is_not_known_is_absent() -> None:
    result, truth = make_run(2)
    without = set(by_name(result, Truth()))
    assert without & PROMISED == {
        "landmarks_confirmed",
        "scans_per_second",
        "fast_latency_p99_ms",
        "num_loop_closures",
    }
    only_path = set(by_name(result, Truth(path=truth.path)))
    assert PROMISED - only_path == {
        "map_rmse_m",
        "landmarks_missed",
        "landmarks_false",
        "landmarks_duplicate",
        "landmark_nees_mean",
    }


def test_no_covariance_no_nees() -> None:
    result, truth = make_run(2)
    unknown = replace(result, smoothed_covariances=np.full((200, 3, 3), np.nan))
    assert "nees_mean" not in by_name(unknown, truth)


def test_an_empty_run_is_judged() -> None:
    _, truth = make_run(2)
    nothing = Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)))
    empty = RunResult("", nothing, np.empty((0, 3, 3)), nothing, (), np.empty(0), 0.0, 0)
    metrics = by_name(empty, truth)
    assert metrics["landmarks_missed"].value == 30.0
    assert "trajectory_rmse_m" not in metrics
    assert "scans_per_second" not in metrics


def test_moving_the_world_changes_only_what_is_not_aligned() -> None:
    result, truth = make_run(3)
    move = Pose2(100.0, -50.0, 2.5)
    assert truth.path is not None
    assert truth.path.headings is not None
    assert truth.landmarks is not None
    moved = Truth(
        replace(
            truth.path,
            world_t_reference=move.transform(truth.path.world_t_reference),
            headings=truth.path.headings + move.theta,
        ),
        replace(
            truth.landmarks,
            world_t_landmarks=move.transform(truth.landmarks.world_t_landmarks),
        ),
    )
    here, there = by_name(result, truth), by_name(result, moved)
    for name in here:
        if "unaligned" in name:
            assert there[name].value > here[name].value + 1.0
        else:
            assert there[name].value == pytest.approx(here[name].value, rel=1e-6, abs=1e-9)


def test_jumping_fixes_are_counted_and_told_apart() -> None:
    result, truth = make_run(4)
    assert truth.path is not None
    even = np.tile(0.05**2 * np.eye(3), (len(truth.path.stamps_ns), 1, 1))
    estimate = drawn_trajectory(np.random.default_rng(4), truth.path, even)
    result = replace(result, smoothed=estimate)
    positions = np.array(truth.path.world_t_reference)
    positions[50] += 137.0
    path = replace(truth.path, world_t_reference=positions, has_outliers=True)
    metrics = by_name(result, Truth(path))
    assert metrics["reference_outliers"].value == 1.0
    assert metrics["trajectory_rmse_m"].value < 0.2
    assert metrics["trajectory_rmse_all_m"].value > 5.0


def test_unaligned_is_aligned_when_the_map_begins_in_the_worlds_frame() -> None:
    result, truth = make_run(5)
    poses = result.smoothed.map_T_bases
    world_T_bases = np.column_stack([START.transform(poses[:, :2]), poses[:, 2] + START.theta])
    in_world = replace(result, smoothed=Trajectory(result.smoothed.stamps_ns, world_T_bases))
    metrics = by_name(in_world, truth)
    assert metrics["trajectory_rmse_unaligned_m"].value == pytest.approx(
        metrics["trajectory_rmse_origin_m"].value, rel=0.05
    )
