"""Runs sections of figures, prints and writes their table: what all `semgraph bench` share."""

import time
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from evaluation.benches.bench_table import Row, SectionRows, print_table, write_csv, write_markdown
from semgraph.errors import InputError, SemgraphError, known_names
from semgraph.files.staging import staged_folder
from semgraph.progress import Report, progress

if TYPE_CHECKING:
    from rich.console import Console

Figures = Callable[[Sequence[int]], list[Row]]
# Figures are functions of seeds alone; whom they tell is the bench's business.
_told: ContextVar[Callable[[float], None]] = ContextVar("told")


@dataclass(frozen=True, slots=True)
class Section:
    """Figures that belong together; `work` is their share of the time, for what is left of it.

    `asked_only`: takes so long that it is measured only where it is asked for by name.
    `seeds`: of its own, instead of the bench's.
    """

    name: str
    figures: tuple[Figures, ...]
    work: float
    asked_only: bool = False
    seeds: Sequence[int] | None = None


def tell(share: float) -> None:
    """How much of the figures at hand is done, 0 to 1; heard within `measure`."""
    told = _told.get(None)
    if told is not None:
        told(share)


def chosen(sections: Sequence[Section], names: Sequence[str]) -> tuple[Section, ...]:
    """The sections whose names begin with one of the names; without any, all that need no asking.

    Raises:
        InputError: no section begins with a name.
    """
    if not names:
        return tuple(section for section in sections if not section.asked_only)
    known = [section.name for section in sections]
    for name in names:
        if not any(each.startswith(name) for each in known):
            raise InputError(f"no section {name!r}, {known_names(name, known)}")
    return tuple(each for each in sections if each.name.startswith(tuple(names)))


def bench(
    console: "Console",
    name: str,
    sections: Sequence[Section],
    seeds: Sequence[int] | None,
    folder: Path,
) -> None:
    """Measures, prints and writes `NAME.csv` and `NAME.md`: both or neither.

    Without seeds each section has its own, and its heading says which.

    Raises:
        SemgraphError: the folder cannot be written, or holds something else.
    """
    with staged_folder(folder, f"{name}.csv") as staged:
        with progress(console, name, 100, "%") as report:
            measured = measure(sections, seeds or (), report)
        write_csv(measured, staged / f"{name}.csv")
        title = name.capitalize() + (f", seeds {seeds[0]} to {seeds[-1]}" if seeds else "")
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
        share = _Share(report, section, before / whole, section.work / whole)
        measured.append(_measure(section, section.seeds or seeds, share))
        before += section.work
    return tuple(measured)


@dataclass(slots=True)
class _Share:
    """Tells a report how far a section is, whose own share of the work comes after `before`."""

    report: Report
    section: Section
    before: float
    own: float
    figure: int = 0
    last: int = 0

    def tell(self, share: float) -> None:
        """Within the figures at hand; a percent at a time."""
        done = (self.figure + share) / len(self.section.figures)
        percent = round(100.0 * (self.before + self.own * done))
        if percent > self.last:
            self.last = percent
            self.report.done(percent)
        self.report.note(f"{self.section.name}, {done:.0%}")


def _measure(section: Section, seeds: Sequence[int], share: _Share) -> SectionRows:
    started = time.perf_counter()
    rows: list[Row] = []
    left_out = ""
    token = _told.set(share.tell)
    try:
        for share.figure, figures in enumerate(section.figures):
            rows += figures(seeds)
            share.tell(1.0)
    except SemgraphError as error:
        left_out = " ".join(str(error).split())
    finally:
        _told.reset(token)
    return SectionRows(_named(section), tuple(rows), time.perf_counter() - started, left_out)


def _named(section: Section) -> str:
    """With its own seeds, where it has some."""
    if section.seeds is None:
        return section.name
    return f"{section.name}, seeds {section.seeds[0]} to {section.seeds[-1]}"
