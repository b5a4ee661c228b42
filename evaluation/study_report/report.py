"""The report of a study, written beside its files: a page, and its figures as tables."""

import csv
import io
from collections.abc import Sequence
from dataclasses import fields
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from evaluation.studies.comparison import Difference, Summary, differences, summaries
from evaluation.studies.running import read_run
from evaluation.studies.store import STUDY_TOML
from evaluation.studies.study_file import plan_study, study_text
from evaluation.studies.trial_tables import csv_cell, write_files
from evaluation.study_report.contents import Contents
from evaluation.study_report.page import page

REPORT_HTML: Final = "report.html"
SUMMARIES_CSV: Final = "summaries.csv"
DIFFERENCES_CSV: Final = "differences.csv"
_BOOTSTRAP_SEED: Final = 0


def write_report(folder: Path) -> Path:
    """The page of a study's folder, made from its files; two tables are written with it.

    The study need not be finished; the page says how much of it there is.

    Raises:
        InputError: the folder is not a study's, or its files are damaged.
        SemgraphError: the folder cannot be written.
    """
    contents = read_contents(folder)
    write_files(
        folder,
        {
            REPORT_HTML: partial(_write, text=page(contents)),
            SUMMARIES_CSV: partial(_write, text=_table(Summary, contents.summaries)),
            DIFFERENCES_CSV: partial(_write, text=_table(Difference, contents.differences)),
        },
    )
    return folder / REPORT_HTML


def read_contents(folder: Path) -> Contents:
    """What the files of a study say, with intervals and tests.

    Raises:
        InputError: the folder is not a study's, or its files are damaged.
    """
    study, outcomes = read_run(folder)
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    return Contents(
        name=study.name,
        what=study.question,
        settings=study_text(study),
        num_planned=len(plan_study(study, folder).trials),
        run_again=f"semgraph study {STUDY_TOML} --output NEW",
        one_again=f"semgraph study {STUDY_TOML} --trial {{id}}",
        outcomes=outcomes,
        summaries=summaries(outcomes, rng),
        differences=differences(outcomes, rng),
    )


def _table(kind: type[Summary | Difference], rows: Sequence[Summary | Difference]) -> str:
    """A row each, a column a field, in CSV; an unknown number is an empty cell."""
    names = [each.name for each in fields(kind)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_cell(getattr(row, name)) for name in names] for row in rows)
    return text.getvalue()


def _cell(value: str | float | Enum | None) -> str | float | None:
    if isinstance(value, Enum):
        return str(value.value)
    is_unknown = isinstance(value, float) and np.isnan(value)
    return None if is_unknown else csv_cell(value)


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")
