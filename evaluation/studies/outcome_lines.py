"""Outcomes as lines of JSON, in the store and between processes; a number unknown is null."""

from typing import Annotated, Final

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from evaluation.metrics import Direction, Metric
from evaluation.studies.trial import MAX_SAMPLES, Drawing, Outcome, Series, Status, Trial
from semgraph.arrays import FloatArray, frozen_floats
from semgraph.errors import InputError
from semgraph.files.json_files import STRICT, first_fault

MAX_LINE_BYTES: Final = 4 * 2**20
_MAX_POINTS: Final = 100_000
# Of what pages draw, a tenth of a millimetre and six digits are plenty.
_DRAWN_DECIMALS: Final = 4
_SERIES_DIGITS: Final = 6
# What is larger is as good as infinite, and sums and ratios of what is not are finite.
_LARGEST: Final = 1e100

_Text = Annotated[str, Field(max_length=4000)]
_Pairs = Annotated[list[tuple[_Text, _Text]], Field(max_length=1000)]
_Number = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
_Samples = Annotated[list[_Number], Field(max_length=MAX_SAMPLES)]
_Known = Annotated[list[_Number | None], Field(max_length=MAX_SAMPLES)]
_Points = Annotated[list[tuple[_Number, _Number]], Field(max_length=_MAX_POINTS)]


class _TrialModel(BaseModel):
    model_config = STRICT

    study: _Text
    condition: _Text
    source: _Text
    options: _Pairs
    settings: _Pairs
    estimator: _Text
    seed: int = Field(ge=0, lt=2**63)

    def value(self) -> Trial:
        return Trial(
            self.study,
            self.condition,
            self.source,
            tuple(self.options),
            tuple(self.settings),
            self.estimator,
            self.seed,
        )


class _MetricModel(BaseModel):
    model_config = STRICT

    name: _Text = Field(min_length=1)
    value: _Number | None
    unit: _Text
    better: Direction
    expected: _Number | None = None


class _SeriesModel(BaseModel):
    model_config = STRICT

    times_s: _Samples
    position_errors_m: _Samples
    heading_errors_deg: _Known
    nees: _Known

    def value(self) -> Series:
        n = len(self.times_s)
        return Series(
            frozen_floats("times_s", self.times_s, (n,)),
            frozen_floats("position_errors_m", self.position_errors_m, (n,)),
            frozen_floats("heading_errors_deg", _nan(self.heading_errors_deg), (n,), finite=False),
            frozen_floats("nees", _nan(self.nees), (n,), finite=False),
        )


class _DrawingModel(BaseModel):
    model_config = STRICT

    true_path: _Points
    estimated_path: _Points
    true_landmarks: _Points
    estimated_landmarks: _Points

    def value(self) -> Drawing:
        return Drawing(
            _points(self.true_path),
            _points(self.estimated_path),
            _points(self.true_landmarks),
            _points(self.estimated_landmarks),
        )


class _OutcomeModel(BaseModel):
    model_config = STRICT

    id: str = Field(pattern="^[0-9a-f]{12}$")
    trial: _TrialModel
    status: Status
    reason: _Text
    wall_s: float = Field(ge=0.0)
    cpu_s: float = Field(ge=0.0)
    peak_memory_bytes: int = Field(ge=0, lt=2**63)
    metrics: list[_MetricModel] = Field(max_length=1000)
    versions: _Pairs
    series: _SeriesModel | None
    drawing: _DrawingModel | None


class _Request(BaseModel):
    model_config = STRICT

    trial: _TrialModel


def trial_line(trial: Trial) -> bytes:
    """A trial as one line."""
    return _Request(trial=_trial_model(trial)).model_dump_json().encode() + b"\n"


def parse_trial(line: bytes) -> Trial:
    """The trial of a line.

    Raises:
        InputError: there is none in it.
    """
    try:
        return _Request.model_validate_json(line).trial.value()
    except ValidationError as error:
        raise InputError(f"expected a trial, {first_fault(error)}") from error


