"""The paper's simulated test run with perceptions ready made: no scans, no detector.

Landmarks at random around a round track (section 4, Fig. 4).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2, wrap_angle
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.measurements import Measurement, OdometryNoise, Recording
from sensors.simulation.wheels import simulate_wheels
from sensors.truth import Source, TrueLandmarks, TruePath, Truth

_TRUNK_MEDIAN_M: Final = 0.28
_TRUNK_LOG_SIGMA: Final = 0.35
_ROWS_M: Final = (4.0, 3.0)
_PLANTING_SIGMA_M: Final = 0.1
_ORCHARD_TRUNK_M: Final = 0.15
_ORCHARD_LOG_SIGMA: Final = 0.1
_DIAMETER_RELATIVE_SIGMA: Final = 0.10
_LEAST_SPACING_M: Final = 0.8
_KEPT_FREE_M: Final = 1.5


class CourseOptions(BaseModel):
    """A round track among trees, driven once and a little farther.

    `rows` plants an orchard instead of `num_trees` at random: alike trees, 4 m by 3 m apart.
    `overlap_s` is how long the start is seen again. `clutter` is the mean number of false
    perceptions a scan. `odometry` adds noisy wheels.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = Field(0, ge=0)
    track_radius_m: float = Field(20.0, gt=1.0, le=5000.0)
    num_trees: int = Field(120, ge=0, le=200_000)
    band_m: float = Field(10.0, gt=0.0, le=500.0)
    lap_s: float = Field(45.0, gt=1.0, le=36_000.0)
    overlap_s: float = Field(5.0, ge=0.0, le=36_000.0)
    scan_rate_hz: float = Field(10.0, gt=0.1, le=100.0)
    field_of_view_rad: float = Field(4.712389, gt=0.0, le=2.0 * np.pi)
    max_range_m: float = Field(15.0, gt=0.5, le=200.0)
    range_sigma_m: float = Field(0.03, gt=0.0, le=5.0)
    bearing_sigma_rad: float = Field(0.005, gt=0.0, le=0.5)
    missed: float = Field(0.1, ge=0.0, lt=1.0)
    clutter: float = Field(0.0, ge=0.0, le=100.0)
    odometry: bool = False
    rows: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Stand:
    """Trunks: world_t_trees (m, 2) and diameters (m,)."""

    world_t_trees: FloatArray
    diameters_m: FloatArray


def read(name: str, options: CourseOptions) -> Source:
    """The course of these options with its truth; the same seed gives the same course.

    Raises:
        InputError: the trees do not fit into the band around the track.
    """
    rng = np.random.default_rng(options.seed)
    stand = _orchard(options, rng) if options.rows else _plant(options, rng)
    stamps_ns, poses = _drive(options)
    samples = simulate_wheels(stamps_ns, poses, OdometryNoise(), rng) if options.odometry else []
    wheels = {sample.stamp_ns: sample for sample in samples}
    measurements: list[Measurement] = []
    associations: dict[int, IntArray] = {}
    for stamp_ns, pose in zip(stamps_ns.tolist(), poses, strict=True):
        if stamp_ns in wheels:
            measurements.append(wheels[stamp_ns])
        perceptions, rows = _perceive(stamp_ns, Pose2.from_array(pose), stand, options, rng)
        measurements.append(perceptions)
        associations[stamp_ns] = rows
    recording = Recording(
        name=name,
        measurements=tuple(measurements),
        num_scans=len(stamps_ns),
        odometry_noise=OdometryNoise() if options.odometry else None,
        map_T_start=Pose2.from_array(poses[0]),
    )
    landmarks = TrueLandmarks(
        stand.world_t_trees, np.full(len(stand.diameters_m), Kind.TREE), stand.diameters_m
    )
    path = TruePath(stamps_ns, poses[:, :2], poses[:, 2])
    return Source(recording, Truth(path, landmarks, associations))


def _plant(options: CourseOptions, rng: np.random.Generator) -> _Stand:
    """Trees evenly in the band around the track, apart from each other, the track kept free."""
    trees: FloatArray = np.zeros((0, 2))
    for _ in range(200):
        missing = options.num_trees - len(trees)
        if missing == 0:
            diameters_m = _TRUNK_MEDIAN_M * np.exp(
                _TRUNK_LOG_SIGMA * rng.standard_normal(len(trees))
            )
            return _Stand(trees, np.clip(diameters_m, 0.08, 0.75))
        trees = _without_neighbours(np.vstack([trees, _scatter(options, missing, rng)]))
    raise InputError(
        f"course: {options.num_trees} trees do not fit around the track; "
        "take fewer (num_trees) or a wider band (band_m)"
    )


