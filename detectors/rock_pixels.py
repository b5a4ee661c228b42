"""Pixels that stand out of the local ground, and how they hang together."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from detectors.ground import fit_ground
from detectors.levelled_raster import LevelledRaster
from detectors.rock_settings import RockSettings
from semgraph.arrays import BoolArray, FloatArray, IntArray

LEVELS: Final = (1.0, 1.6, 2.5, 4.0)
_MAD_TO_SIGMA: Final = 1.4826
_GAP_SIGMAS: Final = 4.0
# A depth errs along the ray, so that a height errs by height over range, and smoothing helps.
_SHARE_UPRIGHT: Final = 0.6

_ALL, _BUT_LAST, _BUT_FIRST = slice(None), slice(None, -1), slice(1, None)
_NEIGHBOURS: Final = (
    ((_ALL, _BUT_LAST), (_ALL, _BUT_FIRST)),
    ((_BUT_LAST, _ALL), (_BUT_FIRST, _ALL)),
    ((_BUT_LAST, _BUT_LAST), (_BUT_FIRST, _BUT_FIRST)),
    ((_BUT_LAST, _BUT_FIRST), (_BUT_FIRST, _BUT_LAST)),
)


@dataclass(frozen=True, slots=True, eq=False)
class StandingPixels:
    """Pixels (n,) that stand out of the ground.

    Attributes:
        rows, columns: in the raster.
        ranges_m, bearings, above_m: in the plane, and above the ground.
        least_m: so far above the ground a pixel must be to stand out.
        spreads_m: standard deviation of the ground there, noise included.
        range_sigmas_m: of each.
        parts: (levels, n) the connected part that each is in, where only what is above so many
            times the least counts; -1 for none. Numbers grow from level to level.
        above_image_m: (rows, columns) of the whole raster, NaN where there is nothing.
    """

    rows: IntArray
    columns: IntArray
    ranges_m: FloatArray
    bearings: FloatArray
    above_m: FloatArray
    least_m: FloatArray
    spreads_m: FloatArray
    range_sigmas_m: FloatArray
    parts: IntArray
    above_image_m: FloatArray


def standing_pixels(raster: LevelledRaster, settings: RockSettings) -> StandingPixels:
    """What stands out of the ground around it, by the ground's own roughness and the noise."""
    ranges_m = raster.ranges_m
    above_image_m = _above_ground(raster, settings)
    roughness_m = _roughness(above_image_m)
    sigmas_m = settings.depth_sigmas_m(raster.depths_m, raster.focal_px)
    noise_m = _SHARE_UPRIGHT * sigmas_m * abs(raster.height_m)
    noise_m = noise_m / np.maximum(ranges_m, settings.range_min_m)
    least_m = noise_m + max(settings.least_height_m, settings.roughness_factor * roughness_m)
    mask = above_image_m > least_m
    rows, columns = np.nonzero(mask)
    above_m, least_m = above_image_m[mask], least_m[mask]
    edges = _edges(mask, ranges_m, settings.max_gap_m + _GAP_SIGMAS * sigmas_m)
    return StandingPixels(
        rows,
        columns,
        ranges_m[mask],
        np.arctan2(raster.y[mask], raster.x[mask]),
        above_m,
        least_m,
        np.hypot(roughness_m, noise_m[mask]),
        sigmas_m[mask],
        _parts(above_m / least_m, edges, settings.min_pixels),
        above_image_m,
    )


def _above_ground(raster: LevelledRaster, settings: RockSettings) -> FloatArray:
    """(rows, columns) m, NaN out of range."""
    inside = (raster.ranges_m > settings.range_min_m) & (raster.ranges_m < settings.range_max_m)
    above_m = np.full(inside.shape, np.nan)
    if inside.any():
        x, y, z = raster.x[inside], raster.y[inside], raster.z[inside]
        above_m[inside] = z - fit_ground(x, y, z).below(x, y)
    return above_m


def _roughness(above_m: FloatArray) -> float:
    """Standard deviation of the ground, from what is below its middle: rocks are not."""
    below_m = above_m[above_m < 0.0]
    return _MAD_TO_SIGMA * float(np.median(-below_m)) if len(below_m) else 0.0


def _edges(mask: BoolArray, ranges_m: FloatArray, gaps_m: FloatArray) -> IntArray:
    """(2, e) numbers of neighbouring pixels of the mask without a step in range between them."""
    numbers = np.full(mask.shape, -1)
    numbers[mask] = np.arange(np.count_nonzero(mask))
    pairs = []
    for here, there in _NEIGHBOURS:
        both = mask[here] & mask[there]
        a, b = numbers[here][both], numbers[there][both]
        joined = np.abs(ranges_m[here][both] - ranges_m[there][both]) < gaps_m[here][both]
        pairs.append(np.stack([a[joined], b[joined]]))
    return np.concatenate(pairs, axis=1)


def _parts(ratios: FloatArray, edges: IntArray, min_pixels: int) -> IntArray:
    """(levels, n) numbers of the connected parts that are large enough, -1 for none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, first = len(ratios), 0
    parts = np.full((len(LEVELS), n), -1)
    lower = ratios[edges].min(axis=0)
    for level, row in zip(LEVELS, parts, strict=True):
        a, b = edges[:, lower > level]
        graph = coo_array((np.ones(len(a), np.int8), (a, b)), (n, n))
        _, labels = connected_components(graph, directed=False)
        labels[ratios <= level] = -1
        large = np.bincount(labels + 1)[1:] >= min_pixels
        row[:] = np.append(np.where(large, first + np.cumsum(large) - 1, -1), -1)[labels]
        first += int(large.sum())
    return parts
