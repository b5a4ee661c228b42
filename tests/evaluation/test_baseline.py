"""Each way in which a figure can fail the gate, and how the baseline changes on purpose only."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from evaluation.baseline import (
    Figure,
    Verdict,
    figures_of,
    judged,
    read_baseline,
    updated,
    write_baseline,
)
from evaluation.metrics import Direction, Metric
from evaluation.studies.trial import Outcome, Status, Trial
from semgraph.errors import InputError

_PATH = "here, fast, trajectory_rmse_m"
_FOUND = "here, fast, map_recall"
_NEES = "here, fast, nees_mean"


def test_the_same_outcomes_are_as_before() -> None:
    figures = figures_of(_outcomes())
    assert set(figures) == {_PATH, _FOUND, _NEES}
    assert {each.verdict for each in judged(figures, figures)} == {Verdict.AS_BEFORE}


@pytest.mark.parametrize(
    ("name", "worse", "better"),
    [(_PATH, 1.0, 0.001), (_FOUND, 0.5, 0.999), (_NEES, 30.0, 3.0)],
)
def test_worse_fails_and_better_does_not(name: str, worse: float, better: float) -> None:
    before = figures_of(_outcomes())
    for value, verdict in ((worse, Verdict.WORSE), (better, Verdict.BETTER)):
        now = {**before, name: replace(before[name], value=value)}
        (changed,) = (each for each in judged(before, now) if each.name == name)
        assert changed.verdict is verdict
        assert changed.verdict.is_failure is (verdict is Verdict.WORSE)


def test_too_careful_is_as_bad_as_too_sure() -> None:
    before = {_NEES: Figure(3.2, "", Direction.EXPECTED, 0.1, 3.0)}
    for value in (2.5, 3.5):
        (each,) = judged(before, {_NEES: replace(before[_NEES], value=value)})
        assert each.verdict is Verdict.WORSE


def test_a_seed_that_turns_out_as_the_others_do_is_within_the_tolerance() -> None:
    before = figures_of(_outcomes((0.010, 0.012, 0.014, 0.020)))
    for values in ((0.010, 0.012, 0.020, 0.020), (0.014, 0.012, 0.014, 0.014)):
        now = figures_of(_outcomes(values))
        assert abs(now[_PATH].value - before[_PATH].value) <= before[_PATH].tolerance
    now = figures_of(_outcomes((0.010, 0.012, 0.014, 0.050)))
    (path, *_) = judged(before, now)
    assert path.verdict is Verdict.WORSE


@pytest.mark.parametrize(
    ("value", "tolerance"), [(0.0213, 0.001), (12.77, 1.0), (0.974, 0.01), (120.0, 1.2e-4)]
)
def test_one_seed_alone_has_the_readmes_digits(value: float, tolerance: float) -> None:
    figures = figures_of(_outcomes((value,)))
    assert figures[_PATH].tolerance == pytest.approx(tolerance)


def test_missing_fails() -> None:
    before, now = figures_of(_outcomes()), figures_of(_outcomes())
    del now[_FOUND]
    verdicts = {each.name: each.verdict for each in judged(before, now)}
    assert verdicts[_FOUND] is Verdict.MISSING
    assert verdicts[_FOUND].is_failure


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_fails(value: float) -> None:
    before = figures_of(_outcomes())
    (first, *rest) = _outcomes()
    broken = replace(first, metrics=(replace(first.metrics[0], value=value), *first.metrics[1:]))
    verdicts = {each.name: each.verdict for each in judged(before, figures_of((broken, *rest)))}
    assert verdicts[_PATH] is Verdict.NOT_A_NUMBER
    assert verdicts[_PATH].is_failure
    assert verdicts[_FOUND] is Verdict.AS_BEFORE


def test_a_metric_that_one_seed_lacks_is_no_number() -> None:
    (first, *rest) = _outcomes()
    now = figures_of((replace(first, metrics=first.metrics[1:]), *rest))
    (path, *_) = judged(figures_of(_outcomes()), now)
    assert path.verdict is Verdict.NOT_A_NUMBER


@pytest.mark.parametrize("status", [each for each in Status if each is not Status.FINISHED])
def test_a_crash_fails_with_its_reason(status: Status) -> None:
    (first, *rest) = _outcomes()
    crashed = replace(first, status=status, reason="the disk is full", metrics=())
    found = judged(figures_of(_outcomes()), figures_of((crashed, *rest)))
    assert {each.verdict for each in found} == {Verdict.CRASHED}
    assert all("the disk is full" in each.line for each in found)


def test_a_crash_of_what_has_no_baseline_fails_too() -> None:
    crashed = [replace(each, status=Status.FAILED, reason="no") for each in _outcomes()]
    found = judged({}, figures_of(crashed))
    assert [each.verdict for each in found] == [Verdict.CRASHED]


def test_an_update_takes_what_is_better_and_leaves_what_is_worse() -> None:
    before = figures_of(_outcomes())
    now = {
        _PATH: replace(before[_PATH], value=0.001),
        _FOUND: replace(before[_FOUND], value=0.1),
        "here, fast, new": Figure(1.0, "", Direction.LOWER, 0.0),
    }
    kept = updated(before, now, worse_too=False)
    assert kept[_PATH].value == 0.001
    assert kept[_FOUND] == before[_FOUND]
    assert kept[_NEES] == before[_NEES]
    assert "here, fast, new" in kept
    all_of_it = updated(before, now, worse_too=True)
    assert all_of_it[_FOUND].value == 0.1
    assert _NEES not in all_of_it


@pytest.mark.parametrize("worse_too", [False, True])
def test_no_update_takes_what_is_no_number(*, worse_too: bool) -> None:
    before = figures_of(_outcomes())
    now = {**before, _PATH: replace(before[_PATH], value=math.nan)}
    assert updated(before, now, worse_too=worse_too)[_PATH] == before[_PATH]


def test_a_baseline_comes_back_as_it_was_written(tmp_path: Path) -> None:
    figures = figures_of(_outcomes())
    write_baseline(tmp_path / "baseline.json", figures)
    assert read_baseline(tmp_path / "baseline.json") == figures


@pytest.mark.parametrize(
    "entry",
    [
        {"value": float("nan"), "unit": "m", "better": "lower", "tolerance": 0.0},
        {"value": 1.0, "unit": "m", "better": "smaller", "tolerance": 0.0},
        {"value": 1.0, "unit": "m", "better": "lower", "tolerance": -1.0},
        {"value": 1.0, "unit": "m", "better": "lower"},
    ],
)
def test_a_damaged_baseline_is_refused(tmp_path: Path, entry: dict[str, object]) -> None:
    path = tmp_path / "baseline.json"
    path.write_text(json.dumps({_PATH: entry}))
    with pytest.raises(InputError, match=r"baseline\.json"):
        read_baseline(path)


def _outcomes(errors_m: tuple[float, ...] = (0.010, 0.011, 0.012, 0.014)) -> tuple[Outcome, ...]:
    return tuple(
        Outcome(
            Trial("baseline", "here", "course:perceptions", (), (), "fast", seed),
            Status.FINISHED,
            metrics=(
                Metric("trajectory_rmse_m", error_m, "m", Direction.LOWER),
                Metric("map_recall", 0.98 + 1e-3 * seed, "", Direction.HIGHER),
                Metric("nees_mean", 3.3 + 0.1 * seed, "", Direction.EXPECTED, 3.0),
            ),
        )
        for seed, error_m in enumerate(errors_m)
    )
