"""Where the corners of black squares lie in an image, to a small part of a pixel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import BoolArray, FloatArray

_ROUNDS = 3
_ALONG = np.linspace(0.06, 0.94, 32)
"""Samples of an edge, as shares of it; the corners themselves are rounded off by any blur."""
_ACROSS = np.linspace(-1.0, 1.0, 17)
_SHARE_OF_CELL = 0.6
_MAX_REACH_PX = 3.0
_SMEAR = 2.7
_CLIPPED = 252.0


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Of n squares; NaN where no square could be fitted.

    Attributes:
        corners_px: (n, 4, 2).
        sigmas_px: (n,) of a corner's coordinate, from noise and blur.
        misfits_px: (n,) RMS distance of the edges' samples from straight lines.
        are_overexposed: (n,) the white about it is clipped, so that black looks smaller.
    """

    corners_px: FloatArray
    sigmas_px: FloatArray
    misfits_px: FloatArray
    are_overexposed: BoolArray


def refine_corners(
    grey: NDArray[np.uint8], rough_px: FloatArray, num_cells: int, blur_px: float
) -> Corners:
    """Corners where straight lines through the four edges cross.

    Across an edge, the black's share of the light's integral says where the edge lies, however
    blurred: corners found by the image's gradient lie inside of blurred ones. The samples keep to
    the black frame and the white around it, both one of `num_cells` wide.

    Args:
        grey: (h, w).
        rough_px: (n, 4, 2) columns and rows within half a cell or so.
        num_cells: along an edge of the square.
        blur_px: sigma of what makes the image unsharp, the pixels' own size included.
    """
    from scipy.ndimage import map_coordinates, spline_filter

    # Linear interpolation is biased alike along an edge that keeps to the pixels' rows.
    spline = spline_filter(grey.astype(np.float64), mode="nearest")
    corners: FloatArray = rough_px.astype(np.float64)
    for _ in range(_ROUNDS):
        ends = np.roll(corners, -1, axis=1)
        lengths = np.maximum(np.linalg.norm(ends - corners, axis=2, keepdims=True), 1e-6)
        along = (ends - corners) / lengths
        outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
        cells_px = _cells_px(corners, outward, num_cells)
        reach = np.clip(_SHARE_OF_CELL * cells_px, 0.1, _MAX_REACH_PX)
        starts = corners[:, :, None] + _ALONG[:, None] * (ends - corners)[:, :, None]
        across = _ACROSS * reach[..., None]
        points = starts[..., None, :] + across[:, :, None, :, None] * outward[:, :, None, None]
        levels = map_coordinates(
            spline, np.moveaxis(points, -1, 0)[::-1], mode="nearest", prefilter=False
        )
        offsets = _edge_offsets(levels) * reach[..., None]
        lines, misfits = _fitted_lines(offsets, lengths[..., 0])
        corners = _crossings(0.5 * (corners + ends), along, outward, lines)
    # The line's end strays 5 / n times the variance of a sample; at most one sample a pixel counts.
    noises = misfits * np.sqrt(5.0 / np.minimum(lengths.mean(axis=(1, 2)), len(_ALONG)))
    # What blur mixes in from the next cells; fits blurs of 0.5 to 1 px, cells of 1.6 to 5 px.
    smears = _SMEAR * blur_px * (blur_px / cells_px.min(axis=1)) ** 3
    whites = np.median(levels[..., -1], axis=2).max(axis=1)
    return Corners(corners, np.hypot(noises, smears), misfits, whites >= _CLIPPED)


def _cells_px(corners: FloatArray, outward: FloatArray, num_cells: int) -> FloatArray:
    """(n, 4) how deep a cell at each edge is as it is seen.

    Depths shrink with the square of the distance, edges with the distance.
    """
    opposite = np.roll(corners, -2, axis=1) - corners
    before = np.roll(corners, 1, axis=1) - corners
    depths = -0.5 * np.einsum("nki,nki->nk", opposite + before, outward)
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    farness = np.maximum(np.roll(lengths, 2, axis=1), 1e-6) / np.maximum(lengths, 1e-6)
    return np.asarray(np.maximum(depths / num_cells / farness, 0.1))


def _edge_offsets(levels: FloatArray) -> FloatArray:
    """(n, 4, m) in [-1, 1]: where the edge lies between the ends of each profile (n, 4, m, t)."""
    black = np.median(levels[..., :2].mean(axis=3), axis=2)[..., None, None]
    white = np.median(levels[..., -2:].mean(axis=3), axis=2)[..., None, None]
    light = np.clip((levels - black) / np.maximum(white - black, 1.0), -0.5, 1.5)
    return np.asarray(1.0 - np.trapezoid(light, _ACROSS, axis=-1))


def _fitted_lines(offsets: FloatArray, lengths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 4, 2) offset and slope of each edge by least squares; (n,) RMS of what is left."""
    design = np.stack(
        [np.broadcast_to(1.0, offsets.shape), (_ALONG - 0.5) * lengths[..., None]], axis=-1
    )
    lines = np.stack(
        [
            offsets.mean(axis=-1),
            np.sum(offsets * design[..., 1], axis=-1) / np.sum(design[..., 1] ** 2, axis=-1),
        ],
        axis=-1,
    )
    residuals = offsets - np.einsum("nkmi,nki->nkm", design, lines)
    return lines, np.sqrt(np.mean(residuals**2, axis=(1, 2)))


def _crossings(
    middles: FloatArray, along: FloatArray, outward: FloatArray, lines: FloatArray
) -> FloatArray:
    """(n, 4, 2) where each edge's line crosses the one before it; NaN for parallels."""
    points = middles + lines[..., :1] * outward
    ways = along + lines[..., 1:] * outward
    other_points, other_ways = np.roll(points, 1, axis=1), np.roll(ways, 1, axis=1)
    sines = _cross(ways, other_ways)
    steps = _cross(other_points - points, other_ways) / np.where(
        np.abs(sines) < 1e-3, np.nan, sines
    )
    return np.asarray(points + steps[..., None] * ways)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
