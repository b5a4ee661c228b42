"""The headline figures of the study `paper`, beside what was asked for."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Final

import numpy as np

from evaluation.benches.bench import Section, tell
from evaluation.benches.bench_table import Better, Row
from evaluation.studies.execution import Execution, outcome_lines
from evaluation.studies.outcome_lines import parse_outcome
from evaluation.studies.study_file import plan_study, read_study
from evaluation.studies.trial import Outcome, Status
from semgraph.arrays import FloatArray
from semgraph.errors import SemgraphError

STUDY: Final = "paper"
_PATH: Final = "trajectory_rmse_m"


def paper_study(seeds: Sequence[int]) -> list[Row]:
    """The study run with these seeds, its conditions taken together.

    Raises:
        SemgraphError: an estimator that the figures need has no seed that finished.
    """
    plan = plan_study(read_study(STUDY), Path(), range(seeds[0], seeds[-1] + 1))
    outcomes = []
    with closing(outcome_lines(plan.trials, Execution())) as lines:
        for line in lines:
            outcomes.append(parse_outcome(line))
            tell(len(outcomes) / len(plan.trials))
    return rows(outcomes)


def rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """What the paper and this project's aims ask of it."""
    drifts_m = _values(outcomes, "fast", "trajectory_max_origin_m")
    twice = _values(outcomes, "smoothed", "landmarks_duplicate")
    num_failed = sum(each.status is not Status.FINISHED for each in outcomes)
    return [
        Row("trials that did not finish", num_failed, "", Better.LOWER, 0.0),
        Row("fast, drift, worst", float(drifts_m.max()), "m", Better.LOWER, 0.5),
        _ratio(outcomes, "smoothed", "fast", 1.0),
        _ratio(outcomes, "smoothed", "oracle", 1.05),
        Row("smoothed, landmarks twice, most", float(twice.max()), "", Better.LOWER, 0.0),
    ]


SECTIONS: Final = (Section(f"study {STUDY}", (paper_study,), 1.0),)


def _ratio(outcomes: Sequence[Outcome], one: str, other: str, target: float) -> Row:
    """The median over the pairs of one's path error over the other's."""
    first, second = (_by_pair(outcomes, name) for name in (one, other))
    shared = [pair for pair in first if pair in second]
    if not shared:
        raise SemgraphError(f"no seed finished with both {one} and {other}")
    ratios = [first[pair] / second[pair] for pair in shared]
    name = f"{one} / {other}, path, median"
    return Row(name, float(np.median(ratios)), "", Better.LOWER, target)


def _by_pair(outcomes: Sequence[Outcome], estimator: str) -> dict[tuple[str, int], float]:
    return {
        each.trial.pair: each.values[_PATH]
        for each in outcomes
        if each.trial.estimator == estimator and _PATH in each.values
    }


def _values(outcomes: Sequence[Outcome], estimator: str, metric: str) -> FloatArray:
    found = [
        each.values[metric]
        for each in outcomes
        if each.trial.estimator == estimator and metric in each.values
    ]
    if not found:
        raise SemgraphError(f"no seed finished with {metric} of {estimator}")
    return np.array(found)
