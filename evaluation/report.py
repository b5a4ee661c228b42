"""Metrics and pictures of a run, written beside its files and read again."""

import json
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, RootModel

from evaluation.metrics import Direction, Metric, judge
from evaluation.truth_files import read_truth
from semgraph import results
from semgraph.errors import InputError
from semgraph.files.json_files import STRICT, read_json
from semgraph.files.tables import write_text

METRICS_JSON = "metrics.json"
MAP_PNG = "map.png"
ERRORS_PNG = "errors.png"
ROTATION_PNG = "rotation.png"


class _Entry(BaseModel):
    model_config = STRICT
    value: float
    unit: str
    better: str
    expected: float | None = None

    def metric(self, name: str) -> Metric:
        return Metric(name, self.value, self.unit, Direction(self.better), self.expected)


class _Metrics(RootModel[dict[str, _Entry]]):
    pass


def evaluate_folder(folder: Path) -> tuple[Metric, ...]:
    """The metrics of a run, from its files; metrics.json and the pictures are written again.

    Raises:
        InputError: a file is missing, cut short or malformed.
        SemgraphError: the metrics or pictures cannot be written.
    """
    from evaluation.figures import draw_errors, draw_map, draw_rotation

    result, truth = results.read(folder), read_truth(folder)
    metrics = judge(result, truth)
    write_metrics(folder, metrics)
    draw_map(result, truth, folder / MAP_PNG)
    draw_errors(result, truth, folder / ERRORS_PNG)
    if len(result.imu):
        draw_rotation(result, folder / ROTATION_PNG)
    return metrics


def write_metrics(folder: Path, metrics: Sequence[Metric]) -> None:
    """Writes metrics.json: value, unit and direction under each metric's name.

    Raises:
        SemgraphError: the file cannot be written.
    """
    entries = {
        metric.name: _Entry(
            value=metric.value,
            unit=metric.unit,
            better=metric.better.value,
            expected=metric.expected,
        ).model_dump(exclude_none=True)
        for metric in metrics
    }
    write_text(folder / METRICS_JSON, json.dumps(entries, indent=2) + "\n")


def read_metrics(folder: Path) -> tuple[Metric, ...]:
    """The metrics of a folder's metrics.json.

    Raises:
        InputError: missing or malformed.
    """
    entries = read_json(folder / METRICS_JSON, _Metrics).root
    try:
        return tuple(entry.metric(name) for name, entry in entries.items())
    except ValueError as error:
        raise InputError(f"{folder / METRICS_JSON}: {error}") from error


def table_rows(metrics: Sequence[Metric]) -> list[tuple[str, str, str, str]]:
    """Name in words, value, unit and direction of each metric, as text for a table."""
    return [
        (_words(metric), _figures(metric), metric.unit, _direction(metric)) for metric in metrics
    ]


def _words(metric: Metric) -> str:
    return metric.name.removesuffix(f"_{metric.unit.replace('/', '_')}").replace("_", " ")


def _figures(metric: Metric) -> str:
    if metric.unit == "" and metric.value == int(metric.value):
        return str(int(metric.value))
    return f"{metric.value:.3f}" if abs(metric.value) < 100.0 else f"{metric.value:.1f}"


def _direction(metric: Metric) -> str:
    match metric.better:
        case Direction.EXPECTED:
            return f"expected {metric.expected:g}"
        case Direction.NEITHER:
            return ""
        case _:
            return f"{metric.better.value} is better"
