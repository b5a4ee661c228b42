"""The bench of rocks: truth and visibility are right, every figure is measured, none is given."""

import importlib
import math

import numpy as np
import pytest

from detectors.rock_settings import RockSettings
from detectors.rocks import RockDetector
from evaluation.benches import bench_rocks as bench
from evaluation.benches import rock_trials
from evaluation.benches.bench_table import Row
from evaluation.benches.rock_trials import RockTrial, judge_rocks, look, match_rocks
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.measurements import CameraGeometry, DepthImage, Mounting
from sensors.simulation.depth_camera import DepthCamera, Scene
from sensors.simulation.rock_shapes import rock_vertices
from sensors.simulation.terrain import MEDIUM, SMOOTH, Terrain, rough_terrain

try:
    importlib.import_module("open3d")
except (ImportError, OSError) as error:
    pytest.skip(f"Open3D does not load: {error}", allow_module_level=True)

TURNED = CameraGeometry(
    640, 480, 457.0, (319.5, 239.5), Mounting(x_m=0.4, height_m=1.3, pitch=0.3, yaw=0.5)
)


class Blind:
    def detect(self, image: DepthImage) -> Perceptions:
        nothing = np.zeros(0)
        return Perceptions.from_arrays(
            image.stamp_ns,
            Kind.ROCK,
            nothing,
            nothing,
            np.zeros((0, 2, 2)),
            diameters_m=nothing,
            diameter_sigmas_m=nothing,
        )


def _trial(*rocks: tuple[float, float, float], camera: CameraGeometry | None = None) -> RockTrial:
    """Rocks (x, y, diameter) on flat ground before a vehicle at the origin."""
    values = np.array(rocks)
    meshes = rock_vertices(values[:, 2], np.random.default_rng(0))
    meshes[:, :, :2] += values[:, None, :2]
    terrain = Terrain(0.1, np.zeros((301, 301)), values[:, :2], values[:, 2], meshes)
    device = DepthCamera() if camera is None else DepthCamera(camera)
    return look(Scene(terrain), Pose2(), device, np.random.default_rng(1))


def _perceived(*places: tuple[float, float]) -> Perceptions:
    x, y = np.array(places).T
    sigmas = np.full(len(x), 0.1)
    return Perceptions.from_arrays(
        0, Kind.ROCK, np.hypot(x, y), np.arctan2(y, x), polar_covariances(sigmas, sigmas)
    )


def test_the_truth_is_relative_to_the_camera() -> None:
    trial = _trial((4.4, 1.0, 0.5), camera=TURNED)
    assert trial.distances_m[0] == pytest.approx(math.hypot(4.0, 1.0))
    assert trial.bearings[0] == pytest.approx(math.atan2(1.0, 4.0) - 0.5)
    outcomes = judge_rocks(trial, RockDetector(RockSettings()), 0.7)
    assert outcomes.found.tolist() == [True]
    assert outcomes.right.tolist() == [True]
    assert np.abs(outcomes.errors[0, :2]).max() < 0.06


def test_visible_is_what_is_large_enough_whole_and_not_hidden() -> None:
    trial = _trial((4.0, 0.0, 0.6), (3.0, 1.2, 1.0), (3.75, 1.5, 0.2), (4.0, -3.2, 0.9))
    whole, before, behind, cut = trial.visible_shares
    assert whole == pytest.approx(1.0, abs=0.1)
    assert before == pytest.approx(1.0, abs=0.1)
    assert behind < 0.3
    assert cut < 0.6
    assert trial.visible.tolist() == [True, True, False, False]
    assert not _trial((12.0, 0.0, 0.12)).visible[0]


def test_each_rock_is_matched_once_and_only_from_near() -> None:
    trial = _trial((4.0, 0.0, 0.4), (6.0, 0.0, 1.2))
    perceived = _perceived((4.1, 0.0), (4.25, 0.0), (6.5, 0.0), (4.0, 2.0))
    assert match_rocks(perceived, trial).tolist() == [0, -1, 1, -1]


def test_a_blind_detector_finds_nothing_and_reaches_nothing() -> None:
    outcomes = judge_rocks(_trial((4.0, 0.0, 0.4)), Blind(), 0.0)
    assert not outcomes.found.any()
    assert outcomes.visible.any()
    rows = bench._figures("blind", outcomes, 0.5, 0.5)
    assert rows[0].value == 0.0
    assert not any(row.reached for row in rows)


def test_the_same_seed_gives_the_same_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rock_trials, "IMAGES_PER_TERRAIN", 1)
    (first,), (again,) = (
        list(rock_trials.rock_trials([3], SMOOTH, DepthCamera())) for _ in range(2)
    )
    np.testing.assert_array_equal(first.image.depths_m, again.image.depths_m)
    np.testing.assert_array_equal(first.visible_shares, again.visible_shares)


def test_the_camera_does_not_stand_on_a_rock() -> None:
    terrain = rough_terrain(SMOOTH, np.random.default_rng(2))
    scene = Scene(terrain)
    for seed in range(20):
        place = rock_trials._free_place(scene, np.random.default_rng(seed))
        large = terrain.diameters_m > 0.3
        apart_m = np.linalg.norm(terrain.world_t_rocks[large] - (place.x, place.y), axis=1)
        assert (apart_m > 0.5 * terrain.diameters_m[large]).all()


@pytest.fixture(scope="module")
def trials() -> list[RockTrial]:
    return list(rock_trials.rock_trials([21], MEDIUM, DepthCamera()))


@pytest.mark.parametrize("figures", bench.FIGURES)
def test_every_figure_is_measured(
    figures: bench.Figures, trials: list[RockTrial], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench._outcomes.cache_clear()
    monkeypatch.setattr(bench, "rock_trials", lambda *_: trials)
    monkeypatch.setattr(bench, "_MIN_IN_BIN", 1)
    rows: list[Row] = figures([21])
    bench._outcomes.cache_clear()
    assert rows
    assert all(math.isfinite(row.value) for row in rows)
