"""The figures of reflectors: simulated, and in a real car park against its surveyed beacons."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from detectors.catalog import create_detector
from detectors.reflectors import ReflectorDetector, ReflectorSettings
from evaluation.alignment import rigid_alignment
from evaluation.benches.bench_statistics import mean, rms
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.detector_trials import Trial, judge_detector, look
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.car_park import CarParkOptions, read, recognises
from sensors.measurements import LaserScan
from sensors.simulation.lms151 import Lms151, Resolution
from sensors.simulation.world import Thing, World

MIN_MARKERS = 3
MAX_MATCH_M = 0.5
_HEADINGS = np.radians(np.arange(-180.0, 180.0, 1.0))


def reflectors_simulated(seeds: Sequence[int]) -> list[Row]:
    """Wrapped posts of 6 cm before a ring of trees, within 15 m, their width known.

    At 0.5 deg a post's edge mostly falls between two beams. The mean over the posterior of all
    that a scan holds - beams, intensities and ranges, the simulator's physics known - errs by
    0.06 deg here: no detector gets to 0.05.
    """
    settings = {"centre_offset_m": 0.03 * np.pi / 4.0, "post_width_m": 0.06}
    detector = create_detector("reflectors", settings)
    rows = []
    for resolution in Resolution:
        trials = [t for seed in seeds for t in _trials(seed, Lms151(resolution))]
        outcomes = judge_detector(trials, detector, (Thing.REFLECTOR,), 0.0)
        near = outcomes.ranges_m <= 15.0
        errors = outcomes.errors[near & outcomes.visible]
        bearing_deg = float(np.degrees(rms(errors[:, 1])))
        range_mm = 1e3 * rms(errors[:, 0])
        name = f"reflectors {resolution.value:g} deg"
        precision = mean(outcomes.matched[near] >= 0)
        rows += [
            Row(f"{name} precision", precision, "", Better.HIGHER, 0.99),
            Row(f"{name} bearing RMSE", bearing_deg, "deg", Better.LOWER, 0.05),
            Row(f"{name} range RMSE", range_mm, "mm", Better.LOWER, 10.0),
        ]
    return rows


def reflectors_car_park(folder: Path) -> list[Row]:
    """Perceptions against the 15 beacons, in scans that show three of them or more.

    Each scan is laid onto the beacons by its own best rigid motion, GPS only says which is which;
    so the survey's errors count, GPS's do not. RMS per axis, over the degrees of freedom that are
    left (2 n - 3 a scan), hence of one perception.

    Raises:
        InputError: the folder is not the car park's, or is damaged.
    """
    name = "reflectors car park"
    if not recognises(folder):
        raise InputError(f"{folder}: expected the recording of the car park, it is not there")
    num_perceived, residuals = 0, []
    for laser_t_markers, world_t_laser, beacons in _scans(folder):
        num_perceived += len(laser_t_markers)
        residuals.append(_residuals(laser_t_markers, world_t_laser, beacons))
    num_matched = sum(len(each) for each in residuals)
    freedom = sum(max(2 * len(each) - 3, 0) for each in residuals)
    squares = sum(float(np.sum(each**2)) for each in residuals)
    per_axis_mm = 1e3 * np.sqrt(squares / freedom) if freedom else np.nan
    precision = num_matched / num_perceived if num_perceived else np.nan
    return [
        Row(f"{name} precision", float(precision), "", Better.HIGHER, 0.99),
        Row(f"{name} RMSE per axis", float(per_axis_mm), "mm", Better.LOWER, 22.0),
    ]


def _trials(seed: int, device: Lms151) -> list[Trial[LaserScan]]:
    """Three scans of 12 posts on a jittered ring grid, 20 stems outside of it."""
    rng = np.random.default_rng([seed, 9])
    angles = np.linspace(-np.pi, np.pi, 12, endpoint=False) + rng.uniform(-0.1, 0.1, 12)
    distances_m = rng.uniform(2.5, 14.0, 12)
    posts = distances_m[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    stem_angles = rng.uniform(-np.pi, np.pi, 20)
    stems = 18.0 * np.column_stack([np.cos(stem_angles), np.sin(stem_angles)])
    world = World.union(
        [
            World.of(Thing.REFLECTOR, posts, np.full(12, 0.06), rng),
            World.of(Thing.STEM, stems, rng.uniform(0.15, 0.5, 20), rng),
        ]
    )
    places = [Pose2.from_array(rng.uniform(-1.0, 1.0, 3) * (0.5, 0.5, 3.0)) for _ in range(3)]
    return [look(world, place, device, rng) for place in places]


def _scans(folder: Path) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Of each scan: markers (n, 2) from the laser, the laser's place by GPS (2,), the beacons."""
    source = read(folder, CarParkOptions())
    path, beacons = source.truth.path, source.truth.landmarks
    if path is None or beacons is None:
        raise InputError(f"{folder}: expected GPS and beacons, read without them")
    detector = ReflectorDetector(ReflectorSettings())
    scans = []
    for measurement in source.recording.measurements:
        if not isinstance(measurement, LaserScan):
            continue
        stamp_ns = measurement.stamp_ns
        markers = detector.detect(measurement).base_t_landmarks()
        if len(markers) < MIN_MARKERS or not path.stamps_ns[0] <= stamp_ns <= path.stamps_ns[-1]:
            continue
        axes = path.world_t_reference.T
        place = np.array([np.interp(stamp_ns, path.stamps_ns, axis) for axis in axes])
        scans.append((markers, place, beacons.world_t_landmarks))
    return scans


def _residuals(
    laser_t_markers: FloatArray, world_t_laser: FloatArray, beacons: FloatArray
) -> FloatArray:
    """(k, 2) m of the markers that are beacons, after their own rigid alignment; k 0 below 3."""
    x, y = world_t_laser
    distances = [
        np.linalg.norm(Pose2(x, y, heading).transform(laser_t_markers)[:, None] - beacons, axis=2)
        for heading in _HEADINGS
    ]
    costs = [np.minimum(each.min(axis=1), 2.0 * MAX_MATCH_M).sum() for each in distances]
    best = distances[int(np.argmin(costs))]
    rows, columns = linear_sum_assignment(np.minimum(best, 1e3 * MAX_MATCH_M))
    near = best[rows, columns] <= MAX_MATCH_M
    rows, columns = rows[near], columns[near]
    if len(rows) < MIN_MARKERS:
        return np.zeros((0, 2))
    world_T_laser = rigid_alignment(beacons[columns], laser_t_markers[rows])
    return np.asarray(beacons[columns] - world_T_laser.transform(laser_t_markers[rows]))
