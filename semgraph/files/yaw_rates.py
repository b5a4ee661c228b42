"""Yaw rates over time, as a device that turns with base measures them, and their file."""

from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from semgraph.files.tables import (
    column_floats,
    column_stamps_ns,
    read_csv_rows,
    stamp_text,
    write_text,
)

_COLUMNS = ("stamp_s", "yaw_rate_rad_s")


@dataclass(frozen=True, slots=True, eq=False)
class YawRates:
    """`rates` (n,) rad/s, counter-clockwise positive, at `stamps_ns` (n,) that increase.

    Raises:
        InputError: shapes disagree, not finite, or times that do not increase.
    """

    stamps_ns: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    rates: FloatArray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        object.__setattr__(self, "stamps_ns", frozen_ints("yaw rate stamps", self.stamps_ns, (n,)))
        object.__setattr__(self, "rates", frozen_floats("yaw rates", self.rates, (n,)))
        if n and not (np.diff(self.stamps_ns) > 0).all():
            raise InputError("yaw rates: expected strictly increasing stamps")

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(slots=True)
class YawRateLog:
    """Gathers yaw rates as they come; of two with one stamp the first counts."""

    _stamps_ns: "array[int]" = field(default_factory=lambda: array("q"))
    _rates: "array[float]" = field(default_factory=lambda: array("d"))

    def add(self, stamp_ns: int, rate: float) -> None:
        """The next one."""
        if not self._stamps_ns or stamp_ns > self._stamps_ns[-1]:
            self._stamps_ns.append(stamp_ns)
            self._rates.append(rate)

    def yaw_rates(self) -> YawRates:
        """All that came."""
        return YawRates(np.array(self._stamps_ns, dtype=np.int64), np.array(self._rates))


def write_yaw_rates(path: Path, yaw_rates: YawRates) -> None:
    """Writes `stamp_s,yaw_rate_rad_s`, both exactly.

    Raises:
        SemgraphError: the file cannot be written.
    """
    lines = [",".join(_COLUMNS)]
    for stamp_ns, rate in zip(yaw_rates.stamps_ns.tolist(), yaw_rates.rates.tolist(), strict=True):
        lines.append(f"{stamp_text(stamp_ns)},{rate!r}")
    write_text(path, "\n".join(lines) + "\n")


def read_yaw_rates(path: Path) -> YawRates:
    """The yaw rates of a file.

    Raises:
        InputError: missing or malformed, or times that do not increase.
    """
    rows = read_csv_rows(path, _COLUMNS)
    return YawRates(
        column_stamps_ns(path, rows), column_floats(path, rows, slice(1, None)).reshape(-1)
    )
