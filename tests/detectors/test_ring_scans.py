"""Clouds unrolled into scans: the grid, what is missing in it, and the seam."""

import numpy as np
import pytest

from detectors.ring_scans import RingScans, unroll_rings
from semgraph.arrays import FloatArray, IntArray
from sensors.measurements import Mounting, PointCloud

NUM_COLUMNS = 360


def _cloud(ranges_m: FloatArray, slopes: FloatArray, phase: float = 0.003) -> PointCloud:
    """Rings of horizontal ranges (k, m), +inf where nothing returned."""
    rings, columns = np.nonzero(np.isfinite(ranges_m))
    azimuths = phase + columns * 2.0 * np.pi / ranges_m.shape[1]
    horizontal_m = ranges_m[rings, columns]
    points = horizontal_m[:, None] * np.column_stack(
        [np.cos(azimuths), np.sin(azimuths), slopes[rings]]
    )
    return PointCloud(9, Mounting(), points, rings)


def _unrolled(cloud: PointCloud, increment: float = 0.0) -> RingScans:
    rings = unroll_rings(cloud, increment, 0.01, 60.0)
    assert rings is not None
    return rings


@pytest.mark.parametrize("increment", [0.0, 2.0 * np.pi / NUM_COLUMNS])
@pytest.mark.parametrize("phase", [-0.006, 0.0, 0.008])
def test_ranges_come_back_ring_by_ring_and_gaps_are_no_returns(
    increment: float, phase: float
) -> None:
    rng = np.random.default_rng(0)
    ranges_m = rng.uniform(2.0, 40.0, (3, NUM_COLUMNS))
    ranges_m[rng.random(ranges_m.shape) < 0.2] = np.inf
    slopes = np.array([-0.2, 0.0, 0.3])
    rings = _unrolled(_cloud(ranges_m, slopes, phase), increment)
    assert rings.num_columns == NUM_COLUMNS
    grid_m = rings.scan.ranges_m.reshape(3, rings.stride)
    np.testing.assert_allclose(rings.slopes, slopes, atol=1e-12)
    np.testing.assert_allclose(grid_m[:, :NUM_COLUMNS], ranges_m)
    overlap = rings.stride - NUM_COLUMNS - 2
    np.testing.assert_array_equal(grid_m[:, NUM_COLUMNS:-2], grid_m[:, :overlap])
    assert np.isnan(grid_m[:, -2:]).all()


def test_azimuths_are_those_of_the_points() -> None:
    ranges_m = np.full((2, NUM_COLUMNS), 5.0)
    rings = _unrolled(_cloud(ranges_m, np.array([0.0, 0.1]), 0.004))
    numbers: IntArray = np.array([0, 1, 1])
    beams = numbers * rings.stride + [7, 0, 359]
    azimuths = rings.azimuths(numbers, beams * rings.scan.geometry.angle_increment)
    np.testing.assert_allclose(azimuths, 0.004 + np.radians([7, 0, 359]), atol=1e-9)


def test_the_nearer_of_two_points_in_a_cell_counts() -> None:
    near = _cloud(np.full((1, NUM_COLUMNS), 3.0), np.zeros(1))
    far = _cloud(np.full((1, NUM_COLUMNS), 7.0), np.zeros(1))
    for first, second in ((near, far), (far, near)):
        points = np.vstack([first.sensor_t_points, second.sensor_t_points])
        both = PointCloud(9, Mounting(), points, np.zeros(len(points), np.int64))
        scan_m = _unrolled(both, np.radians(1.0)).scan.ranges_m
        assert np.nanmax(scan_m) == pytest.approx(3.0)


def test_unnumbered_rings_are_cut_by_elevation() -> None:
    numbered = _cloud(np.full((3, NUM_COLUMNS), 5.0), np.array([-0.1, 0.0, 0.1]))
    bare = PointCloud(
        9, Mounting(), numbered.sensor_t_points, np.full(len(numbered.rings), -1, np.int64)
    )
    assert sorted(_unrolled(bare).slopes.round(6).tolist()) == [-0.1, 0.0, 0.1]


@pytest.mark.parametrize("num_points", [0, 1, 9])
def test_too_few_points_tell_no_columns(num_points: int) -> None:
    points = np.column_stack(
        [np.full(num_points, 5.0), np.arange(num_points) * 0.1, np.zeros(num_points)]
    )
    cloud = PointCloud(9, Mounting(), points, np.zeros(num_points, np.int64))
    assert unroll_rings(cloud, 0.0, 0.01, 60.0) is None
