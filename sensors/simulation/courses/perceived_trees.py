"""Perceptions of trees ready made along a way: noise, misses, clutter, blindness, what walks."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import Pose2, wrap_angle
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.measurements import Measurement, OdometryNoise, Recording
from sensors.simulation.wheels import simulate_wheels
from sensors.truth import Source, TrueLandmarks, TruePath, Truth

_CLUTTER_DIAMETER_M: Final = 0.28
_DIAMETER_RELATIVE_SIGMA: Final = 0.10
_WALKING_SPEED: Final = 1.2
_WALKED_RADII_M: Final = (2.0, 5.0)
_WALKER_DIAMETERS_M: Final = (0.35, 0.5)
_BESIDE_M: Final = 8.0


class PerceivedOptions(BaseModel):
    """How trees are perceived on a course.

    `missed` is the share of things in sight that a scan does not show, `clutter` the mean number
    of false perceptions a scan. `num_blind` times nothing is perceived for `blind_s`. `moving`
    adds people who walk in circles beside the way and look like trees: so many as this share of
    the trees. `odometry` adds noisy wheels.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = Field(0, ge=0)
    scan_rate_hz: float = Field(10.0, gt=0.1, le=100.0)
    field_of_view_rad: float = Field(4.712389, gt=0.0, le=2.0 * np.pi)
    max_range_m: float = Field(15.0, gt=0.5, le=200.0)
    range_sigma_m: float = Field(0.03, gt=0.0, le=5.0)
    bearing_sigma_rad: float = Field(0.005, gt=0.0, le=0.5)
    missed: float = Field(0.1, ge=0.0, lt=1.0)
    clutter: float = Field(0.0, ge=0.0, le=100.0)
    num_blind: int = Field(0, ge=0, le=1000)
    blind_s: float = Field(1.0, ge=0.0, le=60.0)
    moving: float = Field(0.0, ge=0.0, le=1.0)
    odometry: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Stand:
    """Trunks: world_t_trees (m, 2) and diameters (m,)."""

    world_t_trees: FloatArray
    diameters_m: FloatArray

    def select(self, rows: IntArray | BoolArray) -> "Stand":
        """Some of them."""
        return Stand(self.world_t_trees[rows], self.diameters_m[rows])

    def true_landmarks(self) -> TrueLandmarks:
        """All of them, row by row."""
        kinds = np.full(len(self.diameters_m), Kind.TREE)
        return TrueLandmarks(self.world_t_trees, kinds, self.diameters_m)


def source_of_perceptions(
    name: str,
    stamps_ns: IntArray,
    poses: FloatArray,
    stand: Stand,
    options: PerceivedOptions,
    rng: np.random.Generator,
) -> Source:
    """What is perceived of a stand at stamps (n,) and true poses (n, 3), with its truth."""
    samples = simulate_wheels(stamps_ns, poses, OdometryNoise(), rng) if options.odometry else []
    wheels = {sample.stamp_ns: sample for sample in samples}
    walkers = _Walkers.beside(poses, round(options.moving * len(stand.diameters_m)), rng)
    is_blind = _blind(options, len(stamps_ns), rng)
    measurements: list[Measurement] = []
    associations: dict[int, IntArray] = {}
    for k, stamp_ns in enumerate(stamps_ns.tolist()):
        if stamp_ns in wheels:
            measurements.append(wheels[stamp_ns])
        things = walkers.among(stand, stamp_ns)
        perceptions, rows = perceive(stamp_ns, Pose2.from_array(poses[k]), things, options, rng)
        rows = np.where(rows < len(stand.diameters_m), rows, -1)
        shown = slice(0) if is_blind[k] else slice(None)
        measurements.append(perceptions.select(np.arange(len(rows))[shown]))
        associations[stamp_ns] = rows[shown]
    recording = Recording(
        name=name,
        measurements=tuple(measurements),
        num_scans=len(stamps_ns),
        odometry_noise=OdometryNoise() if options.odometry else None,
        map_T_start=Pose2.from_array(poses[0]),
    )
    path = TruePath(stamps_ns, poses[:, :2], poses[:, 2])
    return Source(recording, Truth(path, stand.true_landmarks(), associations))


def perceive(
    stamp_ns: int,
    world_T_base: Pose2,
    stand: Stand,
    options: PerceivedOptions,
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
        [stand.diameters_m[trees], _CLUTTER_DIAMETER_M * np.ones(num_clutter)]
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


@dataclass(frozen=True, slots=True, eq=False)
class _Walkers:
    """People: each walks around its own centre (w, 2), from its own phase (w,) on."""

    world_t_centres: FloatArray
    radii_m: FloatArray
    phases: FloatArray
    diameters_m: FloatArray

    @classmethod
    def beside(cls, poses: FloatArray, count: int, rng: np.random.Generator) -> Self:
        """So many near a way of poses (n, 3)."""
        centres = poses[rng.integers(0, len(poses), count), :2]
        return cls(
            centres + rng.uniform(-_BESIDE_M, _BESIDE_M, (count, 2)),
            rng.uniform(*_WALKED_RADII_M, count),
            rng.uniform(-np.pi, np.pi, count),
            rng.uniform(*_WALKER_DIAMETERS_M, count),
        )

    def among(self, stand: Stand, stamp_ns: int) -> Stand:
        """The trees first, then the walkers where they are at this time."""
        if not len(self.phases):
            return stand
        angles = self.phases + _WALKING_SPEED / self.radii_m * 1e-9 * stamp_ns
        ahead = np.column_stack([np.cos(angles), np.sin(angles)])
        places = self.world_t_centres + self.radii_m[:, None] * ahead
        return Stand(
            np.vstack([stand.world_t_trees, places]),
            np.concatenate([stand.diameters_m, self.diameters_m]),
        )


def _blind(options: PerceivedOptions, num_scans: int, rng: np.random.Generator) -> BoolArray:
    """(n,) in which scans nothing is perceived; not in the first, so that there is a map."""
    is_blind = np.zeros(num_scans, dtype=np.bool_)
    length = round(options.blind_s * options.scan_rate_hz)
    for start in rng.integers(1, max(num_scans - length, 2), options.num_blind).tolist():
        is_blind[start : start + length] = True
    return is_blind


def _clutter_ranges(options: PerceivedOptions, count: int, rng: np.random.Generator) -> FloatArray:
    """Evenly over the area in reach."""
    return np.sqrt(rng.uniform(1.0, options.max_range_m**2, count))


def _is_hidden(ranges_m: FloatArray, bearings: FloatArray, diameters_m: FloatArray) -> BoolArray:
    """(n,) whether a trunk's centre lies behind a nearer trunk."""
    half_widths = np.arcsin(np.minimum(0.5 * diameters_m / np.maximum(ranges_m, 1e-6), 1.0))
    apart = np.abs(wrap_angle(bearings[:, None] - bearings[None, :]))
    covers = (apart < half_widths[None, :]) & (ranges_m[None, :] < ranges_m[:, None])
    return np.asarray(covers.any(axis=1))
