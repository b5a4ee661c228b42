"""The local ground below levelled points, with rocks on it."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray

CELL_M: Final = 0.25
_WIDTHS_M: Final = (1.6, 1.0, 0.5)
_ROUNDS: Final = 2
_STANDS_OUT: Final = 2.0
_LEAST_SPREAD_M: Final = 0.01
_MAD_TO_SIGMA: Final = 1.4826


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Heights on a grid of square cells, columns along x and rows along y.

    `corner_m` is x and y of the middle of the first cell.
    """

    corner_m: tuple[float, float]
    heights_m: FloatArray

    def below(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Heights (k,) at points (k,), bilinear; beyond the grid those of its edge."""
        columns, rows = self.heights_m.shape
        i = np.clip((x - self.corner_m[0]) / CELL_M, 0.0, columns - 1.001)
        j = np.clip((y - self.corner_m[1]) / CELL_M, 0.0, rows - 1.001)
        i0, j0 = i.astype(np.int64), j.astype(np.int64)
        di, dj = i - i0, j - j0
        flat, first = self.heights_m.ravel(), i0 * rows + j0
        near = flat[first] + dj * (flat[first + 1] - flat[first])
        far = flat[first + rows] + dj * (flat[first + rows + 1] - flat[first + rows])
        return np.asarray(near + di * (far - near))


def fit_ground(x: FloatArray, y: FloatArray, z: FloatArray) -> Ground:
    """The ground of points (k,), k > 0.

    Of each cell the mean of its lower points; these smoothed from coarse to fine, each time with
    the less weight the more a cell stands out of what is coarser.
    """
    corner = np.array([x.min(), y.min()]) - CELL_M
    i = ((x - corner[0]) / CELL_M).astype(np.int64)
    j = ((y - corner[1]) / CELL_M).astype(np.int64)
    shape = (int(i.max()) + 2, int(j.max()) + 2)
    lows_m, counts = _lower_points(i * shape[1] + j, z, shape)
    heights_m = np.full(shape, np.average(lows_m, weights=counts))
    for width_m in _WIDTHS_M:
        for _ in range(_ROUNDS):
            weights = np.minimum(counts, 5.0) * _trust(lows_m - heights_m, counts > 0.0)
            heights_m = heights_m + _smooth(lows_m - heights_m, weights, width_m / CELL_M)
    return Ground((float(corner[0] + 0.5 * CELL_M), float(corner[1] + 0.5 * CELL_M)), heights_m)


def _lower_points(
    cells: IntArray, z: FloatArray, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Of each cell the mean of the points below its mean, and their number; 0 and 0 for none."""
    size = shape[0] * shape[1]
    means = np.bincount(cells, z, size) / np.maximum(np.bincount(cells, minlength=size), 1)
    low = z <= means[cells] + 1e-9
    counts = np.bincount(cells[low], minlength=size).astype(np.float64)
    lows_m = np.bincount(cells[low], z[low], size) / np.maximum(counts, 1.0)
    return lows_m.reshape(shape), counts.reshape(shape)


def _trust(above_m: FloatArray, known: BoolArray) -> FloatArray:
    """Weights in [0, 1]: what is above by far more than others are below is no ground."""
    below_m = above_m[known & (above_m < 0.0)]
    spread_m = _MAD_TO_SIGMA * float(np.median(-below_m)) if len(below_m) else 0.0
    limit_m = _STANDS_OUT * max(spread_m, _LEAST_SPREAD_M)
    return np.asarray(1.0 / (1.0 + np.maximum(above_m / limit_m, 0.0) ** 4))


def _smooth(values: FloatArray, weights: FloatArray, width_cells: float) -> FloatArray:
    from scipy.ndimage import gaussian_filter

    sums = gaussian_filter(values * weights, width_cells, mode="constant", truncate=3.0)
    total = gaussian_filter(weights, width_cells, mode="constant", truncate=3.0)
    return np.asarray(sums / np.maximum(total, 1e-9))
