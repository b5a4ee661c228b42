from dataclasses import replace

import numpy as np
import pytest

from evaluation.estimators.catalog import estimator
from evaluation.estimators.driving import Drive, Step
from evaluation.estimators.estimate import Estimate
from evaluation.metrics import Direction, judge
from evaluation.studies.judging import (
    OF_THE_MACHINE,
    drawing_of,
    judge_estimate,
    series_of,
)
from evaluation.studies.trial import MAX_SAMPLES
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.results import RunResult
from semgraph.settings import Settings
from sensors.catalog import open_source
from sensors.truth import Source, Truth
from tests.evaluation.course import make_run
from tests.evaluation.estimators.short_course import estimated, short_course


def same_run() -> tuple[RunResult, Estimate, Source]:
    result, truth = make_run(0)
    estimate = Estimate(
        result.smoothed,
        result.smoothed_covariances,
        result.landmarks,
        step_seconds=result.fast_seconds,
        online=result.fast,
    )
    return result, estimate, Source(short_course(1).recording, truth)


def test_a_run_and_an_estimate_are_judged_alike() -> None:
    result, estimate, source = same_run()
    of_run = {metric.name: metric for metric in judge(result, source.truth)}
    of_estimate = judge_estimate(estimate, source)
    names = [metric.name for metric in of_estimate]
    assert len(names) == len(set(names))
    shared = [metric for metric in of_estimate if metric.name in of_run]
    assert len(shared) >= 30
    for metric in shared:
        assert metric == of_run[metric.name]
    fast = {name: metric.value for name, metric in of_run.items() if name.startswith("fast_traj")}
    online = {f"fast_{m.name[7:]}": m.value for m in of_estimate if m.name.startswith("online_t")}
    assert online == fast


def test_what_an_estimator_does_not_do_is_not_judged() -> None:
    source = short_course(1)
    values = {name: set(names_of(name)) for name in ("dead-reckoning", "fast", "oracle")}
    for absent in ("map_rmse_m", "landmarks_missed", "association_recall", "loops_closed"):
        assert absent not in values["dead-reckoning"]
    assert {"nees_mean", "nees_last", "latency_max_ms"} <= values["dead-reckoning"]
    assert not {"nees_mean", "nis_mean"} & values["fast"]
    assert {"association_precision", "map_recall", "online_trajectory_rmse_m"} <= values["fast"]
    assert not {"latency_p50_ms", "loops_closed", "online_trajectory_rmse_m"} & values["oracle"]
    assert judge_estimate(estimated("fast", 1), replace(source, truth=Truth()))


def test_things_found_in_scans_are_told_apart_by_where_they_stand() -> None:
    options = {"seed": 1, "lap_s": 30.0, "overlap_s": 0.0, "track_radius_m": 8.0, "scan_every": 25}
    source = open_source("course:paper", options)
    estimate = estimator("fast")(source, Settings(), np.random.default_rng(0))
    values = {metric.name: metric.value for metric in judge_estimate(estimate, source)}
    assert values["association_precision"] > 0.95
    assert values["association_recall"] > 0.9
    untold = Source(source.recording, replace(source.truth, landmarks=None))
    names = {metric.name for metric in judge_estimate(estimate, untold)}
    assert "association_recall" not in names
    assert "trajectory_rmse_m" in names


def names_of(name: str) -> list[str]:
    return [metric.name for metric in judge_estimate(estimated(name, 1), short_course(1))]


def test_the_oracle_associates_all_and_its_map_is_complete() -> None:
    values = {m.name: m for m in judge_estimate(estimated("oracle", 1), short_course(1))}
    for name in ("association_precision", "association_recall", "map_precision"):
        assert values[name].value == 1.0
        assert values[name].better is Direction.HIGHER
    assert values["nees_mean"].expected == 3.0
    assert values["diameter_rmse_m"].value < 0.02


def test_latencies_are_in_order_and_the_machines() -> None:
    _, estimate, source = same_run()
    values = {metric.name: metric.value for metric in judge_estimate(estimate, source)}
    assert 0.0 < values["latency_p50_ms"] < values["latency_p99_ms"] < values["latency_max_ms"]
    assert values["latency_max_ms"] == pytest.approx(1e3 * estimate.step_seconds.max())
    assert {name for name in values if "latency" in name} <= OF_THE_MACHINE


def test_the_series_holds_the_largest_errors() -> None:
    _, estimate, source = same_run()
    series = series_of(estimate, source)
    assert series is not None
    assert len(series.times_s) == MAX_SAMPLES
    assert series.times_s[-1] == pytest.approx(199 * 0.2)
    values = {metric.name: metric.value for metric in judge_estimate(estimate, source)}
    assert series.position_errors_m.max() == pytest.approx(values["trajectory_max_m"])
    assert series.nees[-1] == pytest.approx(values["nees_last"])
    assert (series.heading_errors_deg >= 0.0).all()
    silent = series_of(replace(estimate, covariances=np.empty((0, 3, 3))), source)
    assert silent is not None
    assert np.isnan(silent.nees).all()
    assert series_of(estimate, replace(source, truth=Truth())) is None


def test_the_drawing_lies_on_the_truth() -> None:
    source = short_course(1)
    drawing = drawing_of(estimated("oracle", 1), source)
    assert drawing is not None
    assert len(drawing.true_path) == len(drawing.estimated_path) == MAX_SAMPLES
    off_m = np.linalg.norm(drawing.estimated_path - drawing.true_path, axis=1)
    assert off_m.max() < 0.1
    for landmark in drawing.estimated_landmarks:
        assert np.linalg.norm(drawing.true_landmarks - landmark, axis=1).min() < 0.1
    assert drawing_of(estimated("oracle", 1), replace(source, truth=Truth())) is None


def test_a_loop_is_what_was_not_seen_for_long() -> None:
    still = UncertainPose2(Pose2(), np.zeros((3, 3)))
    seen = {0: [3], 50: [3], 151: [3], 152: [3, 4]}
    steps = [Step(still, np.array(seen.get(scan, [-1]), dtype=np.int64)) for scan in range(200)]
    said = Drive([10 * scan for scan in range(200)], steps, [0.0] * 200)
    assert said.estimate().closed_at_ns == (1510,)
