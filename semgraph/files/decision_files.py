"""The decisions of a run as a table, for people, spreadsheets and `semgraph explain`."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from semgraph.decisions import Decision, What
from semgraph.errors import InputError
from semgraph.files.tables import Row, column_floats, read_csv_rows, write_text
from semgraph.landmarks import Kind

_COLUMNS: Final = ("scan", "landmark", "other", "log_odds", "what", "kind", "why")
_NUMBERS: Final = slice(0, 4)


def write_decisions(path: Path, decisions: Sequence[Decision]) -> None:
    """One line each, in order.

    Raises:
        SemgraphError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for each in decisions:
        numbers = (each.scan, each.landmark, each.other, each.log_odds)
        writer.writerow([*numbers, each.what.value, each.kind.label, each.why.replace(",", ";")])
    write_text(path, text.getvalue())


def read_decisions(path: Path) -> tuple[Decision, ...]:
    """What was decided in a run.

    Raises:
        InputError: the file is missing or malformed.
    """
    rows = read_csv_rows(path, _COLUMNS)
    numbers = column_floats(path, rows, _NUMBERS, finite=False)
    return tuple(_decision(path, row, values) for row, values in zip(rows, numbers, strict=True))


def _decision(path: Path, row: Row, numbers: Sequence[float]) -> Decision:
    *_, what, kind, why = row.cells
    try:
        scan, landmark, other = (int(number) for number in numbers[:3])
        decided = Decision(
            scan, What(what), Kind.from_label(kind), landmark, other, float(numbers[3]), why
        )
    except (ValueError, OverflowError, InputError) as error:
        raise InputError(f"{path} line {row.line}: expected a decision: {error}") from error
    return decided
