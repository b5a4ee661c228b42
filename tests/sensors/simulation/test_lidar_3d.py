"""The simulated spinning laser against closed forms and a slow reference."""

import math

import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.measurements import Mounting, Tilt
from sensors.simulation.lidar_3d import GROUND, NOTHING, Lidar3d, _placed
from sensors.simulation.world import FOREST, StandSettings, Thing
from sensors.simulation.world_3d import World3d, stand_in_3d

SMALL = StandSettings(radius_m=9.0, stems_per_ha=700.0, clumps_per_stem=0.1)
COARSE = Lidar3d(
    num_rings=12,
    num_columns=180,
    num_rays=1,
    range_sigma_m=0.0,
    dropout=0.0,
    ground_roughness_m=0.0,
    mounting=Mounting(0.3, 0.1, 1.4, 0.02, -0.05, 0.4),
)


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def _trunk(x: float, y: float, lean: tuple[float, float] = (0.0, 0.0)) -> World3d:
    return World3d(
        np.array([[x, y]]),
        np.array([lean]),
        np.array([0.2]),
        np.zeros(1),
        np.full(1, 6.0),
        np.full(1, Thing.STEM),
    )


def _slow_hit(world: World3d, start: np.ndarray, ray: np.ndarray) -> tuple[float, int]:
    """One ray against everything, by marching and bisection: 3 mm steps, heights in words."""
    distances_m = np.arange(0.0, 20.0, 0.003)
    points = start + distances_m[:, None] * ray
    best = (math.inf, NOTHING)
    below = np.flatnonzero(points[:, 2] <= 0.0)
    if len(below):
        best = (float(distances_m[below[0]]), GROUND)
    for k in range(len(world)):
        axis = world.world_t_feet[k] + points[:, 2:] * world.leans[k]
        inside = np.linalg.norm(points[:, :2] - axis, axis=1) < world.radii_m[k]
        tall = (points[:, 2] > world.bottoms_m[k]) & (points[:, 2] < world.tops_m[k])
        met = np.flatnonzero(inside & tall)
        if len(met) and distances_m[met[0]] < best[0]:
            best = (float(distances_m[met[0]]), k)
    return best


def test_it_agrees_with_the_slow_reference() -> None:
    world = stand_in_3d(_rng(101), SMALL)
    pose, tilt = Pose2(0.4, -0.2, 1.1), Tilt(0.05, -0.08)
    ranges_m, sources = COARSE.echoes(world, pose, _rng(), tilt=tilt)
    world_R_sensor, start = _placed(pose, tilt, COARSE.mounting)
    same = compared = 0
    for ring in range(0, 12, 3):
        for column in range(0, 180, 12):
            azimuth, elevation = COARSE.azimuths()[ring, column], COARSE.elevations[ring]
            level = math.cos(elevation)
            ray = world_R_sensor @ (
                level * math.cos(azimuth),
                level * math.sin(azimuth),
                math.sin(elevation),
            )
            slow_m, source = _slow_hit(world, start, ray)
            if slow_m > 19.0 and ranges_m[ring, column] > 19.0:
                continue
            compared += 1
            same += source == sources[ring, column]
            if source == sources[ring, column]:
                assert ranges_m[ring, column] == pytest.approx(slow_m, abs=0.005)
    assert compared > 25
    # A twig thinner than two steps may be missed by the reference.
    assert same >= compared - 1


@pytest.mark.parametrize("bearing", [0.0, 1.3, -2.4, math.pi])
def test_a_trunk_is_met_at_its_front_by_every_ring(bearing: float) -> None:
    device = Lidar3d(num_rays=1, mounting=Mounting(height_m=2.5))
    world = _trunk(7.0 * math.cos(bearing), 7.0 * math.sin(bearing))
    ranges_m, sources = device.echoes(world, Pose2(), _rng())
    for ring, elevation in enumerate(device.elevations):
        height_m = 2.5 + 6.8 * math.tan(elevation)
        hits = sources[ring] == 0
        assert hits.any() == (0.0 < height_m < 6.0)
        if hits.any():
            nearest_m = ranges_m[ring, hits].min() * math.cos(elevation)
            assert nearest_m == pytest.approx(6.8, abs=0.005)


def test_a_leaning_trunk_is_met_along_its_axis() -> None:
    device = Lidar3d(num_rays=1, mounting=Mounting(height_m=1.5))
    ranges_m, sources = device.echoes(_trunk(8.0, 0.0, (0.2, 0.0)), Pose2(), _rng())
    for ring in (34, 45, 60):
        slope = math.tan(device.elevations[ring])
        # Front at x = 8 + 0.2 z - 0.2, height z = 1.5 + slope x.
        expected_m = (7.8 + 0.3) / (1.0 - 0.2 * slope)
        hits = sources[ring] == 0
        nearest_m = ranges_m[ring, hits].min() * math.cos(device.elevations[ring])
        assert nearest_m == pytest.approx(expected_m, abs=0.005)


