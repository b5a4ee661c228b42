"""Deskewing undoes the simulated motion, and agrees with poses composed one by one."""

import numpy as np
import pytest

from detectors.tree_settings import TreeSettings
from detectors.trees_2d import TreeDetector
from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.filters.context import ScanContext
from sensors.filters.deskewing import DeskewSettings, deskew, deskew_perceptions
from sensors.filters.resampling import beam_bearings
from sensors.measurements import LaserScan, ScannerGeometry
from sensors.simulation.lms151 import Lms151, Motion, Resolution
from sensors.simulation.world import stand_of_trees
from tests.sensors.filters.scans import INCREMENT, boles, rms_range_error_m, scan_of


@pytest.mark.parametrize("resolution", list(Resolution))
@pytest.mark.parametrize("motion", [Motion(1.0, 0.0, 0.5), Motion(3.0, 0.5, -1.0)])
def test_it_undoes_the_motion_of_the_simulation(resolution: Resolution, motion: Motion) -> None:
    device = Lms151(resolution, range_sigma_m=0.0, dropout=0.0)
    settings = DeskewSettings(sweep_s=0.75 / resolution.frequency_hz)
    context = ScanContext(twist=(motion.forward, motion.left, motion.yaw_rate))
    before_m, after_m = [], []
    for seed in range(101, 107):
        world = boles(seed)
        static = device.scan(world, Pose2(), np.random.default_rng(0))
        skewed = device.scan(world, Pose2(), np.random.default_rng(0), motion=motion)
        before_m.append(rms_range_error_m(skewed, static))
        after_m.append(rms_range_error_m(deskew(skewed, settings, context), static))
    assert np.mean(before_m) > 0.010
    assert np.mean(after_m) < 0.006
    assert np.mean(after_m) < 0.35 * np.mean(before_m)


def test_driving_alone_shifts_ranges_by_the_way_driven() -> None:
    device = Lms151(Resolution.QUARTER_DEGREE, range_sigma_m=0.0, dropout=0.0)
    world = boles(101)
    static = device.scan(world, Pose2(), np.random.default_rng(0))
    skewed = device.scan(world, Pose2(), np.random.default_rng(0), motion=Motion(2.0))
    straight = deskew(skewed, DeskewSettings(sweep_s=0.03), ScanContext(twist=(2.0, 0.0, 0.0)))
    assert straight.geometry == skewed.geometry
    assert rms_range_error_m(straight, static) < 0.4 * rms_range_error_m(skewed, static)


MOUNTINGS = [Pose2(), Pose2(0.8, -0.3, 0.4)]


@pytest.mark.parametrize("base_T_laser", MOUNTINGS)
@pytest.mark.parametrize("increment", [INCREMENT, -INCREMENT])
@pytest.mark.parametrize("stamp_position", [0.0, 0.5, 1.0])
def test_each_point_is_carried_to_the_stamp(
    base_T_laser: Pose2, increment: float, stamp_position: float
) -> None:
    """A wall far away, so that resampling interpolates: against poses composed beam by beam."""
    geometry = ScannerGeometry(-np.sign(increment) * 0.6, increment, 0.1, 90.0, base_T_laser)
    bearings = geometry.angle_min + increment * np.arange(138)
    scan = scan_of(6.0 / np.cos(bearings), geometry)
    settings = DeskewSettings(sweep_s=0.02, stamp_position=stamp_position)
    vx, vy, omega = twist = (2.0, -1.0, 0.8)
    points = []
    for beam in range(138):
        seconds = 0.02 * (beam / 137 - stamp_position)
        stamp_T_base = Pose2()
        for _ in range(100):
            step = seconds / 100
            stamp_T_base = stamp_T_base @ Pose2(vx * step, vy * step, omega * step)
        stamp_T_laser = base_T_laser.inverse() @ stamp_T_base @ base_T_laser
        range_m, bearing = scan.ranges_m[beam], bearings[beam]
        point = range_m * np.array([[np.cos(bearing), np.sin(bearing)]])
        points.append(stamp_T_laser.transform(point)[0])
    x, y = np.array(points).T
    deskewed = deskew(scan, settings, ScanContext(twist=twist))
    order = np.argsort(np.arctan2(y, x))
    expected = np.interp(beam_bearings(deskewed), np.arctan2(y, x)[order], np.hypot(x, y)[order])
    inner = slice(2, -2)
    np.testing.assert_allclose(deskewed.ranges_m[inner], expected[inner], atol=2e-3)
    assert np.abs(deskewed.ranges_m - scan.ranges_m)[inner].max() > 5e-3


def test_at_an_edge_no_range_between_two_things_appears() -> None:
    ranges_m = np.where(np.arange(541) % 40 < 20, 3.0, 9.0)
    moved = deskew(scan_of(ranges_m), DeskewSettings(), ScanContext(twist=(3.0, 1.0, 1.0)))
    from_front = np.abs(moved.ranges_m - 3.0) < 0.1
    from_behind = np.abs(moved.ranges_m - 9.0) < 0.1
    assert (from_front | from_behind).all()