def _orchard(options: CourseOptions, rng: np.random.Generator) -> _Stand:
    """A grid about the track's centre, as exact as planting is, the track kept free."""
    outer = options.track_radius_m + options.band_m
    x, y = np.meshgrid(np.arange(-outer, outer, _ROWS_M[0]), np.arange(-outer, outer, _ROWS_M[1]))
    trees = np.column_stack([x.ravel(), y.ravel()])
    trees = trees + _PLANTING_SIGMA_M * rng.standard_normal(trees.shape)
    away_m = np.abs(np.hypot(*trees.T) - options.track_radius_m)
    trees = trees[(away_m > _KEPT_FREE_M) & (away_m <= options.band_m)]
    log_sizes = _ORCHARD_LOG_SIGMA * rng.standard_normal(len(trees))
    return _Stand(trees, _ORCHARD_TRUNK_M * np.exp(log_sizes))


def _scatter(options: CourseOptions, count: int, rng: np.random.Generator) -> FloatArray:
    inner = max(options.track_radius_m - options.band_m, 0.0)
    outer = options.track_radius_m + options.band_m
    radii = np.sqrt(rng.uniform(inner**2, outer**2, count))
    angles = rng.uniform(0.0, 2.0 * np.pi, count)
    kept = np.abs(radii - options.track_radius_m) > _KEPT_FREE_M
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])[kept]


def _without_neighbours(trees: FloatArray) -> FloatArray:
    """The trees that keep their distance to every earlier one."""
    from scipy.spatial import KDTree

    pairs = KDTree(trees).query_pairs(_LEAST_SPACING_M, output_type="ndarray")
    kept = np.ones(len(trees), dtype=np.bool_)
    kept[pairs.max(axis=1)] = False
    return trees[kept]


def _drive(options: CourseOptions) -> tuple[IntArray, FloatArray]:
    """Stamps (n,) and true poses (n, 3), counter-clockwise at constant speed."""
    num_scans = int((options.lap_s + options.overlap_s) * options.scan_rate_hz) + 1
    seconds = np.arange(num_scans) / options.scan_rate_hz
    angles = 2.0 * np.pi * seconds / options.lap_s
    radius = options.track_radius_m
    poses = np.column_stack(
        [radius * np.cos(angles), radius * np.sin(angles), wrap_angle(angles + 0.5 * np.pi)]
    )
    return np.round(seconds * 1e9).astype(np.int64), poses


def _perceive(
    stamp_ns: int,
    world_T_base: Pose2,
    stand: _Stand,
    options: CourseOptions,
    rng: np.random.Generator,
) -> tuple[Perceptions, IntArray]:
    """Noisy perceptions of what is visible, and the tree of each (-1: clutter)."""
    base_t_trees = world_T_base.inverse().transform(stand.world_t_trees)
    ranges_m = np.hypot(base_t_trees[:, 0], base_t_trees[:, 1])
    bearings = np.arctan2(base_t_trees[:, 1], base_t_trees[:, 0])
    inside = (ranges_m < options.max_range_m) & (np.abs(bearings) < options.field_of_view_rad / 2)
    trees = np.flatnonzero(inside)
    trees = trees[~_is_hidden(ranges_m[trees], bearings[trees], stand.diameters_m[trees])]
    trees = trees[rng.uniform(size=len(trees)) >= options.missed]
    num_clutter = int(rng.poisson(options.clutter))
    rows = np.concatenate([trees, np.full(num_clutter, -1)])
    ranges_m = np.concatenate([ranges_m[trees], _clutter_ranges(options, num_clutter, rng)])
    half_field = options.field_of_view_rad / 2
    bearings = np.concatenate([bearings[trees], rng.uniform(-half_field, half_field, num_clutter)])
    diameters_m = np.concatenate(
        [stand.diameters_m[trees], _TRUNK_MEDIAN_M * np.ones(num_clutter)]
    ) * np.exp(_DIAMETER_RELATIVE_SIGMA * rng.standard_normal(len(rows)))
    sigmas = np.full((2, len(rows)), [[options.range_sigma_m], [options.bearing_sigma_rad]])
    noise = sigmas * rng.standard_normal(sigmas.shape)
    perceptions = Perceptions.from_arrays(
        stamp_ns,
        Kind.TREE,
        np.maximum(ranges_m + noise[0], 0.05),
        wrap_angle(bearings + noise[1]),
        polar_covariances(sigmas[0], sigmas[1]),
        diameters_m=diameters_m,
        diameter_sigmas_m=_DIAMETER_RELATIVE_SIGMA * diameters_m,
    )
    return perceptions, rows.astype(np.int64)


def _clutter_ranges(options: CourseOptions, count: int, rng: np.random.Generator) -> FloatArray:
    """Evenly over the area in reach."""
    return np.sqrt(rng.uniform(1.0, options.max_range_m**2, count))


def _is_hidden(ranges_m: FloatArray, bearings: FloatArray, diameters_m: FloatArray) -> BoolArray:
    """(n,) whether a trunk's centre lies behind a nearer trunk."""
    half_widths = np.arcsin(np.minimum(0.5 * diameters_m / np.maximum(ranges_m, 1e-6), 1.0))
    apart = np.abs(wrap_angle(bearings[:, None] - bearings[None, :]))
    covers = (apart < half_widths[None, :]) & (ranges_m[None, :] < ranges_m[:, None])
    return np.asarray(covers.any(axis=1))
