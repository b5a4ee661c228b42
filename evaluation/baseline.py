"""Figures with direction and tolerance, as they were, and what is to be said of them now.

A figure is the mean of a metric over the seeds. On one machine it comes out the same to the last
digits; with other libraries of linear algebra a decision may fall otherwise and one seed turn out
as another one does. So the tolerance is by how much the mean changes at most if a seed is left
out. Where there is one seed alone it is a unit of the second digit, as the README tells figures,
and nothing where the figure is a whole number.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import BaseModel, Field, RootModel

from evaluation.metrics import Direction, Metric
from evaluation.studies.trial import Outcome, Status
from semgraph.arrays import FloatArray
from semgraph.files.json_files import STRICT, read_json
from semgraph.files.tables import write_text

METRICS: Final = (
    "trajectory_rmse_m",
    "trajectory_max_origin_m",
    "heading_rmse_deg",
    "map_rmse_m",
    "map_precision",
    "map_recall",
    "landmarks_duplicate",
    "association_precision",
    "association_recall",
    "nees_mean",
    "loops_closed",
)
# What other processors and libraries change in the last digits.
_ROUNDING: Final = 1e-6


class Verdict(StrEnum):
    """What has become of a figure."""

    AS_BEFORE = "as before"
    BETTER = "better"
    NEW = "new"
    WORSE = "worse"
    MISSING = "missing"
    NOT_A_NUMBER = "not a number"
    CRASHED = "crashed"

    @property
    def is_failure(self) -> bool:
        """Whether it has to be put right before anything is merged."""
        return self in _FAILURES


_FAILURES: Final = frozenset(
    {Verdict.WORSE, Verdict.MISSING, Verdict.NOT_A_NUMBER, Verdict.CRASHED}
)


@dataclass(frozen=True, slots=True)
class Figure:
    """What was measured: NaN where a trial gave no number, with the reason where it crashed."""

    value: float
    unit: str
    better: Direction
    tolerance: float
    expected: float | None = None
    crashed: str = ""


@dataclass(frozen=True, slots=True)
class Judged:
    """A figure beside the one it is held against; None where there is none of the two."""

    name: str
    verdict: Verdict
    before: Figure | None
    now: Figure | None

    @property
    def line(self) -> str:
        """Name, verdict, both values and the tolerance."""
        if self.now is not None and self.now.crashed:
            return f"{self.name}: {self.verdict.value}: {self.now.crashed}"
        unit = (self.before or self.now or _NOTHING).unit
        now = "none" if self.now is None else f"{self.now.value:.6g}"
        if self.before is None:
            return f"{self.name}: {self.verdict.value}: {now} {unit}".rstrip()
        limits = f"{self.before.value:.6g} +- {self.before.tolerance:.2g}"
        return f"{self.name}: {self.verdict.value}: {now}, was {limits} {unit}".rstrip()


_NOTHING: Final = Figure(math.nan, "", Direction.NEITHER, 0.0)


class _Entry(BaseModel):
    model_config = STRICT

    value: float
    unit: str
    better: Direction
    tolerance: float = Field(ge=0.0)
    expected: float | None = None


class _Baseline(RootModel[dict[str, _Entry]]):
    pass


def read_baseline(path: Path) -> dict[str, Figure]:
    """The figures of a file by name.

    Raises:
        InputError: there is no such file, or it is malformed.
    """
    entries = read_json(path, _Baseline).root
    return {
        name: Figure(each.value, each.unit, each.better, each.tolerance, each.expected)
        for name, each in entries.items()
    }


def write_baseline(path: Path, figures: Mapping[str, Figure]) -> None:
    """Writes the figures that have a value.

    Raises:
        SemgraphError: the file cannot be written.
    """
    entries = {
        name: {
            "value": each.value,
            "unit": each.unit,
            "better": each.better.value,
            "tolerance": each.tolerance,
            **({} if each.expected is None else {"expected": each.expected}),
        }
        for name, each in figures.items()
        if math.isfinite(each.value)
    }
    write_text(path, json.dumps(entries, indent=2) + "\n")


def figures_of(outcomes: Sequence[Outcome]) -> dict[str, Figure]:
    """The figures of each condition and estimator, by `condition, estimator, metric`.

    A metric that one seed has and another lacks is not a number; so is all of a trial that
    crashed.
    """
    groups: dict[tuple[str, str], list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault((outcome.trial.condition, outcome.trial.estimator), []).append(outcome)
    return {
        f"{condition}, {estimator}, {name}": figure
        for (condition, estimator), its in groups.items()
        for name, figure in _of_group(its)
    }


def judged(before: Mapping[str, Figure], now: Mapping[str, Figure]) -> tuple[Judged, ...]:
    """The verdict on each figure of both, those of the baseline first."""
    names = dict.fromkeys((*before, *now))
    crashed = _crashed(now)
    found = []
    for name in names:
        group = name.rpartition(", ")[0]
        measured = now.get(name, crashed.get(group))
        found.append(Judged(name, _verdict(before.get(name), measured), before.get(name), measured))
    return tuple(found)


def updated(
    before: Mapping[str, Figure], now: Mapping[str, Figure], *, worse_too: bool
) -> dict[str, Figure]:
    """The baseline with what is better or new, on demand also with what is worse.

    A crash and what is no number never get in; what is missing goes only where worse is taken.
    """
    taken = {Verdict.BETTER, Verdict.NEW, *({Verdict.WORSE} if worse_too else set())}
    figures: dict[str, Figure] = {}
    for each in judged(before, now):
        if each.verdict in taken and each.now is not None:
            figures[each.name] = each.now
        elif each.before is not None and not (worse_too and each.verdict is Verdict.MISSING):
            figures[each.name] = each.before
    return figures


def _of_group(outcomes: Sequence[Outcome]) -> list[tuple[str, Figure]]:
    crash = next((each for each in outcomes if each.status is not Status.FINISHED), None)
    if crash is not None:
        reason = f"seed {crash.trial.seed} {crash.status.value}: {crash.reason}"
        return [("", Figure(math.nan, "", Direction.NEITHER, 0.0, crashed=reason))]
    known = {metric.name: metric for each in outcomes for metric in each.metrics}
    return [
        (name, _figure(known[name], np.array([each.values.get(name, np.nan) for each in outcomes])))
        for name in METRICS
        if name in known
    ]


def _figure(metric: Metric, values: FloatArray) -> Figure:
    mean = float(values.mean())
    return Figure(mean, metric.unit, metric.better, _tolerance(values), metric.expected)


def _tolerance(values: FloatArray) -> float:
    mean = float(values.mean())
    if not math.isfinite(mean):
        return 0.0
    if len(values) > 1:
        largest = float(np.abs(values - mean).max()) / (len(values) - 1)
    elif not mean.is_integer():
        largest = 10.0 ** (math.floor(math.log10(abs(mean))) - 1)
    else:
        largest = 0.0
    return float(f"{max(largest, _ROUNDING * abs(mean)):.2g}")


def _crashed(now: Mapping[str, Figure]) -> dict[str, Figure]:
    """By condition and estimator."""
    return {name.rpartition(", ")[0]: each for name, each in now.items() if each.crashed}


def _verdict(before: Figure | None, now: Figure | None) -> Verdict:
    if now is None:
        return Verdict.MISSING
    if now.crashed:
        return Verdict.CRASHED
    if not math.isfinite(now.value):
        return Verdict.NOT_A_NUMBER
    if before is None:
        return Verdict.NEW
    gain = _badness(before, before.value) - _badness(before, now.value)
    if abs(gain) <= before.tolerance:
        return Verdict.AS_BEFORE
    return Verdict.BETTER if gain > 0.0 else Verdict.WORSE


def _badness(figure: Figure, value: float) -> float:
    """The larger the worse."""
    match figure.better:
        case Direction.HIGHER:
            return -value
        case Direction.EXPECTED if figure.expected is not None:
            return abs(value - figure.expected)
        case _:
            return value
