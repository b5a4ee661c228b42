"""Scans that the tests of the filters share."""

import numpy as np
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from sensors.filters.context import ScanContext
from sensors.filters.resampling import beam_bearings
from sensors.measurements import LaserScan, ScannerGeometry, Tilt
from sensors.simulation.world import Thing, World

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


def boles(seed: int) -> World:
    """A ring of thick stems about the origin, so that much of a scan is surface."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(-np.pi, np.pi, 26, endpoint=False)
    distances_m = rng.uniform(4.0, 11.0, 26)
    places = distances_m[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return World.of(Thing.STEM, places, rng.uniform(0.5, 0.9, 26), rng)


def rms_range_error_m(scan: LaserScan, static: LaserScan) -> float:
    """Of what both see on one surface, on the bearings of `static`."""
    seen_m = np.where(np.isfinite(scan.ranges_m), scan.ranges_m, np.nan)
    here_m = np.interp(beam_bearings(static), beam_bearings(scan), seen_m)
    errors_m = here_m - np.where(np.isfinite(static.ranges_m), static.ranges_m, np.nan)
    errors_m = errors_m[np.abs(errors_m) < 1.0]
    assert len(errors_m) > 100
    return float(np.sqrt(np.mean(errors_m**2)))
