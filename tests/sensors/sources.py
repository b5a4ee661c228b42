"""What tests of readers ask of any source."""

import math
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2
from semgraph.landmarks import Perceptions
from sensors.catalog import open_source
from sensors.measurements import LaserScan, Measurement, Raw, Recording, WheelOdometry
from sensors.truth import Source


def same(a: object, b: object) -> bool:
    """Whether two values are equal field by field, NaN equal to NaN."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype.kind == b.dtype.kind and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if is_dataclass(a) and is_dataclass(b) and not isinstance(a, Pose2):
        return type(a) is type(b) and all(
            same(getattr(a, field.name), getattr(b, field.name)) for field in fields(a)
        )
    if isinstance(a, (tuple, list)) and isinstance(b, (tuple, list)):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return a == b


@cache
def opened(place: str) -> Source:
    """A source with its default options, read once for all tests."""
    return open_source(place, {})


def perceptions_of(recording: Recording) -> list[Perceptions]:
    return [m for m in recording.measurements if isinstance(m, Perceptions)]


def scans_of(recording: Recording) -> list[Raw | Perceptions]:
    return [m for m in recording.measurements if isinstance(m, Raw | Perceptions)]


def odometry_of(recording: Recording) -> list[WheelOdometry]:
    return [m for m in recording.measurements if isinstance(m, WheelOdometry)]


def check_recording(recording: Recording) -> None:
    """The promises of `Recording`, on every measurement."""
    measurements = tuple(recording.measurements)
    assert same(measurements, tuple(recording.measurements))
    assert len(scans_of(recording)) == recording.num_scans > 0
    stamps = [m.stamp_ns for m in measurements]
    assert stamps == sorted(stamps)
    assert (recording.odometry_noise is None) == (not odometry_of(recording))
    check_odometry_before_scans(measurements)
    for measurement in measurements:
        check_measurement(measurement)


def check_odometry_before_scans(measurements: tuple[Measurement, ...]) -> None:
    """Within its span, every scan has odometry of its own time, just before."""
    stamps = [m.stamp_ns for m in measurements if isinstance(m, WheelOdometry)]
    known: set[int] = set()
    for m in measurements:
        if isinstance(m, WheelOdometry):
            known.add(m.stamp_ns)
        elif isinstance(m, Raw | Perceptions) and stamps:
            outside = not stamps[0] <= m.stamp_ns <= stamps[-1]
            assert outside or m.stamp_ns in known


def check_measurement(measurement: Measurement) -> None:
    if isinstance(measurement, LaserScan):
        finite = measurement.ranges_m[np.isfinite(measurement.ranges_m)]
        assert (finite >= 0.0).all()
    elif isinstance(measurement, Perceptions):
        assert (measurement.ranges_m > 0.0).all()
        assert np.isfinite(measurement.covariances).all()
    elif isinstance(measurement, WheelOdometry):
        assert math.isfinite(measurement.odom_T_base.x + measurement.odom_T_base.theta)


def start_aligned(points: np.ndarray, reference: np.ndarray, num_rows: int) -> np.ndarray:
    """(n, 2) points moved rigidly such that the first rows fit the reference."""
    a, b = points[:num_rows], reference[:num_rows]
    cross = (a - a.mean(axis=0)).T @ (b - b.mean(axis=0))
    theta = math.atan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1])
    turn = Pose2(0.0, 0.0, theta)
    moved: FloatArray = turn.transform(points) - turn.transform(a).mean(axis=0) + b.mean(axis=0)
    return moved


def write_text(folder: Path, name: str, text: str) -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file
