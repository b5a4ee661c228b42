"""Text files read with care: what is refused names its file, line and reason."""

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, DecimalException
from pathlib import Path

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError, SemgraphError

_NS_PER_S = 1_000_000_000
_MAX_STAMP_S = 9_000_000_000


@dataclass(frozen=True, slots=True)
class Row:
    """The cells of one line of a file, and where it stands (counted from 1)."""

    line: int
    cells: tuple[str, ...]


def read_text(path: Path) -> str:
    """A file's text.

    Raises:
        InputError: there is no such file, it cannot be read, or it is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: expected a file, there is none") from None
    except (OSError, UnicodeDecodeError) as error:
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
    """The rows below a header that must be `columns`, separated by commas.

    Raises:
        InputError: no or another header, or a row with another number of cells.
    """
    lines = read_text(path).splitlines()
    header = ",".join(columns)
    if not lines or lines[0].strip() != header:
        came = repr(lines[0][:80]) if lines else "an empty file"
        raise InputError(f"{path} line 1: expected the header {header}, got {came}")
    rows = [
        Row(number, tuple(cell.strip() for cell in line.split(",")))
        for number, line in enumerate(lines[1:], start=2)
        if line.strip()
    ]
    _check_widths(path, rows, len(columns))
    return rows


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
