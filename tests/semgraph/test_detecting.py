"""Detecting without estimating: what is written is what was found, counts and shown ones agree."""

from pathlib import Path

import numpy as np
import pytest

from semgraph.detecting import Effort, Efforts, write_detections
from semgraph.errors import InputError, SemgraphError
from semgraph.landmarks import Kind, Perceptions
from semgraph.perceiving import Perceiver
from semgraph.progress import Silence
from semgraph.settings import load_settings
from sensors import plain_folder
from sensors.measurements import (
    CameraGeometry,
    CameraImage,
    LaserScan,
    Measurement,
    Recording,
    ScannerGeometry,
)
from sensors.plain_perceptions import PERCEPTIONS_FILE

GEOMETRY = ScannerGeometry(-1.0, 0.01, 0.1, 50.0)
CAMERA = CameraGeometry(64, 48, 50.0, (31.5, 23.5))
DETECTORS = {"reflectors": {}, "optical-markers": {"edge_m": 0.2}}


def scan(stamp_ns: int) -> LaserScan:
    """One bright post ahead, in every second scan another to the left."""
    ranges_m, intensities = np.full(201, np.inf), np.zeros(201)
    for beams, range_m in [(slice(99, 102), 5.0), (slice(180, 183), 12.0)][: 1 + stamp_ns % 2]:
        ranges_m[beams], intensities[beams] = range_m, 1000.0
    return LaserScan(stamp_ns, GEOMETRY, ranges_m, intensities)


def recording(*measurements: Measurement) -> Recording:
    return Recording("posts", measurements, len(measurements), detectors=DETECTORS)


def detect(
    source: Recording, file: Path, num_shown: int = 6
) -> tuple[list[Effort], list[tuple[object, Perceptions]]]:
    efforts = Efforts()
    perceiver = Perceiver(source, load_settings(None, []), observe=efforts)
    seen = write_detections(source, perceiver, file, Silence(), num_shown)
    return efforts.table(), list(seen)


def test_what_is_written_is_a_plain_folders_table(tmp_path: Path) -> None:
    detect(recording(*(scan(k) for k in range(10))), tmp_path / PERCEPTIONS_FILE)
    (tmp_path / "recording.toml").write_text('name = "again"\n')
    again = plain_folder.read(tmp_path, plain_folder.PlainOptions()).recording
    sets = [each for each in again.measurements if isinstance(each, Perceptions)]
    assert [each.stamp_ns for each in sets] == list(range(10))
    assert [len(each) for each in sets] == [1, 2] * 5
    assert {Kind(kind) for each in sets for kind in each.kinds} == {Kind.MARKER}


def test_counts_and_times_of_each_detector(tmp_path: Path) -> None:
    image = CameraImage(99, CAMERA, np.zeros((48, 64), dtype=np.uint8))
    table, _ = detect(recording(*(scan(k) for k in range(10)), image), tmp_path / "out.csv")
    by_name = {each.detector: each for each in table}
    posts, tags = by_name["reflectors"], by_name["optical-markers"]
    assert (posts.num_measurements, posts.num_perceptions) == (10, 15)
    assert (tags.num_measurements, tags.num_perceptions) == (1, 0)
    assert posts.mean_perceptions == 1.5
    assert 0.0 < posts.median_ms <= posts.p99_ms


def test_what_is_shown_is_spread_over_time_and_classes(tmp_path: Path) -> None:
    image = CameraImage(150, CAMERA, np.zeros((48, 64), dtype=np.uint8))
    measurements: list[Measurement] = [
        *(scan(k) for k in range(150)),
        image,
        *(scan(k) for k in range(151, 300)),
    ]
    _, seen = detect(recording(*measurements), tmp_path / "out.csv")
    stamps = [each.stamp_ns for _, each in seen]
    assert stamps == sorted(stamps)
    scans = [each.stamp_ns for measurement, each in seen if isinstance(measurement, LaserScan)]
    assert len(stamps) - len(scans) == 1
    assert len(scans) == 3
    assert scans[0] == 0
    assert scans[-1] > 250


def test_ready_perceptions_are_no_measurements(tmp_path: Path) -> None:
    found = Perceptions.from_arrays(
        0, Kind.TREE, np.array([1.0]), np.array([0.0]), 0.01 * np.eye(2)[None]
    )
    with pytest.raises(InputError, match="come ready"):
        detect(recording(found), tmp_path / "out.csv")
    table, _ = detect(recording(found, scan(1)), tmp_path / "out.csv")
    assert [each.num_measurements for each in table] == [1]


def test_a_file_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    with pytest.raises(SemgraphError, match="cannot be written"):
        detect(recording(scan(0)), tmp_path / "nowhere" / "out.csv")
