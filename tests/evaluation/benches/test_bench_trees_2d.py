"""The bench of trees in scans: every figure is measured, a blind detector fails."""

import math

import numpy as np
import pytest

from detectors.tree_settings import TreeSettings
from detectors.trees_2d import TreeDetector
from evaluation.benches import bench_trees_2d as bench
from evaluation.benches.detector_trials import judge_detector, look, stand_trials
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import LaserScan
from sensors.simulation.lms151 import Lms151, Resolution
from sensors.simulation.world import FOREST, Thing, World


class Blind:
    def detect(self, scan: LaserScan) -> Perceptions:
        nothing = np.zeros(0)
        return Perceptions.from_arrays(
            scan.stamp_ns, Kind.TREE, nothing, nothing, np.zeros((0, 2, 2))
        )


def test_a_blind_detector_finds_nothing() -> None:
    trials = list(stand_trials([1], Lms151(), (FOREST,)))
    outcomes = judge_detector(trials, Blind(), bench.TREES, 0.0)
    assert not outcomes.found.any()
    assert len(outcomes.ranges_m) == 0
    assert (outcomes.thing_beams >= 3).any()


def test_the_truth_of_a_lone_stem() -> None:
    rng = np.random.default_rng(0)
    world = World.of(Thing.STEM, np.array([[3.0, 4.0]]), np.array([0.4]), rng)
    trial = look(world, Pose2(0.0, 0.0, np.pi / 2), Lms151(Resolution.QUARTER_DEGREE), rng)
    assert trial.distances_m[0] == pytest.approx(5.0)
    assert trial.bearings[0] == pytest.approx(math.atan2(4.0, 3.0) - np.pi / 2)
    assert trial.visible_shares[0] == pytest.approx(1.0)
    assert trial.num_beams[0] > 15
    outcomes = judge_detector([trial], TreeDetector(TreeSettings()), bench.TREES, 0.5)
    assert outcomes.found.tolist() == [True]
    assert outcomes.matched.tolist() == [Thing.STEM]
    assert np.abs(outcomes.errors).max() < 0.05


@pytest.mark.parametrize("figures", bench.FIGURES)
def test_every_figure_is_measured(figures: bench.Figures) -> None:
    rows = figures([11, 12])
    assert rows
    assert all(math.isfinite(row.value) for row in rows)
