"""Detections of every class of measurement are drawn, inside the picture and where they are."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from evaluation.figures import draw_detections
from semgraph.errors import SemgraphError
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import (
    CameraGeometry,
    CameraImage,
    DepthImage,
    LaserScan,
    Mounting,
    PointCloud,
    Raw,
    ScannerGeometry,
)

CAMERA = CameraGeometry(64, 48, 50.0, (31.5, 23.5), Mounting(height_m=1.0, pitch=0.3))
SCAN = LaserScan(0, ScannerGeometry(-1.0, 0.1, 0.1, 50.0), np.full(21, 4.0))
MEASUREMENTS: dict[str, Raw] = {
    "scan": SCAN,
    "empty scan": LaserScan(0, SCAN.geometry, np.full(21, np.inf)),
    "cloud": PointCloud(0, Mounting(), np.eye(3), np.zeros(3, dtype=int)),
    "empty cloud": PointCloud(0, Mounting(), np.zeros((0, 3)), np.zeros(0, dtype=int)),
    "depths": DepthImage(0, CAMERA, np.full((48, 64), 3.0)),
    "no depths": DepthImage(0, CAMERA, np.full((48, 64), np.nan)),
    "grey": CameraImage(0, CAMERA, np.full((48, 64), 90, dtype=np.uint8)),
}
FOUND = Perceptions(
    0,
    np.array([Kind.TREE, Kind.ROCK, Kind.MARKER, Kind.MARKER]),
    np.array([3.0, 2.0, 4.0, 5.0]),
    np.array([0.1, -0.2, 0.3, 3.0]),
    np.broadcast_to(0.001 * np.eye(2), (4, 2, 2)),
    np.array([0.3, 0.5, np.nan, np.nan]),
    np.array([0.02, 0.1, np.nan, np.nan]),
    np.array(["", "", "17", "$\\x$"]),
    np.ones(4),
    np.zeros(4),
)


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_every_class_is_drawn_with_and_without_perceptions(tmp_path: Path, name: str) -> None:
    pictures = []
    for found in (FOUND, FOUND.select(np.zeros(0, dtype=int))):
        path = tmp_path / "detections.png"
        draw_detections("one $x$", [(MEASUREMENTS[name], found)], path)
        pictures.append(imread(path))
    height, width, _ = pictures[0].shape
    assert height > 700
    assert width > 1000
    assert np.abs(pictures[0] - pictures[1]).max() > 0.3


def test_many_and_none_are_drawn(tmp_path: Path) -> None:
    path = tmp_path / "detections.png"
    draw_detections("all", [(each, FOUND) for each in MEASUREMENTS.values()], path)
    many = imread(path).shape
    draw_detections("none", [], path)
    assert many[0] > 2 * imread(path).shape[0]


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(SemgraphError, match="cannot be written"):
        draw_detections("one", [(SCAN, FOUND)], tmp_path / "nowhere" / "detections.png")
