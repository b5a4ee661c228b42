"""Triangles of neighbouring landmarks: found again by their sides, whatever the pose."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from semgraph.arrays import FloatArray, IntArray

_NUM_NEIGHBOURS: Final = 12
# Further than any two sides: triangles of other kinds are never near.
_OTHER_KINDS_M: Final = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Corners counter-clockwise from the longest side, so that a mirror image is another triangle.

    Attributes:
        corners: (t, 3) rows of the landmarks.
        sides_m: (t, 3) from each corner to the next.
        signatures: (t,) of the corners' kinds, in the same order.
    """

    corners: IntArray
    sides_m: FloatArray
    signatures: IntArray

    def __len__(self) -> int:
        return len(self.corners)

    def rolled(self, steps: int) -> "Triangles":
        """The same, begun `steps` corners later."""
        signatures = self.signatures
        for _ in range(steps):
            signatures = signatures % _BASE**2 * _BASE + signatures // _BASE**2
        return Triangles(
            np.roll(self.corners, -steps, axis=1), np.roll(self.sides_m, -steps, axis=1), signatures
        )

    def select(self, rows: IntArray) -> "Triangles":
        """Those of the rows (k,)."""
        return Triangles(self.corners[rows], self.sides_m[rows], self.signatures[rows])

    def spread(self, most: int) -> IntArray:
        """Rows of at most `most`, the widest of each landmark first."""
        order = np.argsort(-self._areas_m2(), kind="stable")
        first = self.corners.min(axis=1)[order]
        by_landmark = np.argsort(first, kind="stable")
        starts = np.searchsorted(first[by_landmark], first[by_landmark])
        ranks = np.empty(len(order), dtype=np.int64)
        ranks[by_landmark] = np.arange(len(order)) - starts
        rows: IntArray = order[np.argsort(ranks, kind="stable")[:most]]
        return rows

    def points(self) -> FloatArray:
        """(t, 4) near each other, in the largest difference, where the triangles are alike."""
        return np.column_stack([self.sides_m, _OTHER_KINDS_M * self.signatures])

    def _areas_m2(self) -> FloatArray:
        """(t,) by Heron."""
        half = 0.5 * self.sides_m.sum(axis=1)
        squares = half * (half[:, None] - self.sides_m).prod(axis=1)
        areas: FloatArray = np.sqrt(np.maximum(squares, 0.0))
        return areas


# More than there are kinds.
_BASE: Final = 8


def triangles_of(positions: FloatArray, kinds: IntArray, reach_m: float) -> Triangles:
    """Each landmark with any two of its nearest neighbours within reach, each triangle once.

    Args:
        positions: (n, 2) m, fewer than two million.
        kinds: (n,) codes of `Kind`.
        reach_m: how far a neighbour may be.
    """
    corners = _corners(positions, reach_m)
    places = positions @ (1.0, 1.0j)
    a, b, c = (places[corner] for corner in corners.T)
    clockwise = np.imag(np.conj(b - a) * (c - a)) < 0.0
    corners[clockwise, 1:] = corners[clockwise, :0:-1]
    b, c = np.where(clockwise, c, b), np.where(clockwise, b, c)
    sides_m = np.column_stack([np.abs(b - a), np.abs(c - b), np.abs(a - c)])
    order = (sides_m.argmax(axis=1)[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, order, axis=1)
    sides_m = np.take_along_axis(sides_m, order, axis=1)
    return Triangles(corners, sides_m, kinds[corners] @ np.array([_BASE**2, _BASE, 1]))


def _corners(positions: FloatArray, reach_m: float) -> IntArray:
    """(t, 3) rows, ascending in each triangle."""
    n = len(positions)
    if n < 3:
        return np.zeros((0, 3), dtype=np.int64)
    k = min(_NUM_NEIGHBOURS, n - 1)
    _, near = KDTree(positions).query(positions, k + 1, distance_upper_bound=reach_m)
    first, second = np.triu_indices(k + 1, 1)
    own = np.repeat(np.arange(n), len(first))
    one, other = near[:, first].ravel(), near[:, second].ravel()
    low = np.minimum(np.minimum(own, one), other)
    high = np.maximum(np.maximum(own, one), other)
    middle = own + one + other - low - high
    is_one = (low < middle) & (middle < high) & (high < n)
    keys = ((low * n + middle) * n + high)[is_one]
    # Much quicker than np.unique, which hashes.
    keys.sort()
    keys = keys[np.append(True, keys[1:] != keys[:-1])] if len(keys) else keys
    return np.column_stack([keys // (n * n), keys // n % n, keys % n]).astype(np.int64)


class TriangleIndex:
    """The triangles of a map by their sides."""

    def __init__(self, positions: FloatArray, kinds: IntArray, reach_m: float) -> None:
        self._triangles = triangles_of(positions, kinds, reach_m)
        self._tree = KDTree(self._triangles.points(), balanced_tree=False)

    def matches(
        self, seen: Triangles, tolerances_m: FloatArray, most: int
    ) -> tuple[IntArray, IntArray]:
        """(c, 3) corners seen and (c, 3) corners mapped whose triangles have the same sides.

        The rarest first, and of those all that are alike, until there are `most`.

        Args:
            seen: t of them.
            tolerances_m: (t,) by how much sides may differ.
            most: about how many matches are enough.
        """
        nothing = np.zeros((0, 3), dtype=np.int64)
        if len(seen) == 0 or len(self._triangles) == 0:
            return nothing, nothing
        seen, tolerances_m = _rolled_where_sides_tie(seen, tolerances_m)
        points = seen.points()
        counts = self._tree.query_ball_point(points, tolerances_m, p=np.inf, return_length=True)
        rows = np.flatnonzero(counts)
        rows = rows[np.argsort(counts[rows], kind="stable")]
        before = np.cumsum(counts[rows]) - counts[rows]
        rows = rows[before < most]
        if len(rows) == 0:
            return nothing, nothing
        found = self._tree.query_ball_point(points[rows], tolerances_m[rows], p=np.inf)
        mapped = self._triangles.corners[np.concatenate(found).astype(np.int64)]
        return np.repeat(seen.corners[rows], counts[rows], axis=0), mapped


def _rolled_where_sides_tie(
    seen: Triangles, tolerances_m: FloatArray
) -> tuple[Triangles, FloatArray]:
    """All beginnings of each triangle whose first side may be the longest one in the map."""
    rolls, tolerances = [], []
    for steps in range(3):
        rolled = seen.rolled(steps)
        shortfall = rolled.sides_m.max(axis=1) - rolled.sides_m[:, 0]
        kept = np.flatnonzero(shortfall <= 2.0 * tolerances_m)
        rolls.append(rolled.select(kept))
        tolerances.append(tolerances_m[kept])
    together = Triangles(
        np.concatenate([each.corners for each in rolls]),
        np.concatenate([each.sides_m for each in rolls]),
        np.concatenate([each.signatures for each in rolls]),
    )
    return together, np.concatenate(tolerances)
