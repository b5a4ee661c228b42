"""Runs sections of figures, prints and writes their table: what all `semgraph bench` share."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from evaluation.bench_table import Row, SectionRows, print_table, write_csv, write_markdown
from semgraph.errors import SemgraphError
from semgraph.progress import Report, progress
from semgraph.staging import staged_folder

if TYPE_CHECKING:
    from rich.console import Console

Figures = Callable[[Sequence[int]], list[Row]]


@dataclass(frozen=True, slots=True)
class Section:
    """Figures that belong together; `work` is their share of the time, for what is left of it."""

    name: str
    figures: tuple[Figures, ...]
    work: float


def bench(
    console: "Console", name: str, sections: Sequence[Section], seeds: Sequence[int], folder: Path
) -> None:
    """Measures, prints and writes `NAME.csv` and `NAME.md`: both or neither.

    Raises:
        SemgraphError: the folder cannot be written, or holds something else.
    """
    with staged_folder(folder, f"{name}.csv") as staged:
        with progress(console, name, 100, "%") as report:
            measured = measure(sections, seeds, report)
        write_csv(measured, staged / f"{name}.csv")
        title = f"{name.capitalize()}, seeds {seeds[0]} to {seeds[-1]}"
        write_markdown(measured, title, staged / f"{name}.md")
    print_table(console, measured)


def measure(
    sections: Sequence[Section], seeds: Sequence[int], report: Report
) -> tuple[SectionRows, ...]:
    """The rows of all sections; `report` is told how many percent of the work are done.

    What is not there to be measured (a recording, a system library) leaves its section out, with
    the reason.
    """
    whole = sum(section.work for section in sections)
    measured, before = [], 0.0
    for section in sections:
        report.note(section.name)
        measured.append(_measure(section, seeds, report, (before / whole, section.work / whole)))
        before += section.work
    return tuple(measured)


def _measure(
    section: Section, seeds: Sequence[int], report: Report, shares: tuple[float, float]
) -> SectionRows:
    """`shares` of the whole work: done before, and this section's."""
    before, own = shares
    started = time.perf_counter()
    rows: list[Row] = []
    left_out = ""
    for k, figures in enumerate(section.figures, start=1):
        try:
            rows += figures(seeds)
        except SemgraphError as error:
            left_out = " ".join(str(error).split())
            break
        report.done(round(100.0 * (before + own * k / len(section.figures))))
    return SectionRows(section.name, tuple(rows), time.perf_counter() - started, left_out)
