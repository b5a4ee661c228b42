"""The numbers of the scans that a thing was sighted in: as runs, for there are millions."""

from array import array
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Self, final


@final
class ScanSet:
    """Scan numbers, each once, ascending; eight bytes a run of them without a gap."""

    __slots__ = ("_num", "_runs")

    def __init__(self, scans: Iterable[int] = ()) -> None:
        self._become(set(scans))

    def __len__(self) -> int:
        return self._num

    def __iter__(self) -> Iterator[int]:
        return chain.from_iterable(range(first, last + 1) for first, last in self.runs())

    def __contains__(self, scan: int) -> bool:
        return self.touches(scan, scan)

    @property
    def first(self) -> int:
        """The earliest; IndexError if there is none."""
        return self._runs[0]

    @property
    def last(self) -> int:
        """The latest; IndexError if there is none."""
        return self._runs[-1]

    def runs(self) -> Iterator[tuple[int, int]]:
        """First and last scan of each run without a gap."""
        return zip(self._runs[::2], self._runs[1::2], strict=True)

    def copy(self) -> Self:
        """The same scans, to go on with."""
        return type(self)(self)

    def add(self, scan: int) -> None:
        """One more scan, or one that was counted already."""
        if not self._num or scan > self._runs[-1]:
            self._append(scan)
        elif scan not in self:
            self._become({*self, scan})

    def difference_update(self, others: Iterable[int]) -> None:
        """Not those."""
        self._become({*self}.difference(others))

    def update(self, other: Iterable[int]) -> None:
        """All of both."""
        self._become({*self, *other})

    def touches(self, low: int, high: int) -> bool:
        """Whether there is any from `low` to `high`."""
        position = bisect_left(self._runs, low)
        is_in_run = position % 2 == 1
        return is_in_run or (position < len(self._runs) and self._runs[position] <= high)

    def isdisjoint(self, other: "ScanSet") -> bool:
        """Whether no scan is in both."""
        few, many = sorted((self, other), key=len)
        if not few or few.last < many.first or many.last < few.first:
            return True
        return not any(many.touches(first, last) for first, last in few.runs())

    def _append(self, scan: int) -> None:
        """A scan later than all."""
        if self._num and scan == self._runs[-1] + 1:
            self._runs[-1] = scan
        else:
            self._runs.extend((scan, scan))
        self._num += 1

    def _become(self, scans: set[int]) -> None:
        """It is these now."""
        # First and last of each run by turns.
        self._runs = array("I")
        self._num = 0
        for scan in sorted(scans):
            self._append(scan)
