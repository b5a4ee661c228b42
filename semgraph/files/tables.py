"""Text files read with care: what is refused names its file, line and reason."""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal, DecimalException
from pathlib import Path

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError, SemgraphError
from sensors.files import read_bytes

_NS_PER_S = 1_000_000_000
_MAX_STAMP_S = 9_000_000_000
# What spreadsheets put before the first cell.
_MARK = "\ufeff"


@dataclass(frozen=True, slots=True)
class Row:
    """The cells of one line of a file, and where it stands (counted from 1)."""

    line: int
    cells: tuple[str, ...]


def read_text(path: Path) -> str:
    """A file's text, whatever is in it.

    Raises:
        InputError: there is no such file, it cannot be read, it is too large, or not UTF-8.
    """
    try:
        return read_bytes(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from error


def write_text(path: Path, text: str) -> None:
    """Writes a file; what UTF-8 cannot carry is written as an escape.

    Raises:
        SemgraphError: the file cannot be written.
    """
    try:
        path.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")
    except OSError as error:
        raise SemgraphError(f"{path}: cannot be written: {error.strerror}") from error


def read_csv_rows(path: Path, columns: Sequence[str]) -> list[Row]:
    """The rows below a header that must be `columns`, separated by commas; cells may be quoted.

    Raises:
        InputError: no or another header, or a row with another number of cells.
    """
    header, *rows = [*_csv_rows(path)] or [Row(1, ())]
    if header.cells != tuple(columns):
        came = repr(",".join(header.cells)[:80]) if header.cells else "an empty file"
        raise InputError(f"{path} line 1: expected the header {','.join(columns)}, got {came}")
    _check_widths(path, rows, len(columns))
    return rows


def read_csv_header(path: Path) -> tuple[str, ...]:
    """The cells of the first row, none of an empty file.

    Raises:
        InputError: unreadable, or no table.
    """
    return next(_csv_rows(path), Row(1, ())).cells


def _csv_rows(path: Path) -> Iterator[Row]:
    text = io.StringIO(read_text(path).removeprefix(_MARK), newline="")
    reader = csv.reader(text, strict=True, skipinitialspace=True)
    try:
        for cells in reader:
            if any(map(str.strip, cells)) or len(cells) > 1:
                yield Row(reader.line_num, tuple(cell.strip() for cell in cells))
    except csv.Error as error:
        raise InputError(f"{path} line {reader.line_num}: not CSV: {error}") from error


def read_spaced_rows(path: Path, width: int) -> list[Row]:
    """The rows of a file separated by blanks; lines that begin with # are comments.

    Raises:
        InputError: a row with another number of cells.
    """
    rows = [
        Row(number, tuple(line.split()))
        for number, line in enumerate(read_text(path).splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    _check_widths(path, rows, width)
    return rows


def column_floats(
    path: Path, rows: Sequence[Row], columns: slice, *, finite: bool = True
) -> FloatArray:
    """(n, k) numbers of some columns.

    Raises:
        InputError: a cell is no number, or not finite where that is asked for.
    """
    values = np.array(
        [[_number(path, row, cell) for cell in row.cells[columns]] for row in rows], dtype=float
    )
    if not rows:
        return np.empty((0, 0))
    bad = ~np.isfinite(values).all(axis=1)
    if finite and bad.any():
        line = rows[int(np.argmax(bad))].line
        raise InputError(f"{path} line {line}: expected finite numbers, got NaN or infinity")
    return values


def column_stamps_ns(path: Path, rows: Sequence[Row]) -> IntArray:
    """(n,) the first column, seconds as text, in whole nanoseconds without loss.

    Raises:
        InputError: no time, or times that do not increase.
    """
    stamps_ns = np.array([_stamp_ns(path, row) for row in rows], dtype=np.int64)
    backwards = np.diff(stamps_ns) <= 0
    if backwards.any():
        row = rows[int(np.argmax(backwards)) + 1]
        raise InputError(
            f"{path} line {row.line}: expected increasing times, got {row.cells[0]} again or later"
        )
    return stamps_ns


def stamp_text(stamp_ns: int) -> str:
    """Seconds with nine decimals, exact."""
    sign = "-" if stamp_ns < 0 else ""
    seconds, nanoseconds = divmod(abs(int(stamp_ns)), _NS_PER_S)
    return f"{sign}{seconds}.{nanoseconds:09d}"


def _stamp_ns(path: Path, row: Row) -> int:
    text = row.cells[0]
    try:
        seconds = Decimal(text)
    except DecimalException:
        raise InputError(f"{path} line {row.line}: expected seconds, got {text[:40]!r}") from None
    if not (seconds.is_finite() and abs(seconds) <= _MAX_STAMP_S):
        raise InputError(
            f"{path} line {row.line}: expected seconds within {_MAX_STAMP_S}, got {text[:40]!r}"
        )
    return round(seconds * _NS_PER_S)


def _number(path: Path, row: Row, text: str) -> float:
    try:
        return float(text.replace("_", "?"))
    except ValueError:
        raise InputError(f"{path} line {row.line}: expected a number, got {text[:40]!r}") from None


def _check_widths(path: Path, rows: Sequence[Row], width: int) -> None:
    for row in rows:
        if len(row.cells) != width:
            raise InputError(
                f"{path} line {row.line}: expected {width} values, got {len(row.cells)}"
            )
