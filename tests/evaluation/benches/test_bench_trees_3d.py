"""The bench of trees in clouds: every figure is measured, truth is true, a blind detector fails."""

import math

import numpy as np
import pytest

from detectors.tree_3d_settings import Tree3dSettings
from detectors.trees_3d import Tree3dDetector
from evaluation.benches import bench_trees_3d as bench
from evaluation.benches.detector_trials import judge_detector
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import PointCloud, Tilt
from sensors.simulation.world import Thing, World
from sensors.simulation.world_3d import UnderstoreySettings, raise_up


class Blind:
    def detect(self, cloud: PointCloud) -> Perceptions:
        nothing = np.zeros(0)
        return Perceptions.from_arrays(
            cloud.stamp_ns, Kind.TREE, nothing, nothing, np.zeros((0, 2, 2))
        )


def test_the_truth_of_a_lone_trunk() -> None:
    rng = np.random.default_rng(0)
    flat = World.of(Thing.STEM, np.array([[3.0, 4.0]]), np.array([0.4]), rng)
    world = raise_up(flat, rng, UnderstoreySettings(lean_sigma=0.05))
    x, y = world.centres_at(1.3)[0]
    pose = Pose2(0.0, 0.0, np.pi / 2)
    trial = bench.look_3d(world, pose, bench.DEVICES[64], rng, Tilt(0.02, 0.03))
    assert trial.distances_m[0] == pytest.approx(math.hypot(x, y))
    assert trial.bearings[0] == pytest.approx(math.atan2(y, x) - np.pi / 2)
    assert trial.visible_shares[0] == pytest.approx(1.0, abs=0.1)
    assert trial.num_beams[0] > 40
    outcomes = judge_detector([trial], Tree3dDetector(Tree3dSettings()), bench.TREES, 0.5)
    assert outcomes.found.tolist() == [True]
    assert np.abs(outcomes.errors).max() < 0.03
    assert not judge_detector([trial], Blind(), bench.TREES, 0.5).found.any()


@pytest.mark.parametrize("figures", bench.FIGURES)
def test_every_figure_is_measured(figures: bench.Figures) -> None:
    rows = figures(16, [11, 12])
    assert rows
    assert all(math.isfinite(row.value) for row in rows)


def test_all_rows_are_named_apart_but_for_the_two_sides_of_a_band() -> None:
    names = [row.name for figures in bench.FIGURES for row in figures(16, [13])]
    assert len(names) - len(set(names)) == 1
