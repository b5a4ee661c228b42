"""Bounds of a post's bearing: hold the truth, narrow as the beams tell, admit contradictions."""

import numpy as np
import pytest

from detectors.reflector_edges import Sweep, beam_bounds
from detectors.reflectors import ReflectorDetector, ReflectorSettings
from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, wrap_angle
from sensors.measurements import LaserScan, ScannerGeometry
from sensors.simulation.lms151 import Lms151, Resolution
from sensors.simulation.world import Thing, World

REACH, SATURATION = 2.3, 0.25


def _sweep(centre: float, num_beams: int = 21) -> Sweep:
    """A post at `centre` beams, at 5 m, the background at 12 m."""
    overlaps = REACH - np.abs(np.arange(num_beams) - centre)
    is_lit = overlaps > 0.0
    brightness = np.where(is_lit, np.minimum(overlaps / SATURATION, 1.0), 0.05)
    return Sweep(np.where(is_lit, 5.0, 12.0), brightness)


def _bounds(sweep: Sweep, first: int, last: int) -> tuple[float, float]:
    low, high = beam_bounds(
        sweep,
        (np.array([first]), np.array([last])),
        np.array([5.0]),
        np.array([REACH]),
        np.array([SATURATION]),
    )
    return float(low[0]), float(high[0])


def _bright(sweep: Sweep, level: float = 0.8) -> tuple[int, int]:
    bright = np.flatnonzero((sweep.brightness > level) & (sweep.ranges_m < 6.0))
    return int(bright[0]), int(bright[-1])


@pytest.mark.parametrize("centre", np.linspace(9.0, 11.0, 41))
def test_bounds_hold_the_truth(centre: float) -> None:
    sweep = _sweep(centre)
    low, high = _bounds(sweep, *_bright(sweep))
    assert low - 1e-9 <= centre <= high + 1e-9
    assert high - low < 1.0


@pytest.mark.parametrize("centre", [10.2, 9.8])
def test_an_unsaturated_rim_tells_the_place(centre: float) -> None:
    """The third beam off the middle overlaps by 0.1 only."""
    sweep = _sweep(centre + np.sign(centre - 10.0) * 0.6)
    low, high = _bounds(sweep, *_bright(sweep))
    assert high - low < 1e-9
    assert low == pytest.approx(centre + np.sign(centre - 10.0) * 0.6)


@pytest.mark.parametrize("unknown_m", [np.nan, -np.inf, 2.0])
def test_what_hides_the_next_beam_opens_the_bound(unknown_m: float) -> None:
    sweep = _sweep(10.0)
    first, last = _bright(sweep)
    ranges_m = sweep.ranges_m.copy()
    ranges_m[first - 1] = unknown_m
    low, high = _bounds(sweep, first, last)
    wider_low, wider_high = _bounds(Sweep(ranges_m, sweep.brightness), first, last)
    assert wider_low <= low
    assert wider_high >= high
    assert wider_low - 1e-9 <= 10.0 <= wider_high + 1e-9


def test_a_post_at_the_end_of_the_field_has_one_edge() -> None:
    sweep = _sweep(1.0)
    low, high = _bounds(sweep, *_bright(sweep))
    assert low - 1e-9 <= 1.0 <= high + 1e-9


def test_edges_that_contradict_each_other_cross() -> None:
    """Eight beams wide, where five is the most that a post can be."""
    ranges_m = np.full(21, 12.0)
    ranges_m[5:13] = 5.0
    low, high = _bounds(Sweep(ranges_m, np.where(ranges_m < 6.0, 1.0, 0.0)), 5, 12)
    assert low > high


def _posts_errors(resolution: Resolution, **settings: float) -> tuple[FloatArray, FloatArray]:
    """Bearing errors and their sigmas of posts of 6 cm at 2 to 14 m."""
    device = Lms151(resolution)
    detector = ReflectorDetector(ReflectorSettings(**settings))
    errors, sigmas = [], []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        bearing, distance_m = rng.uniform(-2.0, 2.0), rng.uniform(2.0, 14.0)
        position = distance_m * np.array([[np.cos(bearing), np.sin(bearing)]])
        world = World.of(Thing.REFLECTOR, position, np.array([0.06]), rng)
        found = detector.detect(device.scan(world, Pose2(), rng))
        if len(found) == 1:
            errors.append(wrap_angle(float(found.bearings[0]) - bearing))
            sigmas.append(np.sqrt(found.covariances[0, 1, 1]))
    assert len(errors) > 110
    return np.array(errors), np.array(sigmas)


@pytest.mark.parametrize("resolution", Resolution)
def test_edges_beat_the_mean_and_their_covariance_is_honest(resolution: Resolution) -> None:
    by_mean, _ = _posts_errors(resolution)
    by_edges, sigmas = _posts_errors(resolution, post_width_m=0.06)
    assert np.sqrt(np.mean(by_edges**2)) < 0.75 * np.sqrt(np.mean(by_mean**2))
    assert 0.2 < np.mean((by_edges / sigmas) ** 2) < 1.5


@pytest.mark.parametrize(
    "wrong", [{"post_width_m": 0.07}, {"beam_divergence": 0.014}, {"saturation_share": 0.16}]
)
def test_settings_that_are_a_little_wrong_do_no_harm(wrong: dict[str, float]) -> None:
    by_mean, _ = _posts_errors(Resolution.HALF_DEGREE)
    by_edges, sigmas = _posts_errors(Resolution.HALF_DEGREE, **({"post_width_m": 0.06} | wrong))
    assert np.sqrt(np.mean(by_edges**2)) < np.sqrt(np.mean(by_mean**2))
    assert np.mean((by_edges / sigmas) ** 2) < 5.0


def test_a_laser_that_turns_the_other_way_sees_the_mirrored_post() -> None:
    world = World.of(
        Thing.REFLECTOR, np.array([[5.0, 0.7]]), np.array([0.06]), np.random.default_rng(0)
    )
    scan = Lms151().scan(world, Pose2(), np.random.default_rng(1))
    geometry = ScannerGeometry(0.75 * np.pi, -np.radians(0.5), 0.1, 50.0)
    mirrored = LaserScan(0, geometry, scan.ranges_m, scan.intensities)
    detector = ReflectorDetector(ReflectorSettings(post_width_m=0.06))
    here, there = detector.detect(scan), detector.detect(mirrored)
    np.testing.assert_allclose(there.bearings, -here.bearings, atol=1e-12)
    np.testing.assert_allclose(there.covariances, here.covariances)


@pytest.mark.parametrize("seed", range(100))
def test_hostile_scans_give_valid_perceptions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    odd = np.array([np.nan, np.inf, -np.inf, 0.0, 1.2, 5.0, 5.05, 5.2, 29.0])
    geometry = ScannerGeometry(-1.0, 0.02, 0.1, 30.0)
    scan = LaserScan(3, geometry, rng.choice(odd, 90), rng.choice([0.0, 201.0, 254.0, 1e300], 90))
    found = ReflectorDetector(ReflectorSettings(post_width_m=0.06)).detect(scan)
    assert (np.abs(found.bearings) < 1.2).all()
