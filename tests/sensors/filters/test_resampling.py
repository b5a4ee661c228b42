"""Resampling moved points: surfaces, edges, both ends, and either sense of turning."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sensors.filters.resampling import beam_bearings, has_point, resample
from sensors.measurements import LaserScan, ScannerGeometry
from tests.sensors.filters.scans import INCREMENT, SCANS, scan_of


@pytest.mark.parametrize("increment", [INCREMENT, -INCREMENT])
@pytest.mark.parametrize("shift", [0.3, -0.7, 1.4])
def test_a_surface_is_interpolated(increment: float, shift: float) -> None:
    geometry = ScannerGeometry(0.2, increment, 0.1, 50.0)
    scan = scan_of(np.zeros(50), geometry)
    bearings = beam_bearings(scan)
    shifts = np.full(50, shift * INCREMENT)
    moved = resample(scan, 5.0 + 0.5 * (bearings + shifts), shifts, 0.1)
    inner = slice(3, -3)
    np.testing.assert_allclose(moved.ranges_m[inner], 5.0 + 0.5 * bearings[inner])


def test_at_an_edge_the_nearer_beam_in_bearing_counts() -> None:
    ranges_m = np.array([3.0, 3.0, 3.0, 8.0, 8.0, np.inf, np.inf])
    for share, expected in ((0.3, ranges_m), (0.7, np.append(np.nan, ranges_m[:-1]))):
        moved = resample(scan_of(ranges_m), ranges_m, np.full(7, share * INCREMENT), 0.1)
        np.testing.assert_allclose(moved.ranges_m, expected)


def test_what_moved_out_of_the_field_leaves_what_is_not_known() -> None:
    ranges_m = np.full(9, 4.0)
    moved = resample(scan_of(ranges_m), ranges_m, np.full(9, -2.0 * INCREMENT), 0.1)
    np.testing.assert_array_equal(np.isnan(moved.ranges_m), np.arange(9) >= 7)


@given(scan=SCANS)
def test_without_a_shift_nothing_changes(scan: LaserScan) -> None:
    still = resample(scan, scan.ranges_m, np.zeros(len(scan.ranges_m)), 0.1)
    np.testing.assert_array_equal(still.ranges_m, scan.ranges_m)
    np.testing.assert_array_equal(has_point(still.ranges_m), has_point(scan.ranges_m))


@given(scan=SCANS, data=st.data())
def test_each_range_is_one_of_two_neighbours_or_between(
    scan: LaserScan, data: st.DataObject
) -> None:
    m = len(scan.ranges_m)
    shifts = np.array(data.draw(st.lists(st.floats(-3.0, 3.0), min_size=m, max_size=m)))
    moved = resample(scan, scan.ranges_m, shifts * INCREMENT, 0.1)
    there = scan.ranges_m[has_point(scan.ranges_m)]
    for range_m in moved.ranges_m[has_point(moved.ranges_m)]:
        assert np.abs(there - range_m).min() <= 0.05 + 1e-9
