"""Median and shadow filter on surfaces, edges and single beams."""

import numpy as np
import pytest

from semgraph.geometry import Pose2
from sensors.filters.neighbours import MedianSettings, ShadowSettings, remove_shadows, smooth
from sensors.simulation.lms151 import Lms151, Resolution
from sensors.simulation.world import stand_of_trees
from tests.sensors.filters.scans import scan_of

MEDIAN = MedianSettings(num_beams=5, max_step_m=0.1)


def test_the_median_lessens_the_noise_of_a_surface() -> None:
    rng = np.random.default_rng(0)
    noise_m = 0.012 * rng.standard_normal(541)
    smoothed = smooth(scan_of(5.0 + noise_m), MEDIAN).ranges_m
    # The median of five normal values: variance 0.287 of one.
    assert (smoothed - 5.0).std() == pytest.approx(0.012 * np.sqrt(0.287), rel=0.15)


def test_the_median_keeps_edges_single_beams_and_no_returns() -> None:
    ranges_m = np.array([9.0, 9.0, 9.0, 4.0, 4.0, 4.0, np.inf, 2.0, np.inf, np.nan, -np.inf, 7.0])
    np.testing.assert_array_equal(smooth(scan_of(ranges_m), MEDIAN).ranges_m, ranges_m)


def test_the_median_takes_a_spike_out_of_a_surface() -> None:
    ranges_m = np.full(9, 5.0)
    ranges_m[4] = 5.08
    assert smooth(scan_of(ranges_m), MEDIAN).ranges_m[4] == 5.0


@pytest.mark.parametrize("mirrored", [False, True])
def test_points_between_two_surfaces_are_shadows(*, mirrored: bool) -> None:
    ranges_m = np.array([3.0, 3.0, 3.0, 4.5, 6.0, 8.0, 8.0, 8.0])[:: -1 if mirrored else 1]
    floating = np.isnan(remove_shadows(scan_of(ranges_m), ShadowSettings()).ranges_m)
    np.testing.assert_array_equal(floating, (ranges_m > 3.0) & (ranges_m < 8.0))


def test_a_thing_of_one_beam_and_a_wall_seen_at_an_angle_are_no_shadows() -> None:
    thing = np.array([8.0, 8.0, 3.0, 8.0, 8.0, np.inf, 4.0, np.inf])
    np.testing.assert_array_equal(remove_shadows(scan_of(thing), ShadowSettings()).ranges_m, thing)
    bearings = np.radians(np.arange(0.0, 75.0, 0.5))
    wall = scan_of(2.0 / np.cos(bearings))
    np.testing.assert_array_equal(remove_shadows(wall, ShadowSettings()).ranges_m, wall.ranges_m)


def test_shadows_are_what_mixes_and_trunks_stay() -> None:
    """Mixed pixels that a device with long pulses reports, told by the truth of the simulation."""
    device = Lms151(Resolution.QUARTER_DEGREE, echo_separation_m=4.0, dropout=0.0)
    floats, removed, kept_stems = [], [], []
    for seed in range(101, 107):
        world = stand_of_trees(np.random.default_rng(seed))
        scan = device.scan(world, Pose2(), np.random.default_rng(seed))
        echoes = device.echoes(world, Pose2(), np.random.default_rng(seed))
        stem = np.maximum(echoes.sources, 0)
        fronts_m = np.linalg.norm(world.world_t_things, axis=1)
        behind_m = echoes.ranges_m - fronts_m[stem]
        is_floating = (echoes.sources >= 0) & (behind_m > 0.3) & (echoes.ranges_m < 10.0)
        gone = np.isnan(remove_shadows(scan, ShadowSettings()).ranges_m)
        floats.append(is_floating.sum())
        removed.append((gone & is_floating).sum())
        on_trunk = (echoes.sources >= 0) & (behind_m < 0.0) & (world.radii_m[stem] > 0.05)
        kept_stems.append(1.0 - gone[on_trunk].mean())
    assert np.sum(floats) > 40
    assert np.sum(removed) > 0.5 * np.sum(floats)
    assert np.mean(kept_stems) > 0.98
