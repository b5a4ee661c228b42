"""The numbers of the scans that a thing was sighted in: four bytes each, for there are millions."""

from array import array
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from typing import final


@final
class ScanSet:
    """Scan numbers, each once, ascending."""

    def __init__(self, scans: Iterable[int] = ()) -> None:
        self._scans = array("I", sorted(set(scans)))

    def __len__(self) -> int:
        return len(self._scans)

    def __iter__(self) -> Iterator[int]:
        return iter(self._scans)

    def __contains__(self, scan: int) -> bool:
        return self.touches(scan, scan)

    @property
    def first(self) -> int:
        """The earliest; IndexError if there is none."""
        return self._scans[0]

    @property
    def last(self) -> int:
        """The latest; IndexError if there is none."""
        return self._scans[-1]

    def add(self, scan: int) -> None:
        """One more scan, or one that was counted already."""
        if not self._scans or scan > self._scans[-1]:
            self._scans.append(scan)
        elif scan not in self:
            self._scans.insert(bisect_left(self._scans, scan), scan)

    def discard(self, scan: int) -> None:
        """Not that one."""
        if scan in self:
            del self._scans[bisect_left(self._scans, scan)]

    def update(self, other: "ScanSet") -> None:
        """All of both."""
        self._scans = array("I", sorted({*self, *other}))

    def touches(self, low: int, high: int) -> bool:
        """Whether there is any from `low` to `high`."""
        position = bisect_left(self._scans, low)
        return position < len(self._scans) and self._scans[position] <= high

    def isdisjoint(self, other: "ScanSet") -> bool:
        """Whether no scan is in both."""
        few, many = sorted((self, other), key=len)
        if len(few) == 0 or few.last < many.first or many.last < few.first:
            return True
        return not any(scan in many for scan in few)
