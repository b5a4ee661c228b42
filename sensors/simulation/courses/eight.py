"""A figure of eight through the trees of a real stem map, with perceptions ready made."""

from pathlib import Path
from typing import Final

import numpy as np
from pydantic import Field

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from sensors.simulation.courses.perceived_trees import (
    PerceivedOptions,
    Stand,
    source_of_perceptions,
)
from sensors.simulation.courses.stem_maps import MarkUnit, stand_from_stem_map
from sensors.simulation.courses.track import Track, drive
from sensors.truth import Source

_NUM_POINTS: Final = 720
_MARGIN_M: Final = 8.0
_HALF_WIDTH_M: Final = 1.0
_LEAST_HALF_M: Final = 10.0


class EightOptions(PerceivedOptions):
    """An eight that fills a stand, begun at a place of the seed's, driven for `length_m`.

    `stem_map` is a CSV file x,y,mark of a real stand in m; `mark_unit` says in what its diameters
    are. What stands within a metre of the way was cut for it.
    """

    stem_map: Path | None = None
    mark_unit: MarkUnit = MarkUnit.CM
    speed: float = Field(2.0, ge=0.1, le=20.0)
    length_m: float = Field(1000.0, gt=1.0, le=100_000.0)
    scan_rate_hz: float = Field(5.0, gt=0.1, le=100.0)
    max_range_m: float = Field(20.0, gt=0.5, le=200.0)


def read(name: str, options: EightOptions) -> Source:
    """The course of these options with its truth.

    Raises:
        InputError: no stem map, a fault in it, or one too small for an eight.
    """
    if options.stem_map is None:
        raise InputError(f"{name}: expected the file of a stem map, as in --set stem_map=FILE")
    rng = np.random.default_rng(options.seed)
    trees = stand_from_stem_map(options.stem_map, options.mark_unit, rng)
    half_m = np.abs(trees.world_t_things).max(axis=0) - _MARGIN_M
    if half_m.min() < _LEAST_HALF_M:
        raise InputError(f"{options.stem_map}: expected a stand of 36 m by 36 m for an eight")
    track = _eight(half_m, rng.uniform(0.0, 2.0 * np.pi))
    stand = Stand(trees.world_t_things, 2.0 * trees.radii_m)
    way = drive(
        track, options.speed, options.length_m / options.speed, options.scan_rate_hz, rng=rng
    )
    stand = stand.select(_distances_m(stand, track) > _HALF_WIDTH_M + 0.5 * stand.diameters_m)
    return source_of_perceptions(name, way.stamps_ns, way.poses, stand, options, rng)


def _eight(half_m: FloatArray, start: float) -> Track:
    """Two loops beside each other that fill the sides of 2 * half_m (2,)."""
    angles = start + np.linspace(0.0, 2.0 * np.pi, _NUM_POINTS, endpoint=False)
    return Track(half_m * np.column_stack([np.sin(angles), np.sin(2.0 * angles)]))


def _distances_m(stand: Stand, track: Track) -> FloatArray:
    """(m,) of each tree to the way."""
    from scipy.spatial import KDTree

    way = track.poses(np.arange(0.0, track.length_m, 0.1))[:, :2]
    distances_m: FloatArray = KDTree(way).query(stand.world_t_trees)[0]
    return distances_m