def outcome_line(outcome: Outcome) -> bytes:
    """An outcome as one line; paths and series are rounded, metrics are not."""
    series, drawing = outcome.series, outcome.drawing
    model = _OutcomeModel(
        id=outcome.trial.id,
        trial=_trial_model(outcome.trial),
        status=outcome.status,
        reason=_line_of(outcome.reason),
        wall_s=float(outcome.wall_s),
        cpu_s=float(outcome.cpu_s),
        peak_memory_bytes=int(outcome.peak_memory_bytes),
        metrics=[_metric_model(metric) for metric in outcome.metrics],
        versions=list(outcome.versions),
        series=None if series is None else _series_model(series),
        drawing=None if drawing is None else _drawing_model(drawing),
    )
    return model.model_dump_json().encode() + b"\n"


def parse_outcome(line: bytes) -> Outcome:
    """The outcome of a line.

    Raises:
        InputError: there is none in it, or not of the trial that its id names.
    """
    if len(line) > MAX_LINE_BYTES:
        raise InputError(f"expected at most {MAX_LINE_BYTES} bytes")
    try:
        model = _OutcomeModel.model_validate_json(line)
    except ValidationError as error:
        raise InputError(f"expected an outcome, {first_fault(error)}") from error
    trial = model.trial.value()
    if trial.id != model.id:
        raise InputError(f"its trial is {trial.id}, not {model.id} as it says")
    if (model.status is Status.FINISHED) is bool(model.reason):
        raise InputError("expected a reason where a trial did not finish, and there alone")
    names = {metric.name for metric in model.metrics}
    if len(names) != len(model.metrics):
        raise InputError("expected each metric once")
    return Outcome(
        trial,
        model.status,
        model.reason,
        tuple(_metric(metric) for metric in model.metrics),
        model.wall_s,
        model.cpu_s,
        model.peak_memory_bytes,
        None if model.series is None else model.series.value(),
        None if model.drawing is None else model.drawing.value(),
        tuple(model.versions),
    )


def _trial_model(trial: Trial) -> _TrialModel:
    return _TrialModel(
        study=trial.study,
        condition=trial.condition,
        source=trial.source,
        options=list(trial.options),
        settings=list(trial.settings),
        estimator=trial.estimator,
        seed=trial.seed,
    )


def _metric_model(metric: Metric) -> _MetricModel:
    (value,) = _null([metric.value])
    return _MetricModel(
        name=metric.name,
        value=value,
        unit=metric.unit,
        better=metric.better,
        expected=metric.expected,
    )


def _metric(model: _MetricModel) -> Metric:
    value = np.nan if model.value is None else model.value
    return Metric(model.name, value, model.unit, model.better, model.expected)


def _series_model(series: Series) -> _SeriesModel:
    return _SeriesModel(
        times_s=_digits(series.times_s),
        position_errors_m=_digits(series.position_errors_m),
        heading_errors_deg=_null(_digits(series.heading_errors_deg)),
        nees=_null(_digits(series.nees)),
    )


def _drawing_model(drawing: Drawing) -> _DrawingModel:
    return _DrawingModel(
        true_path=_pairs(drawing.true_path),
        estimated_path=_pairs(drawing.estimated_path),
        true_landmarks=_pairs(drawing.true_landmarks),
        estimated_landmarks=_pairs(drawing.estimated_landmarks),
    )


def _line_of(reason: str) -> str:
    """One line that UTF-8 can hold: a file's name in it may be of any bytes."""
    told = reason.encode("utf-8", "backslashreplace").decode()
    return " ".join(told.split())[:4000]


def _digits(values: FloatArray) -> list[float]:
    within = np.clip(values, -_LARGEST, _LARGEST)
    return [float(f"{value:.{_SERIES_DIGITS}g}") for value in within]


def _pairs(points: FloatArray) -> list[tuple[float, float]]:
    return [(x, y) for x, y in _drawn(points).tolist()]


def _drawn(points: FloatArray) -> FloatArray:
    """As many decimals as a page draws; those of the largest numbers would overflow."""
    within = np.clip(points, -_LARGEST, _LARGEST)
    return np.asarray(np.round(within, _DRAWN_DECIMALS))


def _null(values: list[float]) -> list[float | None]:
    return [float(value) if abs(value) <= _LARGEST else None for value in values]


def _nan(values: list[float | None]) -> list[float]:
    return [np.nan if value is None else value for value in values]


def _points(pairs: list[tuple[float, float]]) -> FloatArray:
    return frozen_floats("points", np.array(pairs).reshape(-1, 2), (None, 2))
