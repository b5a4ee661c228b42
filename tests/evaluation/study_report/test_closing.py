"""The fast estimator against itself without closing loops."""

import re
from dataclasses import replace

from evaluation.metrics import Direction, Metric
from evaluation.studies.trial import Outcome, Status, Trial
from evaluation.study_report.closing import MEMORY, against_forgetting
from tests.evaluation.study_report import made


def test_both_are_compared_on_the_seeds_they_share() -> None:
    outcomes = (*_outcomes("with", 0.01, 20), *_outcomes("without", 0.03, 12, memory="20.0"))
    (path,) = map(_plain, against_forgetting(made.contents(outcomes), "with", "fast"))
    assert path.startswith("fast, closing loops, is better than fast, closing none, in path error")
    assert "12 paired seeds" in path


def test_what_differs_in_more_than_the_memory_is_not_compared() -> None:
    longer = _outcomes("longer", 0.03, 12, memory="20.0")
    others = (
        tuple(replace(each, trial=replace(each.trial, options=(("x", "1"),))) for each in longer),
        tuple(replace(each, trial=replace(each.trial, source="other")) for each in longer),
        _outcomes("the same", 0.03, 12),
    )
    for other in others:
        contents = made.contents((*_outcomes("with", 0.01, 12), *other))
        assert against_forgetting(contents, "with", "fast") == []


def _outcomes(
    condition: str, error_m: float, num_seeds: int, memory: str | None = None
) -> tuple[Outcome, ...]:
    settings = () if memory is None else ((MEMORY, memory),)
    return tuple(
        Outcome(
            Trial("paper", condition, "course:perceptions", (), settings, "fast", seed),
            Status.FINISHED,
            metrics=(
                Metric("trajectory_rmse_m", error_m * (1.0 + 0.01 * seed), "m", Direction.LOWER),
            ),
        )
        for seed in range(1, num_seeds + 1)
    )


def _plain(markup: str) -> str:
    return re.sub(r"<[^>]+>", "", markup)
