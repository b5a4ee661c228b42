"""The trials of a study as tables for other programs: a row a trial, a column a metric."""

import csv
import io
import os
import secrets
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from evaluation.studies.trial import Outcome
from semgraph.errors import SemgraphError

TRIALS_CSV: Final = "trials.csv"
TRIALS_PARQUET: Final = "trials.parquet"

# Spreadsheets take a text that begins so for a formula, and run it.
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r")

_Cell = str | int | float | None


def write_tables(folder: Path, outcomes: Sequence[Outcome]) -> None:
    """Writes `trials.csv` and `trials.parquet`, both or none; earlier ones are replaced.

    Raises:
        SemgraphError: the folder cannot be written.
    """
    columns = _columns(outcomes)
    write_files(
        folder,
        {
            TRIALS_CSV: lambda path: _write_csv(path, columns),
            TRIALS_PARQUET: lambda path: _write_parquet(path, columns),
        },
    )


def write_files(folder: Path, writers: dict[str, Callable[[Path], None]]) -> None:
    """Writes files beside their places first, and gives them their names when all are whole.

    Raises:
        SemgraphError: the folder cannot be written.
    """
    token = secrets.token_hex(4)
    staged = {name: folder / f".{name}.{token}" for name in writers}
    try:
        for name, write in writers.items():
            write(staged[name])
        for path in staged.values():
            _sync(path)
        for name, path in staged.items():
            path.replace(folder / name)
    except OSError as error:
        raise SemgraphError(
            f"{folder}: {' and '.join(writers)} cannot be written: {error.strerror or error}"
        ) from error
    finally:
        for path in staged.values():
            path.unlink(missing_ok=True)


def csv_cell(cell: _Cell) -> _Cell:
    """The cell, with an apostrophe before a text that a spreadsheet would run."""
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(_FORMULA) else cell


def _columns(outcomes: Sequence[Outcome]) -> dict[str, list[_Cell]]:
    """Each column's cells; a metric that a trial lacks is None."""
    columns: dict[str, list[_Cell]] = {
        "trial": [each.trial.id for each in outcomes],
        "study": [each.trial.study for each in outcomes],
        "condition": [each.trial.condition for each in outcomes],
        "source": [each.trial.source for each in outcomes],
        "options": [_assignments(each.trial.options) for each in outcomes],
        "settings": [_assignments(each.trial.settings) for each in outcomes],
        "estimator": [each.trial.estimator for each in outcomes],
        "seed": [each.trial.seed for each in outcomes],
        "status": [each.status.value for each in outcomes],
        "reason": [each.reason for each in outcomes],
        "trial_wall_s": [float(each.wall_s) for each in outcomes],
        "trial_cpu_s": [float(each.cpu_s) for each in outcomes],
        "trial_peak_memory_bytes": [each.peak_memory_bytes for each in outcomes],
    }
    own = set(columns)
    for name in dict.fromkeys(metric.name for each in outcomes for metric in each.metrics):
        column = f"metric_{name}" if name in own else name
        columns[column] = [each.values.get(name) for each in outcomes]
    return columns


def _assignments(pairs: Sequence[tuple[str, str]]) -> str:
    return " ".join(f"{key}={value}" for key, value in pairs)


def _write_csv(path: Path, columns: dict[str, list[_Cell]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(csv_cell, columns))
    writer.writerows(map(csv_cell, row) for row in zip(*columns.values(), strict=True))
    path.write_text(text.getvalue(), encoding="utf-8")


def _write_parquet(path: Path, columns: dict[str, list[_Cell]]) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    kinds = {str: pa.string(), int: pa.int64(), float: pa.float64()}
    arrays = {}
    for name, cells in columns.items():
        kind = next((type(cell) for cell in cells if cell is not None), float)
        arrays[name] = pa.array(cells, type=kinds[kind])
    parquet.write_table(pa.table(arrays), path)


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
