"""Every benchmark in one table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from evaluation.benches import (
    bench_constellation,
    bench_detectors,
    bench_graph,
    bench_localization,
    bench_online,
    bench_refine,
    bench_study,
)
from evaluation.benches.bench import Section


@dataclass(frozen=True, slots=True)
class Part:
    """A benchmark.

    Attributes:
        seeds: that it takes of its own.
        hours: about what it takes with these, for the time left.
        sections: given the folder of the recordings.
    """

    name: str
    seeds: range
    hours: float
    sections: Callable[[Path], Sequence[Section]]


PARTS: Final = (
    Part(
        "detectors",
        range(101, 125),
        1.0,
        lambda data: (*bench_detectors.SECTIONS, bench_detectors.car_park(data)),
    ),
    Part("graph", range(1, 51), 4.0, bench_graph.sections),
    Part("localization", range(1, 101), 1.0, bench_localization.sections),
    Part("online", range(1, 4), 0.1, lambda _: bench_online.SECTIONS),
    Part("refine", range(101, 113), 0.1, lambda _: bench_refine.SECTIONS),
    Part("constellation", range(1, 11), 0.1, lambda _: bench_constellation.SECTIONS),
    Part("studies", range(1, 21), 0.1, lambda _: bench_study.SECTIONS),
)


def all_sections(data: Path, seeds: range | None = None) -> tuple[Section, ...]:
    """The sections of all benchmarks as `PART: SECTION`, each with the seeds of its part.

    Args:
        data: the folder of the recordings.
        seeds: instead of each part's own.
    """
    return tuple(each for part in PARTS for each in _of_part(part, data, seeds or part.seeds))


def _of_part(part: Part, data: Path, seeds: range) -> list[Section]:
    """A part's shares of the work are of its own; here they become hours."""
    sections = part.sections(data)
    whole = sum(section.work for section in sections if not section.asked_only)
    return [
        replace(
            section,
            name=f"{part.name}: {section.name}",
            work=section.work * part.hours / whole,
            seeds=seeds,
        )
        for section in sections
    ]
