"""Trunks in simulated clouds: where they stand, how thick, how sure."""

import numpy as np
import pytest

from detectors.tree_3d_settings import Tree3dSettings
from detectors.trees_3d import Tree3dDetector
from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import Mounting, PointCloud, Tilt
from sensors.simulation.lidar_3d import Lidar3d
from sensors.simulation.world import Thing
from sensors.simulation.world_3d import World3d

DEVICE = Lidar3d(num_rings=32, num_columns=1800)
DETECTOR = Tree3dDetector(Tree3dSettings())


def _trunk(
    x: float, y: float, diameter_m: float, lean: tuple[float, float] = (0.0, 0.0)
) -> World3d:
    return World3d(
        np.array([[x, y]]),
        np.array([lean]),
        np.array([diameter_m / 2.0]),
        np.zeros(1),
        np.full(1, 9.0),
        np.full(1, Thing.STEM),
    )


def _errors(world: World3d, device: Lidar3d, tilt: Tilt, pose: Pose2) -> FloatArray:
    """(n, 4): x and y in base, diameter, NEES of a trunk that stands alone, 5 times."""
    rng = np.random.default_rng(101)
    true_m = pose.inverse().transform(world.centres_at(1.3))[0]
    rows = []
    for _ in range(5):
        cloud = device.scan(world, pose, rng, tilt=tilt)
        found = DETECTOR.detect(cloud).seen_from(cloud.base_T_sensor)
        assert len(found) == 1
        assert found.kinds.tolist() == [Kind.TREE]
        error = found.base_t_landmarks()[0] - true_m
        wide = found.diameters_m[0] - 2.0 * world.radii_m[0]
        nees = error @ np.linalg.solve(found.base_covariances()[0], error)
        rows.append([*error, wide, nees + (wide / found.diameter_sigmas_m[0]) ** 2])
    return np.array(rows)


@pytest.mark.parametrize("diameter_m", [0.2, 0.45])
@pytest.mark.parametrize(("distance_m", "sigma_m"), [(4.0, 0.008), (9.0, 0.02), (16.0, 0.04)])
def test_a_lone_trunk_is_measured(diameter_m: float, distance_m: float, sigma_m: float) -> None:
    errors = _errors(_trunk(distance_m, 1.0, diameter_m), DEVICE, Tilt(), Pose2())
    rms = np.sqrt((errors**2).mean(axis=0))
    assert rms[:2].max() < sigma_m
    assert rms[2] < sigma_m
    assert errors[:, 3].mean() < 9.0


@pytest.mark.parametrize("tilt", [Tilt(0.08, 0.0), Tilt(0.0, -0.06), Tilt(-0.05, 0.07)])
@pytest.mark.parametrize(
    "mounting", [Mounting(height_m=1.2), Mounting(0.6, -0.3, 1.8, 0.02, 0.1, 0.7)]
)
def test_a_trunk_stands_where_it_does_however_base_leans(tilt: Tilt, mounting: Mounting) -> None:
    device = Lidar3d(num_rings=32, num_columns=1800, mounting=mounting)
    errors = _errors(_trunk(3.0, 6.0, 0.35), device, tilt, Pose2(0.5, -1.0, 0.9))
    assert np.abs(errors[:, :2].mean(axis=0)).max() < 0.012
    assert abs(errors[:, 2].mean()) < 0.012


@pytest.mark.parametrize("lean", [(0.1, 0.0), (-0.05, 0.08)])
def test_a_leaning_trunk_is_told_at_breast_height(lean: tuple[float, float]) -> None:
    """At the height of the sections' middle it would be off by 5 cm and more."""
    errors = _errors(_trunk(8.0, -2.0, 0.3, lean), DEVICE, Tilt(), Pose2())
    assert np.abs(errors[:, :2].mean(axis=0)).max() < 0.025


@pytest.mark.parametrize("columns", [512, 1024, 2048])
def test_what_stands_at_the_seam_is_found_once(columns: int) -> None:
    device = Lidar3d(num_columns=columns)
    for y in (-0.1, 0.0, 0.07):
        cloud = device.scan(_trunk(-4.0, y, 0.3), Pose2(), np.random.default_rng(0))
        found = DETECTOR.detect(cloud)
        assert len(found) == 1
        assert abs(found.bearings[0]) == pytest.approx(np.pi, abs=0.03)


def test_a_trunk_with_its_middle_hidden_is_one() -> None:
    device = Lidar3d(num_columns=1800, range_sigma_m=0.0, dropout=0.0)
    cloud = device.scan(_trunk(9.0, 0.0, 0.4), Pose2(), np.random.default_rng(0))
    shown = np.abs(cloud.sensor_t_points[:, 2] - 0.3) > 0.65
    pieces = PointCloud(0, cloud.mounting, cloud.sensor_t_points[shown], cloud.rings[shown])
    assert len(np.unique(cloud.rings)) - len(np.unique(pieces.rings)) > 5
    split = Tree3dDetector(Tree3dSettings(link_m=0.25)).detect(pieces)
    assert len(split) == 1
    assert split.ranges_m[0] == pytest.approx(9.0, abs=0.02)


def test_rings_that_are_not_numbered_are_cut_by_elevation() -> None:
    cloud = DEVICE.scan(_trunk(6.0, 2.0, 0.3), Pose2(), np.random.default_rng(0))
    bare = PointCloud(0, cloud.mounting, cloud.sensor_t_points, np.full(len(cloud.rings), -1))
    step = float(np.diff(DEVICE.elevations)[0])
    found = Tree3dDetector(Tree3dSettings(elevation_step=step)).detect(bare)
    assert len(found) == 1
    assert found.ranges_m[0] == pytest.approx(np.hypot(6.0, 2.0), abs=0.03)
    assert found.diameters_m[0] == pytest.approx(0.3, abs=0.04)


def _short(top_m: float) -> Perceptions:
    trunk = _trunk(5.0, 0.0, 0.3)
    short = World3d(
        trunk.world_t_feet,
        trunk.leans,
        trunk.radii_m,
        np.full(1, 1.0),
        np.full(1, top_m),
        trunk.things,
    )
    return DETECTOR.detect(DEVICE.scan(short, Pose2(), np.random.default_rng(0)))


def test_what_is_too_short_for_a_trunk_is_none() -> None:
    assert len(_short(1.25)) == 0
    assert len(_short(2.0)) == 1


def test_more_sections_are_more_reliable() -> None:
    reliabilities = [
        Tree3dDetector(Tree3dSettings(min_reliability=0.0))
        .detect(
            Lidar3d(num_rings=num, num_columns=1800).scan(
                _trunk(9.0, 0.0, 0.3), Pose2(), np.random.default_rng(0)
            )
        )
        .reliabilities[0]
        for num in (8, 16, 64)
    ]
    assert reliabilities == sorted(reliabilities)
    assert reliabilities[-1] > 0.95
