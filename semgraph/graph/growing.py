"""Arrays that grow row by row: numbers of millions of things, a few bytes each."""

from array import array
from collections.abc import Iterator
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from semgraph.arrays import IntArray


@final
class Growing:
    """Rows of one shape and type, to which rows are appended.

    Args:
        shape: of a row.
        dtype: of its numbers.
    """

    def __init__(self, shape: tuple[int, ...] = (), dtype: DTypeLike = np.float64) -> None:
        self._rows: NDArray[Any] = np.empty((64, *shape), dtype=dtype)
        self._size = 0

    def __len__(self) -> int:
        return self._size

    @property
    def rows(self) -> NDArray[Any]:
        """(n, ...) all of them: a view, which the next `append` may leave behind."""
        return self._rows[: self._size]

    def append(self, row: ArrayLike) -> int:
        """The number of one row more."""
        if self._size == len(self._rows):
            # Four times as much: what is not yet written to takes no memory, and few old ones are
            # left behind as holes that nothing fits in.
            grown = np.empty((4 * self._size, *self._rows.shape[1:]), self._rows.dtype)
            grown[: self._size] = self._rows
            self._rows = grown
        self._rows[self._size] = row
        self._size += 1
        return self._size - 1


@final
class Ragged:
    """Rows of numbers below 2^31, each of a length of its own; four bytes a number."""

    def __init__(self) -> None:
        self._numbers, self._ends = array("i"), array("q", [0])

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __iter__(self) -> Iterator[IntArray]:
        for start, end in zip(self._ends[:-1], self._ends[1:], strict=True):
            yield np.array(self._numbers[start:end], dtype=np.int64)

    def append(self, numbers: IntArray) -> None:
        """One row more."""
        self._numbers.extend(numbers.tolist())
        self._ends.append(len(self._numbers))
