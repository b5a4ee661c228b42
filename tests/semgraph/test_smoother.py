from dataclasses import replace

import numpy as np
import pytest

from evaluation.consistency import bounds_of_mean, gauge, pose_nees
from evaluation.metrics import judge
from semgraph.pipeline import moments, run
from semgraph.results import RunResult
from semgraph.settings import load_settings
from sensors.simulation.course import CourseOptions, read
from sensors.truth import Source


def ran(source: Source) -> RunResult:
    return run(source.recording, load_settings(None, []), None, lambda _: None, {})


def figures(source: Source) -> dict[str, float]:
    return {metric.name: metric.value for metric in judge(ran(source), source.truth)}


@pytest.mark.parametrize("odometry", [False, True])
def test_the_loop_closes_every_tree_stands_once_and_smoothing_pays(*, odometry: bool) -> None:
    gains = []
    for seed in (11, 12):
        found = figures(read("paper", CourseOptions(seed=seed, odometry=odometry)))
        assert found["num_loop_closures"] > 5
        assert found["landmarks_duplicate"] == 0
        assert found["landmarks_missed"] == 0
        assert found["landmarks_false"] == 0
        gains.append(found["trajectory_rmse_m"] / found["fast_trajectory_rmse_m"])
    assert np.mean(gains) < 1.0


def test_poses_are_as_sure_as_they_say() -> None:
    """NEES at half the lap, with wheels that err as they say, over seeded runs."""
    squares = []
    for seed in range(20, 32):
        source = read("paper", CourseOptions(seed=seed, odometry=True, scan_rate_hz=3.0))
        result, path = ran(source), source.truth.path
        assert path is not None
        world_T_map = gauge(result.smoothed, path)
        assert world_T_map is not None
        nees = pose_nees(result.smoothed, result.smoothed_covariances, path, world_T_map)
        squares.append(float(nees[len(nees) // 2]))
    low, high = bounds_of_mean(3, len(squares), 0.999)
    assert low < np.mean(squares) < high


@pytest.mark.parametrize(("gap", "blind", "rmse_m"), [(6, 5, 0.2), (40, 20, np.inf)])
def test_clutter_gaps_and_blindness_are_survived(gap: int, blind: int, rmse_m: float) -> None:
    """Without wheels a long gap costs accuracy, but never the run."""
    options = CourseOptions(seed=14, clutter=1.0, missed=0.2, lap_s=25.0)
    source = read("paper", options)
    scans = [perceptions for perceptions, _ in moments(source.recording, None)]
    kept = scans[:100] + scans[100 + gap :]
    nothing = [each.select(np.zeros(len(each), dtype=np.bool_)) for each in kept[40 : 40 + blind]]
    measurements = (*kept[:40], *nothing, *kept[40 + blind :])
    broken = replace(source.recording, measurements=measurements, num_scans=len(measurements))
    found = figures(Source(broken, source.truth))
    assert found["trajectory_rmse_m"] <= rmse_m


def test_a_run_of_nothing_but_clutter_ends() -> None:
    source = read("paper", CourseOptions(seed=1, num_trees=0, clutter=5.0, lap_s=10.0))
    result = ran(source)
    assert len(result.smoothed) == result.num_scans
    assert np.isfinite(result.smoothed_covariances).all()


def test_two_runs_are_equal() -> None:
    source = read("paper", CourseOptions(seed=3, lap_s=15.0))
    first, second = ran(source), ran(source)
    np.testing.assert_array_equal(first.smoothed.map_T_bases, second.smoothed.map_T_bases)
    assert first.events == second.events
