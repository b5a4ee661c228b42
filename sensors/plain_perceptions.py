"""The table `perceptions.csv` of a plain recording folder.

A row with a time and nothing else says that nothing was perceived then.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import SemgraphError
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.plain_header import PerceptionDefaults
from sensors.stamps import seconds
from sensors.text_table import Row, TextTable, write_csv

PERCEPTIONS_FILE = "perceptions.csv"
PERCEPTION_COLUMNS = ("stamp_s", "kind", "range_m", "bearing_rad")
OPTIONAL_PERCEPTION_COLUMNS = (
    *("range_sigma_m", "bearing_sigma_rad", "diameter_m", "diameter_sigma_m"),
    *("identity", "reliability", "common_share"),
)

DIAMETER_SIGMA_OF_LN = 0.24
"""Of diameters without sigma: sd(ln d) within single trees, as of Victoria Park's detections."""
LARGEST_M = 1e7
LONGEST_IDENTITY = 64


def perception_sets(table: TextTable, defaults: PerceptionDefaults) -> list[Perceptions]:
    """The perceptions by stamp; rows with the same stamp form one set.

    Raises:
        InputError: a cell out of its domain, or a time that runs backwards.
    """
    if not len(table):
        return []
    stamps = table.stamps_ns("stamp_s", repeats=True)
    kinds = kind_codes(table, or_none=True)
    is_something = kinds >= 0
    everything = _all_perceptions(table, kinds, defaults)
    groups = np.split(np.arange(len(table)), np.flatnonzero(np.diff(stamps)) + 1)
    rows_of_something = np.cumsum(is_something) - 1
    return [
        replace(
            everything.select(rows_of_something[rows[is_something[rows]]]),
            stamp_ns=int(stamps[rows[0]]),
        )
        for rows in groups
    ]


def kind_codes(table: TextTable, *, or_none: bool = False) -> IntArray:
    """(n,) codes of Kind; with `or_none`, -1 where the cell is empty.

    Raises:
        InputError: an unknown kind.
    """
    codes = {kind.label: int(kind) for kind in Kind} | ({"": -1} if or_none else {})
    kinds = np.array([codes.get(cell, -2) for cell in table.text("kind")], dtype=np.int64)
    table.refuse(kinds == -2, "kind", f"one of {', '.join(kind.label for kind in Kind)}")
    return kinds


def _all_perceptions(
    table: TextTable, kinds: IntArray, defaults: PerceptionDefaults
) -> Perceptions:
    """The perceptions of all times in one value."""
    has = kinds >= 0
    ranges_m = table.numbers("range_m", above=0.0, at_most=LARGEST_M, or_none=True)
    bearings = table.numbers("bearing_rad", above=-1e4, at_most=1e4, or_none=True)
    for name, values in (("range_m", ranges_m), ("bearing_rad", bearings)):
        table.refuse(has & np.isnan(values), name, "a number beside a kind")
        table.refuse(~has & ~np.isnan(values), name, "nothing where there is no kind")
    diameters_m = positive_or(table, "diameter_m", np.nan)
    diameter_sigmas_m = positive_or(table, "diameter_sigma_m", DIAMETER_SIGMA_OF_LN * diameters_m)
    diameter_sigmas_m[np.isnan(diameters_m)] = np.nan
    return Perceptions(
        0,
        kinds[has],
        ranges_m[has],
        bearings[has],
        polar_covariances(
            positive_or(table, "range_sigma_m", defaults.range_sigma_m)[has],
            positive_or(table, "bearing_sigma_rad", defaults.bearing_sigma_rad)[has],
        ),
        diameters_m[has],
        diameter_sigmas_m[has],
        _identities(table)[has],
        _share(table, "reliability", 1.0)[has],
        _share(table, "common_share", 0.0)[has],
    )


def positive_or(table: TextTable, name: str, default: float | FloatArray) -> FloatArray:
    """(n,) a column of positive numbers; the default where the column or the cell is empty.

    Raises:
        InputError: a cell is no positive number.
    """
    if name not in table.columns:
        return np.broadcast_to(np.asarray(default, dtype=np.float64), (len(table),)).copy()
    # Below 1 um a covariance is lost in rounding, above 1e5 it overflows nothing yet.
    values = table.numbers(name, above=1e-6, at_most=1e5, or_none=True)
    return np.where(np.isnan(values), default, values)


def _identities(table: TextTable) -> NDArray[np.str_]:
    if "identity" not in table.columns:
        return np.full(len(table), "")
    names = table.text("identity")
    is_long = np.array([len(name) > LONGEST_IDENTITY for name in names], dtype=np.bool_)
    table.refuse(is_long, "identity", f"at most {LONGEST_IDENTITY} characters")
    return np.array(names, dtype=np.str_)


def _share(table: TextTable, name: str, default: float) -> FloatArray:
    """(n,) a column of numbers from 0 to 1; the default where the column or the cell is empty."""
    if name not in table.columns:
        return np.full(len(table), default)
    values = table.numbers(name, at_most=1.0, or_none=True)
    table.refuse(values < 0.0, name, "a number from 0 to 1")
    return np.where(np.isnan(values), default, values)


def write_perceptions(file: Path, sets: Iterable[Perceptions]) -> None:
    """Writes sets in the order of time; correlations of range and bearing have no place in it.

    Raises:
        SemgraphError: the file cannot be written.
    """
    rows = (row for perceptions in sets for row in perception_rows(perceptions))
    try:
        write_csv(file, (*PERCEPTION_COLUMNS, *OPTIONAL_PERCEPTION_COLUMNS), rows)
    except OSError as error:
        raise SemgraphError(f"{file}: cannot be written: {error.strerror}") from error


def perception_rows(perceptions: Perceptions) -> Iterator[Row]:
    """The rows of one set, in the order of all columns; one bare row if it is empty."""
    stamp = seconds(perceptions.stamp_ns)
    if not len(perceptions):
        yield (stamp, *[""] * (len(PERCEPTION_COLUMNS) + len(OPTIONAL_PERCEPTION_COLUMNS) - 1))
    sigmas = np.sqrt(perceptions.covariances[:, [0, 1], [0, 1]]).tolist()
    for k, kind in enumerate(perceptions.kinds.tolist()):
        yield (
            stamp,
            Kind(kind).label,
            float(perceptions.ranges_m[k]),
            float(perceptions.bearings[k]),
            *sigmas[k],
            number_or_blank(float(perceptions.diameters_m[k])),
            number_or_blank(float(perceptions.diameter_sigmas_m[k])),
            str(perceptions.identities[k]),
            float(perceptions.reliabilities[k]),
            float(perceptions.common_shares[k]),
        )


def number_or_blank(value: float) -> float | str:
    """The number of a cell; NaN is written as nothing."""
    return "" if np.isnan(value) else value
