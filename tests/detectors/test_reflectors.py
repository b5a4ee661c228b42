"""Reflectors: grouping, geometry, covariance, and the surveyed beacons of the car park."""

from pathlib import Path

import numpy as np
import pytest

from detectors.reflectors import ReflectorDetector, ReflectorSettings
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.landmarks import Kind
from sensors.measurements import LaserScan, ScannerGeometry

HALF_DEGREE = np.radians(0.5)
GEOMETRY = ScannerGeometry(-np.pi / 2, HALF_DEGREE, 0.1, 80.0)


def _scan(hits: dict[int, tuple[float, float]]) -> LaserScan:
    """A 361-beam scan of {beam: (range, intensity)}."""
    ranges_m, intensities = np.full(361, np.inf), np.zeros(361)
    for beam, (range_m, intensity) in hits.items():
        ranges_m[beam], intensities[beam] = range_m, intensity
    return LaserScan(5, GEOMETRY, ranges_m, intensities)


def _detector(**settings: float) -> ReflectorDetector:
    return ReflectorDetector(ReflectorSettings.model_validate(settings))


def test_the_brighter_beam_pulls_the_bearing() -> None:
    scan = _scan({180: (5.0, 8192.0), 181: (5.0, 24576.0)})
    perceptions = _detector().detect(scan)
    assert perceptions.kinds.tolist() == [Kind.MARKER]
    np.testing.assert_allclose(perceptions.bearings, 0.75 * HALF_DEGREE)
    np.testing.assert_allclose(perceptions.ranges_m, 5.0)


def test_the_centre_lies_behind_the_surface() -> None:
    perceptions = _detector(centre_offset_m=0.03).detect(_scan({90: (4.0, 8192.0)}))
    np.testing.assert_allclose(perceptions.ranges_m, 4.03)
    np.testing.assert_allclose(perceptions.bearings, -np.pi / 4)


@pytest.mark.parametrize(
    ("hits", "expected"),
    [
        ({10: (5.0, 9e3), 12: (5.0, 9e3)}, [5.0]),
        ({10: (5.0, 9e3), 13: (5.0, 9e3)}, [5.0, 5.0]),
        ({10: (5.0, 9e3), 11: (5.6, 9e3)}, [5.0, 5.6]),
        ({10: (0.9, 9e3)}, []),
        ({10: (31.0, 9e3)}, []),
        ({10: (5.0, 150.0)}, []),
        (dict.fromkeys(range(10, 20), (5.0, 9e3)), []),
        ({10: (2.4, 9e3), 13: (2.4, 9e3)}, [2.4]),
        ({10: (2.4, 9e3), 15: (2.4, 9e3)}, [2.4, 2.4]),
    ],
    ids=["one gap", "two gaps", "step", "near", "far", "dim", "wide", "both edges", "near two"],
)
def test_grouping(hits: dict[int, tuple[float, float]], expected: list[float]) -> None:
    np.testing.assert_allclose(_detector().detect(_scan(hits)).ranges_m, expected)


def test_a_single_hit_is_trusted_less() -> None:
    perceptions = _detector().detect(_scan({10: (5.0, 9e3), 100: (5.0, 9e3), 101: (5.0, 9e3)}))
    assert perceptions.reliabilities[0] < perceptions.reliabilities[1]


def test_a_scan_without_intensities_is_refused() -> None:
    with pytest.raises(InputError, match="expected a scan with intensities"):
        _detector().detect(LaserScan(5, GEOMETRY, np.full(361, 5.0)))


def test_covariance_is_honest() -> None:
    """NEES of range and bearing; one or two of a post's lit beams are bright, as really."""
    rng = np.random.default_rng(11)
    beams = GEOMETRY.angle_min + HALF_DEGREE * np.arange(361)
    settings = ReflectorSettings()
    errors = []
    for _ in range(400):
        range_m, bearing = rng.uniform(2.0, 14.0), rng.uniform(-1.4, 1.4)
        half_face = 0.5 * (settings.beam_exit_m + settings.beam_divergence * range_m) + 0.03
        lit = np.flatnonzero(np.abs(beams - bearing) < half_face / range_m)
        first = int(rng.integers(lit[0], lit[-1] + 1))
        intensities = np.zeros(361)
        intensities[first : min(first + int(rng.integers(1, 3)), lit[-1] + 1)] = 9e3
        measured_m = range_m + rng.normal(0.0, 0.015) + rng.normal(0.0, 0.007, 361)
        scan = LaserScan(5, GEOMETRY, measured_m, intensities)
        perceptions = ReflectorDetector(settings).detect(scan)
        assert len(perceptions) == 1
        error = np.array([perceptions.ranges_m[0] - range_m, perceptions.bearings[0] - bearing])
        errors.append(error @ np.linalg.solve(perceptions.covariances[0], error))
    assert 1.0 < np.mean(errors) < 3.0


@pytest.mark.shared_data
def test_markers_agree_with_the_surveyed_beacons_of_the_car_park(shared_data: Path) -> None:
    """Scans of three markers or more, at the GPS position; a turn alone is fitted to each."""
    from scipy.io import loadmat

    recorded = loadmat(shared_data / "car_park" / "data_set.mat")
    beacons = loadmat(shared_data / "car_park" / "beac_juan3.mat")["estbeac"]
    stamps, gps_stamps, x, y = (
        recorded[name].ravel() for name in ("TimeLaser", "TimeGPS", "GPSLon", "GPSLat")
    )
    laser_t_markers = [
        _detector().detect(_car_park_scan(ranges_m, intensities)).base_t_landmarks()
        for ranges_m, intensities in zip(recorded["Laser"], recorded["Intensity"], strict=True)
    ]
    errors_m = [
        _error_at_best_heading(
            markers, beacons - [np.interp(stamp, gps_stamps, x), np.interp(stamp, gps_stamps, y)]
        )
        for stamp, markers in zip(stamps, laser_t_markers, strict=True)
        if len(markers) >= 3
    ]
    assert len(errors_m) > 40
    assert np.median(errors_m) < 0.06
    assert np.percentile(errors_m, 90) < 0.12


def _error_at_best_heading(laser_t_markers: FloatArray, laser_t_beacons: FloatArray) -> float:
    """RMS distance of the markers to the beacons, m per axis."""
    headings = np.radians(np.arange(-180.0, 180.0, 0.5))
    return min(
        float(np.sqrt((_residuals(laser_t_markers, laser_t_beacons, heading) ** 2).mean()))
        for heading in headings
    )


def _car_park_scan(ranges_m: FloatArray, intensities: FloatArray) -> LaserScan:
    return LaserScan(0, GEOMETRY, np.where(ranges_m > 80.0, np.inf, ranges_m), intensities)


def _residuals(
    laser_t_markers: FloatArray, laser_t_beacons: FloatArray, heading: float
) -> FloatArray:
    """(n, 2) from each marker, turned by `heading`, to the nearest beacon."""
    c, s = np.cos(heading), np.sin(heading)
    turned = laser_t_markers @ np.array([[c, s], [-s, c]])
    differences = turned[:, None] - laser_t_beacons[None]
    nearest = np.linalg.norm(differences, axis=2).argmin(axis=1)
    chosen: FloatArray = differences[np.arange(len(turned)), nearest]
    return chosen
