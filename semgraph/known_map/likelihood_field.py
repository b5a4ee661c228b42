"""The nearest landmark of every place of a map, looked up for very many poses at once."""

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray
from semgraph.known_map.fixed_map import FixedMap

REACH_M: Final = 1.5
_LEAST_CELL_M: Final = 0.25
_MOST_CELLS: Final = 4_000_000
# What fits into the processor's cache.
_AT_ONCE: Final = 16_384

Floats32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Perceptions prepared for the map.

    Attributes:
        base_t: (k, 2) m.
        kinds: (k,).
        covariances: (k, 2, 2) m2, in base, the map's own sigma included.
        log_clutter: (k,) log of the probability that it is of nothing in the map.
        diameters_m, diameter_sigmas_m: (k,) NaN where there is none.
        identities: (k,) text.
        usual: (k,) the density of such a diameter among the map's of its kind.
    """

    base_t: FloatArray
    kinds: IntArray
    covariances: FloatArray
    log_clutter: FloatArray
    diameters_m: FloatArray
    diameter_sigmas_m: FloatArray
    identities: NDArray[np.str_]
    usual: FloatArray

    def __len__(self) -> int:
        return len(self.base_t)

    @property
    def variances(self) -> FloatArray:
        """(k,) m2 per axis, the mean of all directions."""
        variances: FloatArray = 0.5 * np.trace(self.covariances, axis1=1, axis2=2)
        return variances

    def blurred(self, sigma_m: float, sigma_rad: float) -> "Seen":
        """As seen from a pose that is known no better than this."""
        far2 = np.square(self.base_t).sum(axis=1)
        more = sigma_m**2 + far2 * sigma_rad**2
        return replace(self, covariances=self.covariances + more[:, None, None] * np.eye(2))


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Of one kind: cells within reach of a landmark.

    Attributes:
        numbers: (rows * columns,) the cell's row in the others, 0 for none near.
        landmarks: (c,) nearest landmark.
        distances2_m2: (c,) from the cell's centre to it.
    """

    numbers: NDArray[np.int32]
    landmarks: IntArray
    distances2_m2: Floats32


@dataclass(frozen=True, slots=True)
class _Grid:
    """Where the cells lie: `low` is the corner of the first, `shape` (columns, rows)."""

    low: tuple[float, float]
    cell_m: float
    shape: tuple[int, int]

    @classmethod
    def over(cls, map_t_points: FloatArray) -> Self:
        low = map_t_points.min(axis=0) - REACH_M - _LEAST_CELL_M
        size = map_t_points.max(axis=0) + REACH_M + _LEAST_CELL_M - low
        cell_m = max(_LEAST_CELL_M, float(np.sqrt(np.prod(size) / _MOST_CELLS)))
        columns, rows = (np.ceil(size / cell_m) + 1).astype(int).tolist()
        return cls((float(low[0]), float(low[1])), cell_m, (columns, rows))


class LikelihoodField:
    """Log-likelihoods of poses as `pose_likelihood.PoseLikelihood`, but coarser.

    Only the nearest landmark within `REACH_M` counts, from the middle of its cell, and errors are
    alike in all directions.
    """

    def __init__(self, fixed_map: FixedMap) -> None:
        self._grid = _Grid.over(fixed_map.map_t_landmarks)
        self._variances = 0.5 * np.trace(fixed_map.covariances, axis1=1, axis2=2)
        self._cells = {
            kind: self._stamp(fixed_map.map_t_landmarks, np.flatnonzero(fixed_map.kinds == kind))
            for kind in set(fixed_map.kinds.tolist())
        }

    def log_likelihoods(
        self, seen: Seen, map_T_bases: FloatArray, log_weights: FloatArray
    ) -> FloatArray:
        """(n,) of poses (n, 3); weights (k, m) as of `PoseLikelihood.log_weights`."""
        tables = [self._table(seen, log_weights[k], k) for k in range(len(seen))]
        # In 64 bit first: of projected coordinates 32 leave half a metre.
        poses = (map_T_bases - np.append(self._grid.low, 0.0)).astype(np.float32)
        sums = np.zeros(len(poses), dtype=np.float32)
        for start in range(0, len(poses), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            self._add(seen, tables, poses[part], sums[part])
        return sums.astype(np.float64)

    def _add(
        self, seen: Seen, tables: list[Floats32 | None], poses: Floats32, sums: Floats32
    ) -> None:
        scale = np.float32(1.0 / self._grid.cell_m)
        c, s = np.cos(poses[:, 2]) * scale, np.sin(poses[:, 2]) * scale
        x, y = poses[:, 0] * scale, poses[:, 1] * scale
        columns, rows = self._grid.shape
        for k, table in enumerate(tables):
            if table is None:
                continue
            px, py = np.float32(seen.base_t[k, 0]), np.float32(seen.base_t[k, 1])
            column = np.clip(c * px - s * py + x, 0, columns - 1).astype(np.int32)
            row = np.clip(s * px + c * py + y, 0, rows - 1).astype(np.int32)
            numbers = self._cells[int(seen.kinds[k])].numbers
            sums += table[numbers[row * np.int32(columns) + column]]

    def _table(self, seen: Seen, log_weights: FloatArray, k: int) -> Floats32 | None:
        """(c,) the perception's log-likelihood by cell; None if the map has none of its kind."""
        cells = self._cells.get(int(seen.kinds[k]))
        if cells is None:
            return None
        own = self._variances + seen.variances[k] + self._grid.cell_m**2 / 12.0
        peaks = np.exp(log_weights) / (2.0 * np.pi * own)
        by_landmark = np.column_stack([peaks, -0.5 / own]).astype(np.float32)
        peak, fall = by_landmark[cells.landmarks].T
        clutter = np.float32(np.exp(seen.log_clutter[k]))
        table: Floats32 = np.log(clutter + peak * np.exp(fall * cells.distances2_m2))
        table[0] = seen.log_clutter[k]
        return table

    def _stamp(self, map_t_landmarks: FloatArray, landmarks: IntArray) -> _Cells:
        """Cells about each landmark, where two compete the nearer one's."""
        cell_m, (columns, rows) = self._grid.cell_m, self._grid.shape
        reach = int(np.ceil(REACH_M / cell_m))
        steps = np.arange(-reach, reach + 1)
        at = (map_t_landmarks[landmarks] - self._grid.low) / cell_m
        near = np.floor(at).astype(np.int64)
        # (landmarks, steps) from the cells' centres, and (landmarks, steps, steps) of both axes.
        x, y = (((near + 0.5 - at) * cell_m).T[:, :, None] + steps * cell_m) ** 2
        distances2 = y[:, :, None] + x[:, None]
        # The grid holds all cells within reach.
        owners, up, along = np.nonzero(distances2 <= REACH_M**2)
        distances2 = distances2[owners, up, along].astype(np.float32)
        index = (near[owners, 1] + steps[up]) * columns + near[owners, 0] + steps[along]
        least = np.full(columns * rows, np.inf, dtype=np.float32)
        np.minimum.at(least, index, distances2)
        is_nearest = distances2 == least[index]
        nearest = np.zeros(columns * rows, dtype=np.int64)
        nearest[index[is_nearest]] = landmarks[owners[is_nearest]]
        taken = np.flatnonzero(np.isfinite(least))
        numbers = np.zeros(columns * rows, dtype=np.int32)
        numbers[taken] = np.arange(1, len(taken) + 1)
        return _Cells(
            numbers,
            np.concatenate([landmarks[:1], nearest[taken]]),
            np.append(np.float32(np.inf), least[taken]),
        )