def test_the_ground_is_as_far_as_the_height_says() -> None:
    device = Lidar3d(ground_roughness_m=0.0, mounting=Mounting(height_m=1.2))
    nothing = _trunk(1.0, 0.0).select(np.zeros(1, dtype=bool))
    ranges_m, sources = device.echoes(nothing, Pose2(), _rng())
    down = np.sin(-device.elevations)
    struck = (down > 0.0) & (1.2 / np.maximum(down, 1e-9) < device.range_max_m)
    assert (sources[struck] == GROUND).all()
    assert (sources[~struck] == NOTHING).all()
    np.testing.assert_allclose(
        ranges_m[struck], np.broadcast_to((1.2 / down[struck])[:, None], ranges_m[struck].shape)
    )


def test_points_lie_on_what_they_came_from() -> None:
    device = Lidar3d(range_sigma_m=0.0, dropout=0.0, beam_divergence=0.0, ground_roughness_m=0.0)
    pose, tilt = Pose2(0.5, 0.3, 0.8), Tilt(0.03, 0.06)
    world = _trunk(5.0, 4.0)
    cloud = device.scan(world, pose, _rng(), tilt=tilt, stamp_ns=5)
    assert (cloud.stamp_ns, cloud.tilt, cloud.mounting) == (5, tilt, device.mounting)
    world_R_sensor, start = _placed(pose, tilt, device.mounting)
    points = cloud.sensor_t_points @ world_R_sensor.T + start
    above = points[:, 2] > 0.01
    radii_m = np.linalg.norm(points[above, :2] - (5.0, 4.0), axis=1)
    assert above.sum() > 200
    np.testing.assert_allclose(radii_m, 0.2, atol=1e-6)


def test_noise_and_dropout_are_those_asked_for() -> None:
    world = _trunk(5.0, 0.0).select(np.zeros(1, dtype=bool))
    quiet = Lidar3d(range_sigma_m=0.0, dropout=0.0, ground_roughness_m=0.0)
    loud = Lidar3d(range_sigma_m=0.05, dropout=0.1, ground_roughness_m=0.0)
    all_points = quiet.scan(world, Pose2(), _rng())
    some = loud.scan(world, Pose2(), _rng())
    assert len(some.rings) / len(all_points.rings) == pytest.approx(0.9, abs=0.01)
    lengths_m = np.linalg.norm(some.sensor_t_points, axis=1)
    expected_m = 1.2 / np.sin(-quiet.elevations[some.rings])
    assert (lengths_m - expected_m).std() == pytest.approx(0.05, rel=0.05)


def test_a_wide_beam_makes_a_trunk_wider_and_mixes_what_stands_close() -> None:
    narrow = Lidar3d(num_columns=3600, beam_divergence=0.0)
    wide = Lidar3d(num_columns=3600, beam_divergence=0.006)
    counts = [
        int((device.echoes(_trunk(10.0, 0.0), Pose2(), _rng())[1][40] == 0).sum())
        for device in (narrow, wide)
    ]
    gained = (counts[1] - counts[0]) * narrow.increment
    # Each edge gains what may be missed of the half beam: 0.5 - 0.3 of it.
    assert gained == pytest.approx(2 * 0.2 * 0.006, abs=2 * narrow.increment)


def test_moving_world_and_laser_together_changes_nothing() -> None:
    world, pose = stand_in_3d(_rng(3), FOREST), Pose2(3.0, -2.0, 2.5)
    moved = World3d(
        pose.transform(world.world_t_feet),
        Pose2(0.0, 0.0, pose.theta).transform(world.leans),
        world.radii_m,
        world.bottoms_m,
        world.tops_m,
        world.things,
    )
    here, _ = COARSE.echoes(world, Pose2(), _rng(1))
    there, _ = COARSE.echoes(moved, pose, _rng(1))
    assert np.isclose(here, there, atol=1e-6).mean() > 0.998


@pytest.mark.parametrize(
    "bad",
    [
        {"num_rings": 0},
        {"num_columns": 2},
        {"num_rays": 0},
        {"elevation_min": 0.5, "elevation_max": 0.1},
        {"range_min_m": 0.0},
        {"range_max_m": math.nan},
    ],
)
def test_a_device_that_cannot_be_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InputError, match="3D laser: expected a ring, 8 columns"):
        Lidar3d(**bad)  # type: ignore[arg-type]  # one wrong value of each kind
