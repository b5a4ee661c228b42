"""Points by name in square cells: what is near is found without a look at all."""

from collections.abc import Iterator
from typing import final

from semgraph.arrays import FloatArray


@final
class PointGrid:
    """Names of points, by the cell that each lies in.

    Args:
        cell_m: side of a cell; about the radius that is asked for is best.
    """

    def __init__(self, cell_m: float) -> None:
        self._cell_m = cell_m
        self._names: dict[tuple[int, int], set[int]] = {}
        self._cells: dict[int, tuple[int, int]] = {}

    def __len__(self) -> int:
        return len(self._cells)

    def __contains__(self, name: int) -> bool:
        return name in self._cells

    def put(self, name: int, point: FloatArray) -> None:
        """It lies at this point (2,) from now on."""
        cell = self._cell(float(point[0]), float(point[1]))
        before = self._cells.get(name)
        if cell == before:
            return
        if before is not None:
            self._leave(name, before)
        self._cells[name] = cell
        self._names.setdefault(cell, set()).add(name)

    def remove(self, name: int) -> None:
        """It is no longer there.

        Raises:
            KeyError: it never was.
        """
        self._leave(name, self._cells.pop(name))

    def around(self, point: FloatArray, radius_m: float) -> list[int]:
        """All names within the radius of a point (2,), and some a cell farther; ascending."""
        return sorted(
            name for cell in self._cells_around(point, radius_m) for name in self._names[cell]
        )

    def _cells_around(self, point: FloatArray, radius_m: float) -> Iterator[tuple[int, int]]:
        x, y = float(point[0]), float(point[1])
        low, high = self._cell(x - radius_m, y - radius_m), self._cell(x + radius_m, y + radius_m)
        if (high[0] - low[0] + 1) * (high[1] - low[1] + 1) > len(self._names):
            yield from (
                cell
                for cell in self._names
                if low[0] <= cell[0] <= high[0] and low[1] <= cell[1] <= high[1]
            )
            return
        for column in range(low[0], high[0] + 1):
            for row in range(low[1], high[1] + 1):
                if (column, row) in self._names:
                    yield column, row

    def _leave(self, name: int, cell: tuple[int, int]) -> None:
        names = self._names[cell]
        names.discard(name)
        if not names:
            del self._names[cell]

    def _cell(self, x: float, y: float) -> tuple[int, int]:
        return int(x // self._cell_m), int(y // self._cell_m)
