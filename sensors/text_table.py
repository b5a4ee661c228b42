"""Tables of text with named columns; whatever is wrong with one is an `InputError`."""

import csv
import io
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Self

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.errors import InputError, known_names
from sensors.files import read_text
from sensors.stamps import MAX_SECONDS

Row = tuple[str | float, ...]

MAX_TABLE_BYTES = 128 * 2**20
MAX_ROWS = 2_000_000
LARGEST = 1e10
"""No coordinate, time, range or angle of a recording is larger; squares stay far from overflow."""


@dataclass(frozen=True, slots=True, eq=False)
class TextTable:
    """The cells of a file by column, with the line (n,) that each row stands in."""

    path: Path
    lines: IntArray
    columns: dict[str, list[str]]

    def __len__(self) -> int:
        return len(self.lines)

    @classmethod
    def of_csv(cls, path: Path, required: Collection[str], optional: Collection[str] = ()) -> Self:
        """The table of a file with a header; columns come in any order.

        Raises:
            InputError: unreadable, a column unknown, missing or there twice, or a row too long or
                too short.
        """
        reader = csv.reader(io.StringIO(_bounded_text(path), newline=""), strict=True)
        try:
            header = [name.strip() for name in next(reader, [])]
            _check_header(path, header, required, optional)
            rows = [(reader.line_num, row) for row in reader if row]
        except csv.Error as error:
            raise InputError(f"{path}: line {reader.line_num}: not CSV: {error}") from error
        return cls._of_rows(path, header, rows)

    @classmethod
    def of_words(cls, path: Path, header: list[str]) -> Self:
        """The table of a file of words between blanks; lines that start with # are left out.

        Raises:
            InputError: unreadable, or a row of other length.
        """
        words = (line.split() for line in _bounded_text(path).splitlines())
        rows = [
            (number, row)
            for number, row in enumerate(words, start=1)
            if row and not row[0].startswith("#")
        ]
        return cls._of_rows(path, header, rows)

    @classmethod
    def _of_rows(cls, path: Path, header: list[str], rows: list[tuple[int, list[str]]]) -> Self:
        for line, row in rows:
            if len(row) != len(header):
                raise InputError(
                    f"{path}: line {line}: expected {len(header)} values, got {len(row)}"
                )
        cells = zip(*(row for _, row in rows), strict=True) if rows else ([] for _ in header)
        columns = {name: list(column) for name, column in zip(header, cells, strict=True)}
        return cls(path, np.array([line for line, _ in rows], dtype=np.int64), columns)

    def text(self, name: str) -> list[str]:
        """(n,) the cells of a column without the blanks around."""
        return [cell.strip() for cell in self.columns[name]]

    def numbers(
        self, name: str, *, above: float = -LARGEST, at_most: float = LARGEST, or_none: bool = False
    ) -> FloatArray:
        """(n,) the finite numbers of a column.

        Args:
            name: a column that is there.
            above: every number is greater.
            at_most: no number is greater.
            or_none: an empty cell is allowed and becomes NaN.

        Raises:
            InputError: a cell is no number, or out of its domain; the first such line is named.
        """
        cells = self.columns[name]
        if or_none:
            cells = [cell if cell.strip() else "nan" for cell in cells]
        values = np.array([_number(cell) for cell in cells], dtype=np.float64)
        good = np.isfinite(values) & (values > above) & (values <= at_most)
        if or_none:
            good |= np.array([not cell.strip() for cell in self.columns[name]], dtype=np.bool_)
        domain = f" above {above:g}" * (above > -LARGEST)
        domain += f" up to {at_most:g}" * (at_most < LARGEST)
        self.refuse(~good, name, f"a finite number{domain}")
        return values

    def stamps_ns(self, name: str, *, repeats: bool = False) -> IntArray:
        """(n,) the seconds of a column in ns, increasing, or at least not falling with `repeats`.

        Raises:
            InputError: no number, or a time that runs backwards; the first such line is named.
        """
        self.numbers(name, above=-MAX_SECONDS, at_most=MAX_SECONDS)
        # A float of seconds since 1970 is good to 240 ns only.
        exact = [round(Decimal(cell) * 10**9) for cell in self.columns[name]]
        stamps = np.array(exact, dtype=np.int64)
        steps = np.diff(stamps, prepend=stamps[:1] - 1)
        self.refuse(
            steps < 0 if repeats else steps <= 0,
            name,
            "times that do not run backwards" if repeats else "times that increase",
        )
        return stamps

    def refuse(self, bad: BoolArray, name: str, expected: str) -> None:
        """Raise an InputError that names the first bad row of a column, if there is one."""
        rows = np.flatnonzero(bad)
        if len(rows):
            cell = self.columns[name][rows[0]]
            raise InputError(
                f"{self.path}: line {self.lines[rows[0]]}: {name}: expected {expected}, "
                f"got {cell.strip()[:40]!r}"
            )


def write_csv(file: Path, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Writes a header and rows.

    Raises:
        OSError: the file cannot be written.
    """
    with file.open("w", newline="", encoding="utf-8") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def _bounded_text(path: Path) -> str:
    text = read_text(path, MAX_TABLE_BYTES)
    num_rows = text.count("\n")
    if num_rows > MAX_ROWS:
        raise InputError(f"{path}: expected at most {MAX_ROWS} lines, got {num_rows}")
    return text


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _check_header(
    path: Path, header: list[str], required: Collection[str], optional: Collection[str]
) -> None:
    known = [*required, *optional]
    for name in header:
        if name not in known:
            raise InputError(
                f"{path}: line 1: unknown column {name[:40]!r}, {known_names(name, known)}"
            )
        if header.count(name) > 1:
            raise InputError(f"{path}: line 1: column {name!r} stands there twice")
    for name in required:
        if name not in header:
            raise InputError(f"{path}: line 1: expected a column {name}, there is none")
