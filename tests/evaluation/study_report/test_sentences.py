"""What the summary claims is what the tests allow, and no more."""

import html
import re
from dataclasses import replace

import pytest

from evaluation.metrics import Direction, Metric
from evaluation.studies.trial import Outcome, Status, Trial
from evaluation.study_report.paired import compared
from evaluation.study_report.sentences import summary
from tests.evaluation.study_report import made

_ATE = Metric("trajectory_rmse_m", 0.0, "m", Direction.LOWER)


def test_a_clear_winner_is_named_with_size_interval_and_p() -> None:
    told = _told(_outcomes({"good": 0.01, "bad": 0.03}, num_seeds=20))
    assert "good has the lowest median path error (ATE RMSE), 0.01" in told
    assert "better than each of the others beyond what chance explains" in told
    assert re.search(
        r"bad: 0\.03\d* m, more by 0\.02\d* m \(0\.0\d+ to 0\.0\d+\), 3\.00 times", told
    )
    assert "p < 0.001" in told


def test_two_alike_are_not_told_apart() -> None:
    told = _told(_outcomes({"one": 0.02, "other": 0.02}, num_seeds=20))
    assert "No difference from any of the others can be shown" in told
    assert "better than" not in told


def test_too_few_seeds_claim_nothing_and_say_so() -> None:
    told = _told(_outcomes({"good": 0.01, "bad": 0.03}, num_seeds=4))
    assert "4 seeds, too few for an interval" in told
    assert "no difference can be shown with 4 paired seeds" in told
    assert "there must be more seeds" in told


def test_the_oracle_wins_nothing() -> None:
    told = _told(_outcomes({"oracle": 0.001, "good": 0.01, "bad": 0.03}, num_seeds=10))
    assert "good has the lowest" in told
    assert "oracle:" not in told
    assert "Not ranked, as they are told more than the measurements: oracle" in told


def test_failures_are_told_first() -> None:
    outcomes = _outcomes({"good": 0.01, "bad": 0.03}, num_seeds=10)
    failed = replace(outcomes[1], status=Status.OUT_OF_MEMORY, metrics=())
    told = _told((outcomes[0], failed, *outcomes[2:]))
    assert "1 did not finish: 1 of bad (out of memory)" in told.split("lowest")[0]


def test_several_versions_are_told_before_anything_is_compared() -> None:
    outcomes = _outcomes({"good": 0.01, "bad": 0.03}, num_seeds=10)
    older = tuple(replace(each, versions=(("numpy", "1.0"),)) for each in outcomes[:3])
    newer = tuple(replace(each, versions=(("numpy", "2.0"),)) for each in outcomes[3:])
    told = _told((*older, *newer)).split("lowest")[0]
    assert "with several versions of numpy 1.0 (3), 2.0 (17)." in told
    assert "several versions" not in _told(newer)


def test_of_those_alike_the_medians_span_from_the_smallest_to_the_largest() -> None:
    metrics = (
        Metric("trajectory_rmse_m", 1.0, "m", Direction.LOWER),
        Metric("nees_mean", 0.0, "", Direction.EXPECTED, 3.0),
    )
    outcomes = [
        Outcome(
            Trial("s", "calm", "none", (), (), name, seed),
            Status.FINISHED,
            metrics=(metrics[0], replace(metrics[1], value=value)),
        )
        for name, value in (("near", 3.31), ("under", 2.51), ("over", 3.48))
        for seed in range(3)
    ]
    assert "(medians 2.51 to 3.48)" in _told(tuple(outcomes))


def test_an_unfinished_study_says_so() -> None:
    contents = made.contents(_outcomes({"good": 0.01, "bad": 0.03}, num_seeds=10))
    told = " ".join(summary(replace(contents, num_planned=25)))
    assert "The study is not finished: 5 trials have not run." in told


@pytest.mark.parametrize(("one", "other"), [("good", "bad"), ("bad", "good")])
def test_comparing_does_not_depend_on_who_is_named_first(one: str, other: str) -> None:
    contents = made.contents(_outcomes({"good": 0.01, "bad": 0.03}, num_seeds=10))
    told = _plain(compared(contents, "here", _ATE, one, other))
    assert told.startswith("good is better than bad in path error (ATE RMSE) by 0.02")


def test_higher_is_better_where_it_is() -> None:
    outcomes = tuple(
        replace(each, metrics=tuple(replace(one, better=Direction.HIGHER) for one in each.metrics))
        for each in _outcomes({"low": 0.01, "high": 0.03}, num_seeds=10)
    )
    told = _told(outcomes)
    assert "high has the highest" in told
    assert "low: 0.0101 m, less by" in told or re.search(r"low: 0\.01\d* m, less by", told)


def _outcomes(medians: dict[str, float], num_seeds: int) -> tuple[Outcome, ...]:
    """Values that differ between seeds; of estimators that are alike, evenly to both sides."""
    return tuple(
        Outcome(
            Trial("made", "here", "course:perceptions", (), (), name, seed),
            Status.FINISHED,
            metrics=(replace(_ATE, value=value * (1.0 + 0.01 * seed) + _noise(place, seed)),),
        )
        for seed in range(1, num_seeds + 1)
        for place, (name, value) in enumerate(medians.items())
    )


def _noise(place: int, seed: int) -> float:
    return 1e-5 * place * (-1.0 if seed % 2 else 1.0) * (1.0 + 0.1 * seed)


def _told(outcomes: tuple[Outcome, ...]) -> str:
    return _plain(" ".join(summary(made.contents(outcomes))))


def _plain(markup: str) -> str:
    return html.unescape(re.sub(r"<[^>]+>", "", markup))
