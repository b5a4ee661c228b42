"""Parts of a depth image that stand out of the ground, and what they look like."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from detectors.ground import fit_ground
from detectors.levelled_raster import LevelledRaster
from detectors.rock_settings import RockSettings
from semgraph.arrays import BoolArray, FloatArray, IntArray

_MAD_TO_SIGMA: Final = 1.4826
_LEVELS: Final = (1.0, 1.6, 2.5, 4.0)
_BEYOND: Final = 2
_UPRIGHT: Final = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class StandingPixels:
    """Pixels (n,) that stand out of the ground, and how they hang together.

    Attributes:
        rows, columns: in the raster.
        ranges_m, bearings, above_m: in the plane, and above the ground.
        least_m: that far above the ground a pixel must be to stand out at all.
        spreads_m: standard deviation of ground there, noise included.
        range_sigmas_m: of each.
        labels: (levels, n) the part that each is in where only what stands out so many times the
            least counts, -1 for none; the numbers differ from level to level.
        above_image_m: (rows, columns) of the whole raster.
    """

    rows: IntArray
    columns: IntArray
    ranges_m: FloatArray
    bearings: FloatArray
    above_m: FloatArray
    least_m: FloatArray
    spreads_m: FloatArray
    range_sigmas_m: FloatArray
    labels: IntArray
    above_image_m: FloatArray


def standing_pixels(raster: LevelledRaster, settings: RockSettings) -> StandingPixels:
    """What stands out of the ground around it."""
    ranges_m = raster.ranges_m
    inside = (ranges_m > settings.range_min_m) & (ranges_m < settings.range_max_m)
    above_image_m = np.full(inside.shape, np.nan)
    if inside.any():
        x, y, z = raster.x[inside], raster.y[inside], raster.z[inside]
        above_image_m[inside] = z - fit_ground(x, y, z).below(x, y)
    roughness_m = _roughness(above_image_m[inside])
    range_sigmas_m = settings.depth_sigmas_m(raster.depths_m, raster.focal_px * settings.stride_px)
    noise_m = _UPRIGHT * range_sigmas_m * abs(raster.height_m) / ranges_m
    least_m = noise_m + max(settings.least_height_m, settings.roughness_factor * roughness_m)
    mask = above_image_m > least_m
    rows, columns = np.nonzero(mask)
    gaps_m = settings.max_gap_m + 4.0 * range_sigmas_m
    edges = _edges(mask, ranges_m, gaps_m)
    above_m, least_m = above_image_m[mask], least_m[mask]
    return StandingPixels(
        rows,
        columns,
        ranges_m[mask],
        np.arctan2(raster.y[mask], raster.x[mask]),
        above_m,
        least_m,
        np.hypot(roughness_m, noise_m[mask]),
        range_sigmas_m[mask],
        _parts(above_m / least_m, edges, settings.min_pixels),
        above_image_m,
    )


def _roughness(above_m: FloatArray) -> float:
    below_m = above_m[above_m < 0.0]
    return _MAD_TO_SIGMA * float(np.median(-below_m)) if len(below_m) else 0.0


_ALL, _FIRST, _LAST = slice(None), slice(None, -1), slice(1, None)
_NEIGHBOURS: Final = (
    ((_ALL, _FIRST), (_ALL, _LAST)),
    ((_FIRST, _ALL), (_LAST, _ALL)),
    ((_FIRST, _FIRST), (_LAST, _LAST)),
    ((_FIRST, _LAST), (_LAST, _FIRST)),
)


def _edges(mask: BoolArray, ranges_m: FloatArray, gaps_m: FloatArray) -> IntArray:
    """(2, e) pairs of neighbouring pixels of the mask without a step between them."""
    nodes = np.full(mask.shape, -1)
    nodes[mask] = np.arange(np.count_nonzero(mask))
    pairs = [np.zeros((2, 0), np.int64)]
    for here, there in _NEIGHBOURS:
        both = np.flatnonzero(mask[here] & mask[there])
        joined = np.abs(ranges_m[here].flat[both] - ranges_m[there].flat[both])
        both = both[joined < gaps_m[here].flat[both]]
        pairs.append(np.stack([nodes[here].flat[both], nodes[there].flat[both]]))
    return np.concatenate(pairs, axis=1)


def _parts(ratios: FloatArray, edges: IntArray, min_pixels: int) -> IntArray:
    """(levels, n) numbers of the connected parts that are large enough, from 0, -1 for none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, first = len(ratios), 0
    labels = np.full((len(_LEVELS), n), -1)
    for level, row in zip(_LEVELS, labels, strict=True):
        a, b = edges[:, (ratios[edges] > level).all(axis=0)]
        graph = coo_array((np.ones(len(a), np.int8), (a, b)), (n, n))
        _, parts = connected_components(graph, directed=False)
        parts[ratios <= level] = -1
        large = np.bincount(parts + 1)[1:] >= min_pixels
        numbers = np.append(np.where(large, first + np.cumsum(large) - 1, -1), -1)
        row[:] = numbers[parts]
        first += int(large.sum())
    return labels


