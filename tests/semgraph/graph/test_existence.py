"""Log odds of being there."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.geometry import Pose2
from semgraph.graph.existence import Evidence, Existence, Tally


def looked_at(
    outcomes: list[bool], reliability: float = 1.0, step_m: float = 0.5, *, passed: bool = True
) -> Existence:
    existence, of_kind = Existence(), Tally(hits=850.0, looks=1000.0)
    for k, is_hit in enumerate(outcomes):
        place = Pose2(step_m * k, 0.0, 0.0)
        if is_hit:
            existence.hit(place, reliability, of_kind)
        else:
            existence.miss(place, of_kind, passed=passed)
    return existence


def test_one_look_makes_likely_two_from_apart_make_sure() -> None:
    assert not Existence().is_there
    assert not looked_at([True]).is_there
    assert looked_at([True]).log_odds > 0.0
    assert looked_at([True, True]).is_there


def test_looks_from_one_place_are_one_look() -> None:
    assert looked_at([True] * 50, step_m=0.001).log_odds == looked_at([True]).log_odds
    once = looked_at([True, True, False]).log_odds
    existence = looked_at([True, True, False])
    existence.miss(Pose2(1.0, 0.1, 0.0), Tally(), passed=True)
    assert existence.log_odds == once


@pytest.mark.parametrize("num_hits", [2, 5, 500])
def test_five_misses_end_even_the_surest(num_hits: int) -> None:
    assert looked_at([True] * num_hits + [False] * 5).is_gone


def test_one_or_two_misses_end_nothing_that_is_sure() -> None:
    existence = looked_at([True] * 10 + [False] * 2)
    assert not existence.is_gone
    assert looked_at([True] * 10 + [False] * 2 + [True]).is_there


def test_what_was_there_is_not_gone_as_long_as_beams_meet_something_in_its_place() -> None:
    assert looked_at([True] * 10 + [False] * 50, passed=False).is_there
    assert not looked_at([True] * 10 + [False] * 50, passed=True).is_there


def test_what_was_never_there_is_dropped_but_was_not_there() -> None:
    dropped = looked_at([True, False, False, False, False], passed=False)
    assert dropped.log_odds < looked_at([True]).log_odds
    assert not dropped.was_there
    assert looked_at([True, True] + [False] * 5).was_there


def test_what_is_seldom_perceived_is_not_gone_for_being_missed() -> None:
    now_and_then = [True, False, False, False] * 10
    assert not looked_at(now_and_then + [False] * 3, passed=False).is_gone


def test_what_fires_now_and_then_where_it_is_looked_for_is_not_there_at_once() -> None:
    assert not looked_at([True, False, False] * 2, passed=False).is_there


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_more_reliable_the_more_it_says(first: float, second: float) -> None:
    low, high = sorted((first, second))
    assert looked_at([True], low).log_odds <= looked_at([True], high).log_odds
    assert looked_at([True], low).log_odds >= Existence().log_odds


def test_what_is_perceived_as_usual_is_as_reliable_as_usual() -> None:
    evidence = Evidence()
    for _ in range(100):
        evidence.look(0.9)
    assert evidence.reliability(usual=0.9) == pytest.approx(0.9)


@given(st.floats(0.02, 0.98), st.integers(1, 200))
def test_less_than_usual_is_evidence_against_however_often_it_is_perceived(
    reliability: float, num_looks: int
) -> None:
    evidence = Evidence()
    for _ in range(num_looks):
        evidence.look(reliability)
    assert evidence.reliability(usual=0.99) <= reliability + 1e-9
    assert evidence.reliability(usual=0.01) >= reliability - 1e-9


def test_what_is_always_sure_is_believed() -> None:
    evidence = Evidence()
    evidence.look(1.0)
    assert evidence.reliability(usual=1.0) > 0.99
