"""Times in files as integer nanoseconds, checked to run forwards, and back."""

from decimal import Decimal
from pathlib import Path

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError

MAX_SECONDS = 9.0e9


def stamps_ns(path: Path, name: str, times: FloatArray) -> IntArray:
    """The times (n,) of a file in ns.

    Args:
        path: the file, for the error.
        name: the column, for the error.
        times: (n,) s.

    Raises:
        InputError: a time is out of range or does not follow the one before.
    """
    if not (np.abs(times) <= MAX_SECONDS).all():
        raise InputError(f"{path}: {name}: expected times within {MAX_SECONDS:g} s")
    stamps: IntArray = np.rint(times * 1e9).astype(np.int64)
    steps = np.diff(stamps)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        record = back[0] + 1
        raise InputError(
            f"{path}: {name}: expected times to increase, record {record + 1} has "
            f"{times[record]:.9g} s after {times[record - 1]:.9g} s"
        )
    return stamps


def seconds(stamp_ns: int) -> str:
    """The seconds of a stamp, exact, as files have them."""
    return f"{Decimal(stamp_ns).scaleb(-9):f}"
