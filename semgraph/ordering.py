"""Leaves out measurements whose times do not run forwards with the others'."""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from sensors.measurements import Measurement

# What most of so many that follow contradict is wrong itself.
_WITNESSES: Final = 15


@dataclass(slots=True)
class InOrder:
    """Iterates over measurements in order of time; those that break it are left out and counted.

    One behind the last is left out. So is one that is ahead of most that follow: a clock that
    jumped for a moment must not cost all that comes after.
    """

    measurements: Iterable[Measurement]
    num_left_out: int = 0

    def __iter__(self) -> Iterator[Measurement]:
        window = deque[Measurement]()
        last_ns: int | None = None
        for measurement in self._padded():
            if measurement is not None:
                window.append(measurement)
                if len(window) <= _WITNESSES:
                    continue
            if not window:
                return
            first = window.popleft()
            is_behind = last_ns is not None and first.stamp_ns < last_ns
            num_before = sum(each.stamp_ns < first.stamp_ns for each in window)
            if is_behind or 2 * num_before > len(window):
                self.num_left_out += 1
                continue
            last_ns = first.stamp_ns
            yield first

    @property
    def events(self) -> tuple[str, ...]:
        """How many were left out, in a line; nothing where none was."""
        if not self.num_left_out:
            return ()
        return (f"left out for times that do not run forwards: {self.num_left_out} measurements",)

    def _padded(self) -> Iterator[Measurement | None]:
        """All, and as many nothings as it takes to empty the window."""
        yield from self.measurements
        yield from [None] * (_WITNESSES + 1)