def test_intensities_move_with_their_points() -> None:
    bare = scan_of(np.full(541, 0.3))
    moved = deskew(bare, DeskewSettings(), ScanContext(twist=(0.0, 4.0, 0.0)))
    assert moved.intensities is not None
    assert (np.diff(moved.intensities) >= 0.0).all()
    assert (moved.intensities != bare.intensities).any()
    assert isinstance(moved, LaserScan)


@pytest.mark.parametrize("resolution", list(Resolution))
@pytest.mark.parametrize("motion", [Motion(1.0, 0.0, 0.0), Motion(3.0, -0.5, 1.0)])
def test_perceptions_are_as_good_as_if_the_laser_had_stood(
    resolution: Resolution, motion: Motion
) -> None:
    """NEES of (range, bearing) of trunks within 8 m: standing, skewed, and moved to the stamp."""
    device, detector = Lms151(resolution), TreeDetector(TreeSettings())
    settings = DeskewSettings(sweep_s=0.75 / resolution.frequency_hz)
    context = ScanContext(twist=(motion.forward, motion.left, motion.yaw_rate))
    sums: dict[str, list[float]] = {"stood": [], "skewed": [], "moved": []}
    for seed in range(101, 111):
        world = stand_of_trees(np.random.default_rng(seed))
        static = device.scan(world, Pose2(), np.random.default_rng(0))
        scan = device.scan(world, Pose2(), np.random.default_rng(0), motion=motion)
        found = detector.detect(scan)
        moved = deskew_perceptions(found, scan, settings, context)
        parts = {"stood": detector.detect(static), "skewed": found, "moved": moved}
        for name, perceptions in parts.items():
            sums[name] += _nees(perceptions, world.world_t_things)
    means = {name: float(np.mean(nees)) for name, nees in sums.items()}
    assert means["moved"] < 1.25 * means["stood"]
    assert means["skewed"] > 1.2 * means["moved"]


def _nees(perceptions: Perceptions, laser_t_things: FloatArray) -> list[float]:
    sure = perceptions.select((perceptions.reliabilities > 0.7) & (perceptions.ranges_m < 8.0))
    apart = sure.base_t_landmarks()[:, None] - laser_t_things
    rows = np.linalg.norm(apart, axis=2).argmin(axis=1)
    errors = apart[np.arange(len(sure)), rows]
    right = np.linalg.norm(errors, axis=1) < 0.1
    inverse = np.linalg.inv(sure.base_covariances())
    nees = np.einsum("ni,nij,nj->n", errors, inverse, errors)[right]
    assert len(nees) > 3
    return [float(value) for value in nees]


@pytest.mark.parametrize("base_T_laser", MOUNTINGS)
@pytest.mark.parametrize("increment", [INCREMENT, -INCREMENT])
def test_a_perception_moves_as_a_point_of_its_beam_does(
    base_T_laser: Pose2, increment: float
) -> None:
    geometry = ScannerGeometry(-np.sign(increment) * 2.3, increment, 0.1, 90.0, base_T_laser)
    scan = scan_of(np.full(528, 6.0), geometry)
    beams = np.array([0, 100, 300, 527])
    bearings = beam_bearings(scan)[beams]
    perceptions = Perceptions.from_arrays(
        3, Kind.TREE, np.full(4, 6.0), bearings, polar_covariances(np.ones(4), np.ones(4))
    )
    settings = DeskewSettings(sweep_s=0.02, stamp_position=0.3)
    moved = deskew_perceptions(perceptions, scan, settings, ScanContext(twist=(2.0, -1.0, 0.8)))
    for k, beam in enumerate(beams):
        step = 0.02 * (beam / 527 - 0.3) / 200
        stamp_T_base = Pose2()
        for _ in range(200):
            stamp_T_base = stamp_T_base @ Pose2(2.0 * step, -1.0 * step, 0.8 * step)
        stamp_T_laser = base_T_laser.inverse() @ stamp_T_base @ base_T_laser
        point = stamp_T_laser.transform(perceptions.base_t_landmarks()[k : k + 1])[0]
        np.testing.assert_allclose(moved.base_t_landmarks()[k], point, atol=1e-5)
    np.testing.assert_array_equal(moved.covariances, perceptions.covariances)


def test_perceptions_without_a_twist_are_left_as_they_are() -> None:
    nothing = np.zeros(0)
    none = Perceptions.from_arrays(1, Kind.TREE, nothing, nothing, np.zeros((0, 2, 2)))
    scan = scan_of(np.full(3, 5.0))
    assert deskew_perceptions(none, scan, DeskewSettings(), ScanContext()) is none
    moving = ScanContext(twist=(1.0, 0.0, 0.0))
    assert len(deskew_perceptions(none, scan, DeskewSettings(), moving)) == 0
