"""The paper's simulated test run with perceptions ready made: no scans, no detector.

Landmarks at random around a round track (section 4, Fig. 4).
"""

from typing import Final

import numpy as np
from pydantic import Field

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import wrap_angle
from sensors.simulation.courses.perceived_trees import (
    PerceivedOptions,
    Stand,
    source_of_perceptions,
)
from sensors.simulation.courses.planting import BORDER_M, apart, most_that_fit, trunk_diameters_m
from sensors.truth import Source

_ROWS_M: Final = (4.0, 3.0)
_PLANTING_SIGMA_M: Final = 0.1
_ORCHARD_TRUNK_M: Final = 0.15
_ORCHARD_LOG_SIGMA: Final = 0.1
_KEPT_FREE_M: Final = 1.5
_NUM_ROUNDS: Final = 200


class CourseOptions(PerceivedOptions):
    """A round track among trees, driven once and a little farther.

    `rows` plants an orchard instead of `num_trees` at random: alike trees, 4 m by 3 m apart.
    `overlap_s` is how long the start is seen again.
    """

    track_radius_m: float = Field(20.0, gt=1.0, le=5000.0)
    num_trees: int = Field(120, ge=0, le=200_000)
    band_m: float = Field(10.0, gt=0.0, le=500.0)
    lap_s: float = Field(45.0, gt=1.0, le=36_000.0)
    overlap_s: float = Field(5.0, ge=0.0, le=36_000.0)
    rows: bool = False


def read(name: str, options: CourseOptions) -> Source:
    """The course of these options with its truth; the same seed gives the same course.

    Raises:
        InputError: the trees do not fit into the band around the track.
    """
    rng = np.random.default_rng(options.seed)
    stand = _orchard(options, rng) if options.rows else _plant(options, rng)
    stamps_ns, poses = _drive(options)
    return source_of_perceptions(name, stamps_ns, poses, stand, options, rng)


def _plant(options: CourseOptions, rng: np.random.Generator) -> Stand:
    """Trees evenly in the band around the track, apart from each other, the track kept free."""
    trees: FloatArray = np.zeros((0, 2))
    may_fit = options.num_trees <= most_that_fit(_area_m2(options))
    for _ in range(_NUM_ROUNDS if may_fit else 0):
        missing = options.num_trees - len(trees)
        if missing == 0:
            return Stand(trees, trunk_diameters_m(len(trees), rng))
        trees = apart(np.vstack([trees, _scatter(options, missing, rng)]))
    raise InputError(
        f"course: {options.num_trees} trees do not fit around the track; "
        "take fewer (num_trees) or a wider band (band_m)"
    )


def _orchard(options: CourseOptions, rng: np.random.Generator) -> Stand:
    """A grid about the track's centre, as exact as planting is, the track kept free."""
    outer = options.track_radius_m + options.band_m
    x, y = np.meshgrid(np.arange(-outer, outer, _ROWS_M[0]), np.arange(-outer, outer, _ROWS_M[1]))
    trees = np.column_stack([x.ravel(), y.ravel()])
    trees = trees + _PLANTING_SIGMA_M * rng.standard_normal(trees.shape)
    away_m = np.abs(np.hypot(*trees.T) - options.track_radius_m)
    trees = trees[(away_m > _KEPT_FREE_M) & (away_m <= options.band_m)]
    log_sizes = _ORCHARD_LOG_SIGMA * rng.standard_normal(len(trees))
    return Stand(trees, _ORCHARD_TRUNK_M * np.exp(log_sizes))


def _area_m2(options: CourseOptions) -> float:
    """Of the band with a border; the track that is kept free counts too."""
    inner = max(options.track_radius_m - options.band_m - BORDER_M, 0.0)
    outer = options.track_radius_m + options.band_m + BORDER_M
    return float(np.pi * (outer**2 - inner**2))


def _scatter(options: CourseOptions, count: int, rng: np.random.Generator) -> FloatArray:
    inner = max(options.track_radius_m - options.band_m, 0.0)
    outer = options.track_radius_m + options.band_m
    radii = np.sqrt(rng.uniform(inner**2, outer**2, count))
    angles = rng.uniform(0.0, 2.0 * np.pi, count)
    kept = np.abs(radii - options.track_radius_m) > _KEPT_FREE_M
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])[kept]


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
