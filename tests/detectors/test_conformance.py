"""What every detector of laser scans in the catalog must keep, whatever the scan."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detectors.catalog import _load, create_detector, detector_names
from semgraph.arrays import FloatArray
from semgraph.geometry import wrap_angle
from semgraph.landmarks import Perceptions
from sensors.measurements import LaserScan, ScannerGeometry

NUM_BEAMS = 181
GEOMETRY = ScannerGeometry(-np.pi / 4, np.pi / 2 / (NUM_BEAMS - 1), 0.1, 60.0)
STAMP_NS = 1_234_567_890_123_456_789
ODD_RANGES = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 0.05, 1.0, 5.0, 59.9, 1e6, -3.0])

every_detector = pytest.mark.parametrize(
    "name", [name for name in detector_names() if _load(name).looks_at is LaserScan]
)


def _scan(ranges_m: FloatArray, intensities: FloatArray | None = None) -> LaserScan:
    bright = np.full(ranges_m.shape, 254.0) if intensities is None else intensities
    return LaserScan(STAMP_NS, GEOMETRY, ranges_m, bright)


def _posts(rng: np.random.Generator, num_posts: int = 5) -> tuple[LaserScan, FloatArray]:
    """Bright posts of 0.1 m, well apart, nothing behind; and (n, 2) their true range, bearing."""
    angles = GEOMETRY.angle_min + GEOMETRY.angle_increment * np.arange(NUM_BEAMS)
    ranges_m = np.full(NUM_BEAMS, np.inf)
    slots = rng.choice(np.arange(10, NUM_BEAMS - 10, 16), num_posts, replace=False)
    bearings = np.sort(angles[slots] + rng.uniform(-0.004, 0.004, num_posts))
    distances_m = rng.uniform(2.0, 3.0, num_posts)
    for distance_m, bearing in zip(distances_m, bearings, strict=True):
        across_m = np.abs(angles - bearing) * distance_m
        # A beam 15 mrad + 8 mm wide also returns from posts that its middle misses.
        lit = across_m < 0.05 + 0.9 * 0.5 * (0.015 * distance_m + 0.008)
        depths_m = np.sqrt(0.05**2 - np.minimum(across_m[lit], 0.045) ** 2)
        ranges_m[lit] = distance_m - depths_m
    scan = _scan(ranges_m, np.where(np.isfinite(ranges_m), 254.0, 0.0))
    return scan, np.column_stack([distances_m, bearings])


def _same(a: Perceptions, b: Perceptions) -> None:
    for field in Perceptions.__slots__:
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


@every_detector
@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 0.0])
@pytest.mark.parametrize("num_beams", [0, 1, 2, NUM_BEAMS])
def test_no_return_is_no_perception(name: str, value: float, num_beams: int) -> None:
    perceptions = create_detector(name, {}).detect(_scan(np.full(num_beams, value)))
    assert len(perceptions) == 0
    assert perceptions.stamp_ns == STAMP_NS


@every_detector
@given(data=st.data())
@settings(max_examples=150, deadline=None, derandomize=True)
def test_odd_scans_give_valid_perceptions_again_and_again(name: str, data: st.DataObject) -> None:
    ranges_m = np.array(data.draw(st.lists(ODD_RANGES | st.floats(0.0, 70.0), max_size=60)))
    bright = st.sampled_from([0.0, 254.0, 32768.0, 1e308])
    intensities = data.draw(st.lists(bright, min_size=len(ranges_m), max_size=len(ranges_m)))
    scan = _scan(ranges_m, np.array(intensities))
    detector = create_detector(name, {})
    first = detector.detect(scan)
    assert first.stamp_ns == STAMP_NS
    assert (first.ranges_m < 70.0).all()
    _same(first, detector.detect(scan))


@every_detector
@pytest.mark.parametrize("seed", range(20))
def test_clutter_does_not_break_it(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scan = _scan(rng.uniform(0.2, 40.0, NUM_BEAMS), rng.uniform(0.0, 500.0, NUM_BEAMS))
    perceptions = create_detector(name, {}).detect(scan)
    assert (np.abs(perceptions.bearings) <= np.pi / 4 + 0.1).all()


@every_detector
@pytest.mark.parametrize("seed", range(10))
def test_posts_are_found_once_each_where_they_stand(name: str, seed: int) -> None:
    scan, true_posts = _posts(np.random.default_rng(seed))
    perceptions = create_detector(name, {}).detect(scan)
    assert len(perceptions) == len(true_posts)
    np.testing.assert_allclose(perceptions.bearings, true_posts[:, 1], atol=0.006)
    np.testing.assert_allclose(perceptions.ranges_m, true_posts[:, 0], atol=0.06)


@every_detector
@pytest.mark.parametrize("seed", range(10))
def test_a_mirrored_scan_gives_mirrored_perceptions(name: str, seed: int) -> None:
    scan, _ = _posts(np.random.default_rng(seed))
    assert scan.intensities is not None
    detector = create_detector(name, {})
    there = detector.detect(scan)
    mirrored = detector.detect(_scan(scan.ranges_m[::-1], scan.intensities[::-1]))
    assert len(there) > 0
    np.testing.assert_allclose(mirrored.bearings[::-1], -there.bearings, atol=1e-9)
    np.testing.assert_allclose(mirrored.ranges_m[::-1], there.ranges_m, atol=1e-9)
    np.testing.assert_allclose(mirrored.reliabilities[::-1], there.reliabilities, atol=1e-9)


@every_detector
@pytest.mark.parametrize("turn", [0.3, -1.2, np.pi])
def test_turning_the_field_turns_the_bearings(name: str, turn: float) -> None:
    scan, _ = _posts(np.random.default_rng(3))
    geometry = ScannerGeometry(GEOMETRY.angle_min + turn, GEOMETRY.angle_increment, 0.1, 60.0)
    turned = LaserScan(STAMP_NS, geometry, scan.ranges_m, scan.intensities)
    detector = create_detector(name, {})
    there, here = detector.detect(scan), detector.detect(turned)
    np.testing.assert_allclose(wrap_angle(here.bearings - there.bearings - turn), 0.0, atol=1e-9)
    np.testing.assert_allclose(here.ranges_m, there.ranges_m, atol=1e-9)


@every_detector
def test_the_scan_is_left_as_it_was(name: str) -> None:
    scan, _ = _posts(np.random.default_rng(4))
    before = scan.ranges_m.copy()
    create_detector(name, {}).detect(scan)
    np.testing.assert_array_equal(scan.ranges_m, before)