@dataclass(frozen=True, slots=True, eq=False)
class RockSegments:
    """Connected parts (k,) that stand out of the ground, on several levels.

    Attributes:
        counts: pixels of each.
        ranges_m: median range in the plane.
        lefts, rights: bearings, rad, of its sides.
        heights_m: of its upper part above the ground.
        least_m: the height that it was cut off at.
        extents_m: along the range.
        shadows: how much of the ground behind it is hidden, 1 for a block of its height.
        sides: how much of its height is gone right beside it, 1 for a wall.
        spreads_m: of the ground, the noise at this range included.
        range_sigmas_m: of a single pixel.
        fills: share of the box around its outline that it fills, as seen.
        cut: share of its rows that touch the image's sides.
    """

    counts: IntArray
    ranges_m: FloatArray
    lefts: FloatArray
    rights: FloatArray
    heights_m: FloatArray
    least_m: FloatArray
    extents_m: FloatArray
    shadows: FloatArray
    sides: FloatArray
    spreads_m: FloatArray
    range_sigmas_m: FloatArray
    fills: FloatArray
    cut: FloatArray


def rock_segments(raster: LevelledRaster, pixels: StandingPixels) -> RockSegments:
    """What each part looks like."""
    levels, members = np.nonzero(pixels.labels >= 0)
    owners = pixels.labels[levels, members]
    counts = np.bincount(owners)
    ordered = np.argsort(owners, kind="stable")
    levels, members, owners = levels[ordered], members[ordered], owners[ordered]
    quantile = _Quantiles(owners, counts)
    r, h = pixels.ranges_m[members], pixels.above_m[members]
    b = pixels.bearings[members]
    near, middle, far = (quantile(r, share) for share in (0.1, 0.5, 0.9))
    (height,) = (quantile(h, 0.95),)
    left, right = quantile(b, 0.97), quantile(b, 0.03)
    rows, columns = pixels.rows[members], pixels.columns[members]
    images = np.full((len(_LEVELS), *pixels.above_image_m.shape), -1)
    for k, row in enumerate(pixels.labels):
        images[k, pixels.rows, pixels.columns] = row
    rim = _Rim(images, levels, rows, columns, owners)
    starts = quantile.starts
    tall = np.maximum.reduceat(rows, starts) - np.minimum.reduceat(rows, starts) + 1 if len(starts) else counts
    wide = np.maximum.reduceat(columns, starts) - np.minimum.reduceat(columns, starts) + 1 if len(starts) else counts
    width = images.shape[2]
    cut = _means((columns == 0) | (columns == width - 1), owners, len(counts)) * counts / np.maximum(tall, 1)
    return RockSegments(
        counts, middle, left, right, height,
        np.array(_LEVELS)[levels[starts]] * quantile(pixels.least_m[members], 0.5),
        far - near,
        _shadows(raster, rim, height), _sides(pixels.above_image_m, rim, height),
        quantile(pixels.spreads_m[members], 0.5), quantile(pixels.range_sigmas_m[members], 0.5),
        counts / (tall * wide), cut,
    )


class _Quantiles:
    def __init__(self, owners, counts):
        self.owners, self.counts = owners, counts
        self.starts = np.cumsum(counts) - counts

    def __call__(self, values, share):
        ordered = values[np.lexsort([values, self.owners])]
        return ordered[self.starts + (share * (self.counts - 1) + 0.5).astype(np.int64)]


def _means(values, owners, num):
    n = np.bincount(owners, minlength=num)
    return np.bincount(owners, values, num) / np.maximum(n, 1)


class _Rim:
    def __init__(self, images, levels, rows, columns, owners):
        self.images, self.levels, self.rows, self.columns, self.owners = images, levels, rows, columns, owners

    def __call__(self, up, right):
        _, h, w = self.images.shape
        r, c = self.rows - up, self.columns + right
        k = np.flatnonzero((r >= 0) & (c >= 0) & (c < w))
        k = k[self.images[self.levels[k], r[k], c[k]] != self.owners[k]]
        return (self.rows[k], self.columns[k]), (r[k], c[k]), self.owners[k]


def _shadows(raster, rim, heights_m):
    here, there, owners = rim(_BEYOND, 0)
    share = np.clip(heights_m[owners] / max(raster.height_m, 0.1), 0.0, 0.9)
    expected_m = raster.ranges_m[here] * share / (1.0 - share)
    step = (np.nan_to_num(raster.ranges_m[there], nan=1e3) - raster.ranges_m[here]) / expected_m
    return _means(np.clip(step, 0.0, 1.5), owners, len(heights_m))


def _sides(above, rim, heights_m):
    parts = []
    for right in (-_BEYOND, _BEYOND):
        here, there, owners = rim(0, right)
        drop = (above[here] - above[there]) / heights_m[owners]
        k = np.isfinite(drop)
        parts.append((np.clip(drop[k], -1, 1), owners[k]))
    v, o = (np.concatenate(c) for c in zip(*parts))
    return _means(v, o, len(heights_m))
