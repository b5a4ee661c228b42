"""What connected parts that stand out of the ground look like."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from detectors.levelled_raster import LevelledRaster
from detectors.rock_pixels import LEVELS, StandingPixels
from semgraph.arrays import BoolArray, FloatArray, IntArray

_BEYOND: Final = 2
_LEAST_SENSOR_HEIGHT_M: Final = 0.1
_FAR_M: Final = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class RockSegments:
    """Connected parts (k,), those of higher levels within those of lower ones.

    Attributes:
        counts: pixels of each.
        ranges_m: median range in the plane.
        lefts, rights: bearings, rad, of its sides.
        heights_m: of its upper part above the ground.
        least_m: the height that it is cut off at.
        extents_m: along the range.
        shadows: step in range behind its upper rim, 1 for what a block of its height hides.
        sides: how much of its height is gone right beside it, 1 for a wall.
        spreads_m: standard deviation of the ground there, noise included.
        range_sigmas_m: of a single pixel.
        fills: share of the box around its outline that it fills, as seen.
        cut: pixels at the image's edge, over the square root of all.
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
    """Every part of every level."""
    members = _Members.of(pixels)
    chosen = members.pixels
    nearest, ranges_m, farthest = members.quantiles(pixels.ranges_m[chosen], (0.1, 0.5, 0.9))
    rights, lefts = members.quantiles(pixels.bearings[chosen], (0.03, 0.97))
    (heights_m,) = members.quantiles(pixels.above_m[chosen], (0.95,))
    counts = members.counts
    return RockSegments(
        counts,
        ranges_m,
        lefts,
        rights,
        heights_m,
        members.means(pixels.least_m[chosen] * np.array(LEVELS)[members.levels]),
        farthest - nearest,
        _shadows(raster, pixels, members, heights_m),
        _sides(pixels, members, heights_m),
        members.means(pixels.spreads_m[chosen]),
        members.means(pixels.range_sigmas_m[chosen]),
        counts / (members.lengths(pixels.rows[chosen]) * members.lengths(pixels.columns[chosen])),
        members.means(_at_edge(pixels)[chosen]) * np.sqrt(counts),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Members:
    """Pixels (n,) of all parts in the parts' order; a pixel comes once a level.

    `owners` and `levels` (n,) say of which part; `starts` and `counts` (k,) where each begins.
    """

    pixels: IntArray
    owners: IntArray
    levels: IntArray
    starts: IntArray
    counts: IntArray

    @classmethod
    def of(cls, pixels: StandingPixels) -> "_Members":
        levels, chosen = np.nonzero(pixels.parts >= 0)
        owners = pixels.parts[levels, chosen]
        order = np.argsort(owners, kind="stable")
        counts = np.bincount(owners)
        starts = np.cumsum(counts) - counts
        return cls(chosen[order], owners[order], levels[order], starts, counts)

    def quantiles(self, values: FloatArray, shares: tuple[float, ...]) -> list[FloatArray]:
        """Of each part the value (k,) that such a share of its pixels is below."""
        low = values.min(initial=0.0)
        scale = 2.0 * (values.max(initial=1.0) - low) + 1.0
        # One sort for all parts: the part before the point, the value behind it.
        ordered = (np.sort(self.owners + (values - low) / scale) - self.owners) * scale + low
        return [
            ordered[self.starts + np.round(share * (self.counts - 1)).astype(np.int64)]
            for share in shares
        ]

    def means(self, values: FloatArray | BoolArray) -> FloatArray:
        """(k,)."""
        return np.asarray(np.bincount(self.owners, values, len(self.counts)) / self.counts)

    def lengths(self, indices: IntArray) -> IntArray:
        """(k,) from the first of rows or columns to the last."""
        if not len(self.starts):
            return np.zeros(0, dtype=np.int64)
        last = np.maximum.reduceat(indices, self.starts)
        return np.asarray(last - np.minimum.reduceat(indices, self.starts) + 1)


@dataclass(frozen=True, slots=True, eq=False)
class _Rim:
    """Pairs (n,) of a pixel at the rim of a part and one outside; indices into an image."""

    owners: IntArray
    inside: tuple[IntArray, IntArray]
    outside: tuple[IntArray, IntArray]


def _rim(pixels: StandingPixels, members: _Members, up: int, right: int) -> _Rim:
    """Where so many pixels up and to the right of a part's pixel is another part, or none."""
    shape = pixels.above_image_m.shape
    numbers = np.full(shape, len(pixels.rows))
    numbers[pixels.rows, pixels.columns] = np.arange(len(pixels.rows))
    parts = np.pad(pixels.parts, ((0, 0), (0, 1)), constant_values=-1)
    rows, columns = pixels.rows[members.pixels], pixels.columns[members.pixels]
    beyond_rows, beyond_columns = rows - up, columns + right
    valid = np.flatnonzero((beyond_rows >= 0) & (beyond_columns >= 0) & (beyond_columns < shape[1]))
    beyond = numbers[beyond_rows[valid], beyond_columns[valid]]
    rim = valid[parts[members.levels[valid], beyond] != members.owners[valid]]
    return _Rim(
        members.owners[rim],
        (rows[rim], columns[rim]),
        (beyond_rows[rim], beyond_columns[rim]),
    )


def _shadows(
    raster: LevelledRaster, pixels: StandingPixels, members: _Members, heights_m: FloatArray
) -> FloatArray:
    """(k,) means over the upper rim, each between 0 and 1.5; no return is far."""
    rim = _rim(pixels, members, _BEYOND, 0)
    share = heights_m[rim.owners] / max(raster.height_m, _LEAST_SENSOR_HEIGHT_M)
    share = np.clip(share, 0.0, 0.9)
    here_m = raster.ranges_m[rim.inside]
    behind_m = np.nan_to_num(raster.ranges_m[rim.outside], nan=_FAR_M)
    # By similar triangles: a block of height h at r hides r h / (H - h).
    hidden = (behind_m - here_m) * (1.0 - share) / (here_m * share)
    return _means(np.clip(hidden, 0.0, 1.5), rim.owners, len(heights_m))


def _sides(pixels: StandingPixels, members: _Members, heights_m: FloatArray) -> FloatArray:
    """(k,) means over both sides, each between -1 and 1."""
    image = pixels.above_image_m
    rims = [_rim(pixels, members, 0, right) for right in (-_BEYOND, _BEYOND)]
    drops = np.concatenate([image[rim.inside] - image[rim.outside] for rim in rims])
    owners = np.concatenate([rim.owners for rim in rims])
    known = np.isfinite(drops)
    drops, owners = drops[known], owners[known]
    return _means(np.clip(drops / heights_m[owners], -1.0, 1.0), owners, len(heights_m))


def _means(values: FloatArray, owners: IntArray, num: int) -> FloatArray:
    """(num,) 0 for none."""
    counts = np.bincount(owners, minlength=num)
    return np.asarray(np.bincount(owners, values, num) / np.maximum(counts, 1))


def _at_edge(pixels: StandingPixels) -> BoolArray:
    """(n,) whether a pixel is in the first or last row or column."""
    last_row, last_column = np.array(pixels.above_image_m.shape) - 1
    return np.asarray(
        np.isin(pixels.rows, (0, last_row)) | np.isin(pixels.columns, (0, last_column))
    )
