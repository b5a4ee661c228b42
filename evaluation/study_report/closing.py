"""What closing loops does: the fast estimator against itself with a memory too short for it."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from evaluation.studies.comparison import differences
from evaluation.studies.trial import Outcome
from evaluation.study_report.contents import PATH_ERROR, Contents
from evaluation.study_report.markup import Markup
from evaluation.study_report.paired import compared

MEMORY: Final = "fast.memory_m"
_WITH, _WITHOUT = "fast, closing loops,", "fast, closing none,"
_METRICS: Final = (PATH_ERROR, "map_rmse_m", "landmarks_duplicate")
_BOOTSTRAP_SEED: Final = 0


def against_forgetting(contents: Contents, condition: str, estimator: str) -> list[Markup]:
    """Sentences on the same seeds of both; none where no condition differs in this alone."""
    closing = contents.finished(condition, estimator)
    forgetting = _forgetting(contents, closing, estimator)
    if not closing or not forgetting:
        return []
    both = [*_named(closing, condition, _WITH), *_named(forgetting, condition, _WITHOUT)]
    metrics = {
        metric.name: metric for each in both for metric in each.metrics if metric.name in _METRICS
    }
    kept = tuple(_only(each) for each in both)
    pairs = replace(
        contents,
        outcomes=kept,
        summaries=(),
        differences=differences(kept, np.random.default_rng(_BOOTSTRAP_SEED)),
    )
    return [
        compared(pairs, condition, metrics[name], _WITH, _WITHOUT)
        for name in _METRICS
        if name in metrics
    ]


def _forgetting(
    contents: Contents, closing: tuple[Outcome, ...], estimator: str
) -> tuple[Outcome, ...]:
    """The trials of the condition that differs from another in the memory alone."""
    if not closing:
        return ()
    trial = closing[0].trial
    for condition in contents.conditions:
        its = contents.finished(condition, estimator)
        if its and condition != trial.condition:
            other = its[0].trial
            settings = tuple(pair for pair in other.settings if pair[0] != MEMORY)
            is_like = (other.source, other.options) == (trial.source, trial.options)
            if is_like and settings == trial.settings != other.settings:
                return its
    return ()


def _named(outcomes: tuple[Outcome, ...], condition: str, name: str) -> Iterator[Outcome]:
    for each in outcomes:
        yield replace(each, trial=replace(each.trial, condition=condition, estimator=name))


def _only(outcome: Outcome) -> Outcome:
    metrics = tuple(each for each in outcome.metrics if each.name in _METRICS)
    return replace(outcome, metrics=metrics)
