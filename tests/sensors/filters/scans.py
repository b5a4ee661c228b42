"""Scans that the tests of the filters share."""

import numpy as np
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from sensors.filters.context import ScanContext
from sensors.measurements import LaserScan, ScannerGeometry, Tilt

INCREMENT = np.radians(0.5)
GEOMETRY = ScannerGeometry(-0.75 * np.pi, INCREMENT, 0.05, 100.0)
ODD_RANGES = st.sampled_from([np.inf, -np.inf, np.nan, 0.0, 0.01, 81.9, 5.0, -1.0]) | st.floats(
    0.0, 90.0
)
SCANS = st.lists(ODD_RANGES, max_size=541).map(lambda ranges_m: scan_of(ranges_m))
CONTEXTS = st.builds(
    ScanContext,
    twist=st.none() | st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    tilt=st.none() | st.builds(Tilt, st.floats(-0.4, 0.4), st.floats(-0.4, 0.4)),
)


def scan_of(ranges_m: ArrayLike, geometry: ScannerGeometry = GEOMETRY) -> LaserScan:
    """A scan whose intensities count its beams."""
    ranges = np.asarray(ranges_m, dtype=np.float64)
    return LaserScan(77, geometry, ranges, np.arange(len(ranges), dtype=np.float64))


def same_scan(a: LaserScan, b: LaserScan) -> None:
    assert (a.stamp_ns, a.geometry) == (b.stamp_ns, b.geometry)
    np.testing.assert_array_equal(a.ranges_m, b.ranges_m)
    assert a.intensities is not None
    assert b.intensities is not None
    np.testing.assert_array_equal(a.intensities, b.intensities)
