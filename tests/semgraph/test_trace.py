"""What is kept of a run is bounded, small, and where it was."""

import numpy as np
import pytest

from semgraph.fast_estimator import FastEstimator, FastSettings, FastStep
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from semgraph.trace import Trace
from sensors.measurements import (
    CameraGeometry,
    CameraImage,
    DepthImage,
    LaserScan,
    Mounting,
    PointCloud,
    Raw,
    ScannerGeometry,
    Tilt,
)
from sensors.points import base_t_points

CAMERA = CameraGeometry(64, 48, 50.0, (31.5, 23.5), Mounting(0.3, 0.1, 1.2, pitch=0.2, yaw=0.4))
GEOMETRY = ScannerGeometry(-1.0, 0.1, 0.1, 50.0, Pose2(1.0, 0.5, 0.3))


def seen(stamp_ns: int, base_t_things: np.ndarray) -> Perceptions:
    x, y = base_t_things.T
    sigmas = np.full(len(x), 0.05)
    return Perceptions.from_arrays(
        stamp_ns, Kind.TREE, np.hypot(x, y), np.arctan2(y, x), polar_covariances(sigmas, sigmas)
    )


def scan(stamp_ns: int) -> LaserScan:
    return LaserScan(stamp_ns, GEOMETRY, np.linspace(3.0, 5.0, 21))


def image(stamp_ns: int) -> CameraImage:
    grey = np.arange(64 * 48).reshape(48, 64).astype(np.uint8)
    return CameraImage(stamp_ns, CAMERA, grey, Tilt(0.02, 0.03))


class Drive:
    """Goes straight among four trees, 0.1 m a step, and tells a trace."""

    def __init__(self, trace: Trace) -> None:
        self.trace = trace
        self.fast = FastEstimator(FastSettings(), Pose2())
        self.things = np.array([[5.0, 3.0], [8.0, -4.0], [12.0, 3.5], [15.0, -3.0]])
        self.x = 0.0

    def step(self, *measurements: Raw) -> FastStep:
        stamp_ns = round(1e9 * self.x)
        perceptions = seen(stamp_ns, self.things - (self.x, 0.0))
        step = self.fast.step(perceptions, None)
        odom = Pose2(self.x, 0.0, 0.0)
        self.trace.add(measurements, perceptions, odom, step, self.fast.navigation_map)
        self.x += 0.1
        return step


def test_matched_landmarks_are_where_they_lie_from_the_fast_pose() -> None:
    drive = Drive(Trace())
    steps = [drive.step(scan(0)) for _ in range(10)]
    last = drive.trace.instants[-1]
    assert len(drive.trace.instants) == 10
    assert last.landmark_ids.tolist() == steps[-1].landmark_ids.tolist()
    matched = last.landmark_ids >= 0
    assert matched.any()
    apart_m = last.base_t_matched[matched] - last.perceptions.base_t_landmarks()[matched]
    assert np.abs(apart_m).max() < 0.1
    assert np.isnan(last.base_t_matched[~matched]).all()
    assert last.odom_T_base == Pose2(drive.x - 0.1, 0.0, 0.0)


def test_sensors_that_take_turns_are_both_kept_and_thinning_is_said() -> None:
    drive = Drive(Trace(capacity=6))
    for _ in range(20):
        drive.step(scan(0))
        drive.step(image(0))
    counts = {"laser": 0, "camera": 0}
    for instant in drive.trace.instants:
        counts[instant.shots[0].sensor] += 1
    assert counts == {"laser": 5, "camera": 5}
    stamps = [instant.stamp_ns for instant in drive.trace.instants]
    assert stamps == sorted(stamps)
    assert drive.trace.events == (
        "shown in Rerun: one of 4 moments of laser, 5 of 20",
        "shown in Rerun: one of 4 moments of camera, 5 of 20",
    )


def test_whole_runs_say_nothing() -> None:
    drive = Drive(Trace(capacity=6))
    for _ in range(6):
        drive.step()
    assert len(drive.trace.instants) == 6
    assert drive.trace.instants[0].shots == ()
    assert drive.trace.events == ()


def test_mountings_of_one_class_have_names_of_their_own() -> None:
    drive = Drive(Trace())
    cloud = PointCloud(0, Mounting(), np.eye(3), np.zeros(3, dtype=int))
    other = PointCloud(0, Mounting(x_m=1.0), np.eye(3), np.zeros(3, dtype=int))
    drive.step(cloud, other, scan(0))
    drive.step(other)
    names = [[shot.sensor for shot in instant.shots] for instant in drive.trace.instants]
    assert names == [["lidar", "lidar_2", "laser"], ["lidar_2"]]


def test_points_are_those_of_the_measurement_and_few() -> None:
    rng = np.random.default_rng(0)
    many = PointCloud(
        0,
        Mounting(0.3, 0.1, 1.2, pitch=0.2),
        rng.uniform(-20.0, 20.0, (70_000, 3)),
        np.zeros(70_000, dtype=int),
        Tilt(0.1, 0.05),
    )
    drive = Drive(Trace())
    drive.step(many)
    drive.step(scan(0))
    cloud, flat = (instant.shots[0] for instant in drive.trace.instants)
    assert len(cloud.base_t_points) <= 20_000
    np.testing.assert_allclose(cloud.base_t_points, base_t_points(many)[::4], atol=1e-5)
    np.testing.assert_allclose(flat.base_t_points, base_t_points(scan(0)), atol=1e-5)
    np.testing.assert_allclose(flat.base_t_sensor, [1.0, 0.5, 0.0])
    np.testing.assert_allclose(flat.base_R_sensor[:2, 0], [np.cos(0.3), np.sin(0.3)])


def test_depths_are_in_mm_and_back_where_the_points_are() -> None:
    depths_m = np.full((48, 64), 4.0)
    depths_m[10, 20] = 7.5
    depths_m[0, 0], depths_m[0, 2] = np.nan, np.inf
    depths_m[0, 4] = 100.0
    measured = DepthImage(0, CAMERA, depths_m, Tilt(0.1, 0.05))
    drive = Drive(Trace())
    drive.step(measured)
    (shot,) = drive.trace.instants[0].shots
    assert shot.picture is not None
    assert shot.picture.pixels.shape == (24, 32)
    assert shot.picture.pixels[5, 10] == 7500
    assert shot.picture.pixels[0, :3].tolist() == [0, 0, 65535]
    u, v = shot.picture.centre_px
    slopes = np.array([u - 10, v - 5]) / shot.picture.focal_px
    point = shot.base_R_sensor @ (7.5 * np.array([1.0, *slopes])) + shot.base_t_sensor
    distances = np.linalg.norm(base_t_points(measured) - point, axis=1)
    assert np.nanmin(distances) == pytest.approx(0.0, abs=1e-9)


def test_a_grey_image_keeps_its_grey() -> None:
    drive = Drive(Trace())
    drive.step(image(0))
    (shot,) = drive.trace.instants[0].shots
    assert shot.picture is not None
    np.testing.assert_array_equal(shot.picture.pixels, image(0).grey[::2, ::2])
    assert len(shot.base_t_points) == 0
