"""Trees in simulated scans: where they stand, how thick, how sure."""

import numpy as np
import pytest

from detectors.footprint_calibration import calibrate_footprint
from detectors.tree_settings import TreeSettings
from detectors.trees_2d import TreeDetector
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2, wrap_angle
from semgraph.landmarks import Kind
from sensors.measurements import LaserScan, ScannerGeometry
from sensors.simulation.lms151 import Lms151, Resolution
from sensors.simulation.world import Thing, World, stand_of_trees

FINE = Resolution.QUARTER_DEGREE


def _stem(distance_m: float, bearing: float, diameter_m: float) -> World:
    position = np.array([[distance_m * np.cos(bearing), distance_m * np.sin(bearing)]])
    return World.of(Thing.STEM, position, np.array([diameter_m]), np.random.default_rng(1))


def _errors(resolution: Resolution, distance_m: float, diameter_m: float) -> FloatArray:
    """(n, 4): range, bearing, diameter error and NEES of a stem that stands alone, 60 times."""
    rng = np.random.default_rng(2)
    device, detector = Lms151(resolution), TreeDetector(TreeSettings())
    rows = []
    for bearing in rng.uniform(-2.0, 2.0, 60):
        found = detector.detect(device.scan(_stem(distance_m, bearing, diameter_m), Pose2(), rng))
        assert len(found) <= 1
        for k in range(len(found)):
            error = np.array(
                [found.ranges_m[k] - distance_m, wrap_angle(found.bearings[k] - bearing)]
            )
            wide = found.diameters_m[k] - diameter_m
            nees = error @ np.linalg.solve(found.covariances[k], error)
            rows.append([*error, wide, nees + (wide / found.diameter_sigmas_m[k]) ** 2])
    assert len(rows) >= 58
    return np.array(rows)


@pytest.mark.parametrize("resolution", list(Resolution))
@pytest.mark.parametrize("diameter_m", [0.2, 0.3, 0.5])
@pytest.mark.parametrize(("distance_m", "sigma_m"), [(3.0, 0.02), (8.0, 0.045), (13.0, 0.075)])
def test_a_lone_stem_is_measured(
    resolution: Resolution, diameter_m: float, distance_m: float, sigma_m: float
) -> None:
    errors = _errors(resolution, distance_m, diameter_m)
    rms = np.sqrt((errors**2).mean(axis=0))
    assert rms[2] < sigma_m
    assert rms[0] < sigma_m
    assert rms[1] * distance_m < sigma_m
    assert abs(errors[:, 2].mean()) < 0.6 * sigma_m
    assert 0.5 < errors[:, 3].mean() < 6.0


def test_a_forest_is_found_and_little_else() -> None:
    rng = np.random.default_rng(77)
    device, detector = Lms151(FINE), TreeDetector(TreeSettings())
    found = hits = true = 0
    for _ in range(6):
        world = stand_of_trees(rng)
        perceptions = detector.detect(device.scan(world, Pose2(), rng))
        perceptions = perceptions.select(
            (perceptions.reliabilities >= 0.7) & (perceptions.ranges_m < 15.0)
        )
        trees = world.world_t_things[world.things <= Thing.SAPLING]
        distances = np.linalg.norm(perceptions.base_t_landmarks()[:, None] - trees, axis=2)
        true += int((distances.min(axis=1) < 0.2).sum())
        found += len(perceptions)
        seen = device.echoes(world, Pose2(), rng).sources
        beams = np.bincount(seen[seen >= 0], minlength=len(world))
        near = np.linalg.norm(world.world_t_things, axis=1) < 15.0
        hits += int(((beams >= 8) & (world.things == Thing.STEM) & near).sum())
    assert true / found > 0.93
    assert true > 0.9 * hits


def test_a_single_beam_counts_in_the_open_but_not_before_others() -> None:
    geometry = ScannerGeometry(-0.5, np.radians(0.5), 0.1, 50.0)
    ranges_m = np.full(120, np.inf)
    ranges_m[60] = 25.0
    alone = TreeDetector(TreeSettings()).detect(LaserScan(0, geometry, ranges_m))
    assert len(alone) == 1
    ranges_m[[58, 59, 61, 62]] = 25.6
    assert len(TreeDetector(TreeSettings()).detect(LaserScan(0, geometry, ranges_m))) == 0


def test_a_wall_is_no_tree() -> None:
    geometry = ScannerGeometry(-1.0, np.radians(0.5), 0.1, 50.0)
    angles = -1.0 + np.radians(0.5) * np.arange(230)
    scan = LaserScan(0, geometry, 4.0 / np.cos(angles))
    assert len(TreeDetector(TreeSettings()).detect(scan)) == 0


def test_a_scanner_that_turns_clockwise_sees_the_same() -> None:
    scan = Lms151().scan(
        stand_of_trees(np.random.default_rng(3)), Pose2(), np.random.default_rng(4)
    )
    geometry = scan.geometry
    last = geometry.angle_min + 540 * geometry.angle_increment
    turned = ScannerGeometry(last, -geometry.angle_increment, 0.1, 50.0)
    detector = TreeDetector(TreeSettings())
    there = detector.detect(scan)
    here = detector.detect(LaserScan(0, turned, scan.ranges_m[::-1]))
    assert len(there) > 5
    np.testing.assert_allclose(here.bearings, there.bearings, atol=1e-9)
    np.testing.assert_array_equal(here.ranges_m, there.ranges_m)


def test_what_comes_out_is_a_tree_with_a_diameter() -> None:
    scan = Lms151(FINE).scan(_stem(4.0, 0.3, 0.3), Pose2(), np.random.default_rng(0))
    (tree,) = TreeDetector(TreeSettings()).detect(scan)
    assert tree.semantics.kind is Kind.TREE
    assert tree.semantics.diameter is not None
    assert abs(tree.semantics.diameter.mean_m - 0.3) < 4 * tree.semantics.diameter.sigma_m
    assert tree.reliability > 0.9


@pytest.mark.parametrize("divergence", [0.010, 0.020])
def test_the_footprint_is_found_from_scans_alone(divergence: float) -> None:
    rng = np.random.default_rng(12)
    device = Lms151(FINE, beam_divergence=divergence)
    scans = [device.scan(stand_of_trees(rng), Pose2(), rng) for _ in range(24)]
    calibrated = calibrate_footprint(scans, TreeSettings())
    assert calibrated.beam_divergence == pytest.approx(divergence, abs=0.0015)
    assert calibrated.beam_exit_m == TreeSettings().beam_exit_m


def test_too_few_trunks_calibrate_nothing() -> None:
    scan = Lms151(FINE).scan(_stem(4.0, 0.3, 0.3), Pose2(), np.random.default_rng(0))
    with pytest.raises(InputError, match="expected 100 free-standing trunks"):
        calibrate_footprint([scan] * 3, TreeSettings())


def test_diameter_limits_must_be_in_order() -> None:
    with pytest.raises(ValueError, match="diameter_min_m below diameter_max_m"):
        TreeSettings(diameter_min_m=0.9)
