"""Points of measurements lie where the simulators put them, and where cameras see them."""

import numpy as np
import pytest

from semgraph.geometry import Pose2
from sensors.measurements import (
    CameraGeometry,
    CameraImage,
    DepthImage,
    LaserScan,
    Mounting,
    PointCloud,
    ScannerGeometry,
    Tilt,
)
from sensors.points import base_t_points, pixels
from sensors.simulation.marker_camera import MarkerCamera

MOUNTING = Mounting(0.3, 0.1, 1.2, roll=0.02, pitch=0.3, yaw=0.4)
TILT = Tilt(0.05, -0.04)
CAMERA = CameraGeometry(64, 48, 50.0, (31.5, 23.5), MOUNTING)


def test_a_scan_lies_in_the_plane_of_base() -> None:
    geometry = ScannerGeometry(0.0, np.pi / 4, 0.1, 50.0, Pose2(1.0, 0.0, np.pi / 2))
    scan = LaserScan(0, geometry, np.array([2.0, np.inf, 3.0, np.nan, -np.inf]))
    np.testing.assert_allclose(base_t_points(scan), [[1.0, 2.0, 0.0], [-2.0, 0.0, 0.0]], atol=1e-12)


def test_a_cloud_is_levelled() -> None:
    """Seen straight down from 1 m, with base leaning on its nose by 0.1."""
    mounting = Mounting(height_m=1.0, pitch=np.pi / 2 - 0.1)
    cloud = PointCloud(0, mounting, np.array([[0.4, 0.0, 0.7]]), np.array([0]), Tilt(pitch=0.1))
    offset = np.array([np.sin(0.1), 0.0, np.cos(0.1)])
    expected = offset + np.array([0.7, 0.0, -0.4])
    np.testing.assert_allclose(base_t_points(cloud), [expected], atol=1e-12)


@pytest.mark.parametrize("stride", [1, 3])
def test_depths_and_pixels_undo_each_other(stride: int) -> None:
    rng = np.random.default_rng(0)
    depths_m = rng.uniform(1.0, 9.0, (48, 64))
    depths_m[rng.random((48, 64)) < 0.2] = np.nan
    points = base_t_points(DepthImage(0, CAMERA, depths_m, TILT), stride)
    rows, columns = np.nonzero(np.isfinite(depths_m[::stride, ::stride]))
    at_px, ahead_m = pixels(CAMERA, TILT, points)
    np.testing.assert_allclose(at_px, stride * np.column_stack([columns, rows]), atol=1e-9)
    np.testing.assert_allclose(ahead_m, depths_m[::stride, ::stride][rows, columns])


def test_pixels_are_where_the_simulated_camera_has_them() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack(
        [rng.uniform(3.0, 9.0, 50), rng.uniform(-1.0, 4.0, 50), rng.random(50)]
    )
    expected_px, depths_m = MarkerCamera(CAMERA).project(points[None], Pose2(), TILT)
    at_px, ahead_m = pixels(CAMERA, TILT, points)
    np.testing.assert_allclose(at_px, expected_px[0], atol=1e-9)
    np.testing.assert_allclose(ahead_m, depths_m[0], atol=1e-9)


def test_what_is_behind_has_no_pixel() -> None:
    at_px, ahead_m = pixels(CAMERA, TILT, np.array([[-5.0, 0.0, 0.0]]))
    assert np.isnan(at_px).all()
    assert np.isnan(ahead_m).all()


def test_a_camera_image_has_no_points() -> None:
    image = CameraImage(0, CAMERA, np.zeros((48, 64), dtype=np.uint8))
    assert base_t_points(image).shape == (0, 3)
