"""Levelling undoes the simulated tilt and takes the ground out."""

import math

import numpy as np
import pytest

from semgraph.geometry import Pose2
from sensors.filters.context import ScanContext
from sensors.filters.levelling import LevelSettings, level
from sensors.measurements import ScannerGeometry, Tilt
from sensors.simulation.lms151 import GROUND, Lms151, Resolution
from sensors.simulation.world import Thing, World
from tests.sensors.filters.scans import GEOMETRY, boles, rms_range_error_m, scan_of


@pytest.mark.parametrize("resolution", list(Resolution))
@pytest.mark.parametrize("tilt", [Tilt(0.05, 0.04), Tilt(-0.06, 0.08)])
def test_it_undoes_the_tilt_of_the_simulation(resolution: Resolution, tilt: Tilt) -> None:
    device = Lms151(resolution, range_sigma_m=0.0, dropout=0.0, height_m=0.6)
    settings, context = LevelSettings(height_m=0.6), ScanContext(tilt=tilt)
    before_m, after_m = [], []
    for seed in range(101, 107):
        world = boles(seed)
        static = device.scan(world, Pose2(), np.random.default_rng(0))
        tilted = device.scan(world, Pose2(), np.random.default_rng(0), tilt=tilt)
        before_m.append(rms_range_error_m(tilted, static))
        after_m.append(rms_range_error_m(level(tilted, settings, context), static))
    assert np.mean(before_m) > 0.010
    assert np.mean(after_m) < 0.012
    assert np.mean(after_m) < 0.4 * np.mean(before_m)


@pytest.mark.parametrize("seed", range(101, 105))
def test_the_ground_becomes_invalid_and_trunks_stay(seed: int) -> None:
    tilt = Tilt(0.03, 0.07)
    device = Lms151(height_m=0.6, dropout=0.0)
    world = boles(seed)
    echoes = device.echoes(world, Pose2(), np.random.default_rng(0), tilt=tilt)
    scan = device.scan(world, Pose2(), np.random.default_rng(0), tilt=tilt)
    levelled = level(scan, LevelSettings(height_m=0.6), ScanContext(tilt=tilt))
    ground = echoes.sources == GROUND
    assert ground.sum() > 30
    # A beam beside an edge may take its neighbour's word.
    assert np.isfinite(levelled.ranges_m[ground]).mean() < 0.05
    dips = -tilt.level_R_base()[2] @ np.stack(
        [np.cos(device.beam_angles()), np.sin(device.beam_angles()), np.zeros(541)]
    )
    high = (echoes.sources >= 0) & (0.6 - dips * echoes.ranges_m > 0.25)
    assert np.isfinite(levelled.ranges_m[high]).mean() > 0.95


@pytest.mark.parametrize(
    ("tilt", "mounted", "range_m", "is_ground"),
    [
        (Tilt(pitch=0.1), Pose2(), 8.0, False),
        (Tilt(pitch=0.1), Pose2(), 9.0, True),
        (Tilt(pitch=-0.1), Pose2(), 40.0, False),
        # Mounted 2 m ahead of base, the laser itself is 0.2 m lower.
        (Tilt(pitch=0.1), Pose2(2.0, 0.0, 0.0), 8.0, True),
        # Looking right, which roll lowers.
        (Tilt(roll=0.1), Pose2(0.0, 0.0, -np.pi / 2), 9.0, True),
        (Tilt(roll=-0.1), Pose2(0.0, 0.0, -np.pi / 2), 9.0, False),
    ],
)
def test_ground_is_told_by_the_height_of_the_laser(
    tilt: Tilt, mounted: Pose2, range_m: float, *, is_ground: bool
) -> None:
    ranges_m = np.full(3, range_m)
    scan = scan_of(ranges_m, ScannerGeometry(-0.01, 0.01, 0.1, 90.0, mounted))
    settings = LevelSettings(height_m=1.0, ground_margin_m=0.15)
    levelled = level(scan, settings, ScanContext(tilt=tilt)).ranges_m[1]
    assert math.isnan(levelled) == is_ground
    x_m, y_m, _ = tilt.level_R_base() @ (mounted.x, mounted.y, 1.0)
    moved = level(scan, settings, ScanContext(tilt=tilt)).base_T_sensor
    assert (moved.x, moved.y, moved.theta) == pytest.approx((x_m, y_m, mounted.theta))
    if not is_ground:
        assert levelled == pytest.approx(range_m * math.cos(0.1), abs=1e-3)


@pytest.mark.parametrize("tilt", [Tilt(0.3, 0.0), Tilt(0.0, 0.3), Tilt(-0.2, 0.2)])
def test_a_round_room_of_upright_walls_is_round_again(tilt: Tilt) -> None:
    """A cylinder of 5 m about the laser is met farther away by each tilted beam."""
    bearings = GEOMETRY.angle_min + GEOMETRY.angle_increment * np.arange(541)
    directions = tilt.level_R_base() @ np.stack([np.cos(bearings), np.sin(bearings), 0 * bearings])
    slants_m = 5.0 / np.hypot(directions[0], directions[1])
    assert slants_m.max() > 5.1
    levelled = level(scan_of(slants_m), LevelSettings(height_m=3.0), ScanContext(tilt=tilt))
    inside = np.isfinite(levelled.ranges_m)
    assert inside.mean() > 0.95
    np.testing.assert_allclose(levelled.ranges_m[inside], 5.0, atol=1e-9)


def test_bearings_are_those_in_the_horizontal_plane() -> None:
    """A stem at 45 deg of a laser that rolls by 0.3 rad stands farther ahead than its beam."""
    tilt = Tilt(roll=-0.3)
    device = Lms151(Resolution.QUARTER_DEGREE, range_sigma_m=0.0, dropout=0.0, height_m=8.0)
    stem = World.of(Thing.STEM, np.full((1, 2), 4.0), np.array([0.5]), np.random.default_rng(0))
    tilted = device.scan(stem, Pose2(), np.random.default_rng(0), tilt=tilt)
    levelled = level(tilted, LevelSettings(height_m=8.0), ScanContext(tilt=tilt))
    middles = [device.beam_angles()[scan.ranges_m < 10.0].mean() for scan in (tilted, levelled)]
    assert abs(middles[0] - np.pi / 4) > 0.015
    assert middles[1] == pytest.approx(np.pi / 4, abs=0.003)
