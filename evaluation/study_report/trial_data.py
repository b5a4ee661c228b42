"""The trials as compact text that a small script draws from: what pages of trials are made of."""

import base64
import json
import zlib
from typing import Any, Final

import numpy as np

from evaluation.studies.trial import Drawing, Outcome, Series
from evaluation.study_report.contents import Contents, words_of
from evaluation.study_report.time_figures import LEAST_NEES
from semgraph.arrays import FloatArray

_STRIDES: Final = (1, 2, 3, 4, 6, 8)
_STEPS: Final = 1000


def trial_data(contents: Contents, most_bytes: int) -> str:
    """JSON of all trials; series and drawings are thinned where it would be larger than that.

    They are thinned to an eighth at most, whatever size that leaves. Trials on the same
    measurements share a block, deflated and in base64: the true path and landmarks are told once.
    Numbers in it are differences of whole steps, with the step before.
    """
    for stride in _STRIDES:
        pairs = _pairs(contents, stride)
        if sum(len(pair["data"]) for pair in pairs) <= most_bytes:
            break
    metrics = [
        [words_of(each), each.unit, contents.nearest_to(each)[2:] or each.better.value]
        for each in contents.metrics.values()
    ]
    whole = {"again": contents.one_again, "metrics": metrics, "pairs": pairs}
    # Within <script>, only "<" could end the element.
    return json.dumps(whole, separators=(",", ":")).replace("<", "\\u003c")


def _pairs(contents: Contents, stride: int) -> list[dict[str, Any]]:
    by_pair: dict[tuple[str, int], list[Outcome]] = {}
    for each in contents.outcomes:
        by_pair.setdefault(each.trial.pair, []).append(each)
    names = list(contents.metrics)
    return [
        {
            "condition": condition,
            "seed": seed,
            "ids": [each.trial.id for each in its],
            "data": _deflated(_block(its, names, stride)),
        }
        for (condition, seed), its in by_pair.items()
    ]


def _block(outcomes: list[Outcome], metrics: list[str], stride: int) -> dict[str, Any]:
    drawings = [each.drawing for each in outcomes if each.drawing is not None]
    return {
        "truth": _truth(drawings[0], stride) if drawings else None,
        "trials": [_trial(each, metrics, stride) for each in outcomes],
    }


def _truth(drawing: Drawing, stride: int) -> dict[str, Any]:
    return {
        "path": _points(drawing.true_path[:: _at_least(drawing.true_path, stride)]),
        "landmarks": _points(drawing.true_landmarks),
    }


def _trial(outcome: Outcome, metrics: list[str], stride: int) -> dict[str, Any]:
    trial, values = outcome.trial, outcome.values
    return {
        "estimator": trial.estimator,
        "source": trial.source,
        "options": [list(pair) for pair in (*trial.options, *trial.settings)],
        "status": outcome.status.value,
        "reason": outcome.reason,
        "wall": _short(outcome.wall_s),
        "cpu": _short(outcome.cpu_s),
        "memory": _short(outcome.peak_memory_bytes / 1e6),
        "values": [_short(values[name]) if name in values else None for name in metrics],
        "series": _series(outcome.series, stride) if outcome.series is not None else None,
        "path": _points(outcome.drawing.estimated_path[::stride]) if outcome.drawing else None,
        "landmarks": _points(outcome.drawing.estimated_landmarks) if outcome.drawing else None,
    }


def _series(series: Series, stride: int) -> dict[str, Any]:
    """The largest error of each stretch of `stride` samples, as the series has them already.

    Of NEES it is the last: honest ones are about their degrees of freedom, the largest are not.
    """
    return {
        "t": _steps(series.times_s[stride - 1 :: stride]),
        "p": _steps(_largest(series.position_errors_m, stride)),
        "h": _steps(_largest(series.heading_errors_deg, stride)),
        "n": _steps(_logs(series.nees[stride - 1 :: stride])),
    }


def _largest(values: FloatArray, stride: int) -> FloatArray:
    whole = len(values) // stride * stride
    stretches = values[:whole].reshape(-1, stride)
    filled = np.where(np.isnan(stretches), -np.inf, stretches).max(axis=1, initial=-np.inf)
    return np.where(np.isneginf(filled), np.nan, filled)


def _logs(nees: FloatArray) -> FloatArray:
    """log10; what cannot be told from 0 is drawn at `LEAST_NEES`."""
    return np.log10(np.maximum(nees, LEAST_NEES))


def _points(points: FloatArray) -> list[Any]:
    return [_steps(points[:, axis]) for axis in range(2)] if len(points) else []


def _steps(values: FloatArray) -> list[Any]:
    """[lowest, step, differences...] of values in steps of a thousandth; null where not finite."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return []
    low, extent = float(finite.min()), float(np.ptp(finite))
    step = extent / _STEPS or 1.0
    differences = np.diff(np.round((finite - low) / step).astype(np.int64), prepend=0).tolist()
    if len(finite) < len(values):
        told = iter(differences)
        differences = [next(told) if known else None for known in np.isfinite(values).tolist()]
    return [_short(low), float(f"{step:.6g}"), *differences]


def _at_least(points: FloatArray, stride: int) -> int:
    """A stride that leaves at most twice as many true points as there are estimated ones."""
    return max(1, len(points) * stride // 240)


def _short(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None


def _deflated(block: dict[str, Any]) -> str:
    text = json.dumps(block, separators=(",", ":"))
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode("ascii")
