"""All figures of the detectors, section by section: `semgraph bench detectors`."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from evaluation import bench_rocks, bench_runs, bench_trees_2d, bench_trees_3d
from evaluation.bench_markers import optical_markers
from evaluation.bench_reflectors import reflectors_car_park, reflectors_simulated
from evaluation.bench_table import Row, SectionRows, print_table, write_csv, write_markdown
from semgraph.errors import InputError, SemgraphError
from semgraph.progress import Report, progress
from semgraph.staging import staged_folder

if TYPE_CHECKING:
    from rich.console import Console

DETECTORS_CSV: Final = "detectors.csv"
DETECTORS_MD: Final = "detectors.md"
CAR_PARK: Final = "car_park"

Figures = Callable[[Sequence[int]], list[Row]]


@dataclass(frozen=True, slots=True)
class Section:
    """Figures that belong together; `work` is their share of the time, for what is left of it."""

    name: str
    figures: tuple[Figures, ...]
    work: float


def _of_seeds(figures: bench_trees_3d.Figures, num_rings: int, seeds: Sequence[int]) -> list[Row]:
    return figures(num_rings, seeds)


_CLOUDS: Final = tuple(
    partial(_of_seeds, figures, num_rings)
    for num_rings in bench_trees_3d.DEVICES
    for figures in bench_trees_3d.FIGURES
)
SECTIONS: Final[tuple[Section, ...]] = (
    Section("trees in laser scans", bench_trees_2d.FIGURES, 45.0),
    Section("trees in clouds", _CLOUDS, 45.0),
    Section("rocks in depth images", bench_rocks.FIGURES, 180.0),
    Section("optical markers in images", (optical_markers,), 27.0),
    Section("reflectors in laser scans", (reflectors_simulated,), 1.0),
    Section("whole runs", bench_runs.FIGURES, 1500.0),
)


def car_park(data: Path | None) -> Section:
    """The real car park, in `data` or in its folder `car_park`; seeds do not matter to it."""

    def figures(_: Sequence[int]) -> list[Row]:
        if data is None:
            raise InputError("name the folder of the real recordings by --data DIR")
        inside = data / CAR_PARK
        return reflectors_car_park(inside if inside.is_dir() else data)

    return Section("reflectors in the real car park", (figures,), 1.0)


def bench(
    console: "Console", sections: Sequence[Section], seeds: Sequence[int], folder: Path
) -> None:
    """Measures, prints and writes `detectors.csv` and `detectors.md`: both or neither.

    Raises:
        SemgraphError: the folder cannot be written, or holds something else.
    """
    with staged_folder(folder, DETECTORS_CSV) as staged:
        with progress(console, "detectors", 100, "%") as report:
            measured = measure(sections, seeds, report)
        write_csv(measured, staged / DETECTORS_CSV)
        title = f"Detectors, seeds {seeds[0]} to {seeds[-1]}"
        write_markdown(measured, title, staged / DETECTORS_MD)
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
