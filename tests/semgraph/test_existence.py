"""Log odds of being there."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.existence import Existence
from semgraph.geometry import Pose2


def looked_at(outcomes: list[bool], reliability: float = 1.0, step_m: float = 0.5) -> Existence:
    existence = Existence()
    for k, is_hit in enumerate(outcomes):
        place = Pose2(step_m * k, 0.0, 0.0)
        if is_hit:
            existence.hit(place, reliability)
        else:
            existence.miss(place)
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
    existence.miss(Pose2(1.0, 0.1, 0.0))
    assert existence.log_odds == once


@pytest.mark.parametrize("num_hits", [2, 5, 500])
def test_five_misses_end_even_the_surest(num_hits: int) -> None:
    assert looked_at([True] * num_hits + [False] * 5).is_gone


def test_one_or_two_misses_end_nothing_that_is_sure() -> None:
    existence = looked_at([True] * 10 + [False] * 2)
    assert not existence.is_gone
    assert looked_at([True] * 10 + [False] * 2 + [True]).is_there


def test_clutter_that_fires_now_and_then_where_it_is_looked_for_is_not_there() -> None:
    assert not looked_at([True, False, False] * 5).is_there


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_more_reliable_the_more_it_says(first: float, second: float) -> None:
    low, high = sorted((first, second))
    assert looked_at([True], low).log_odds <= looked_at([True], high).log_odds
    assert looked_at([True], low).log_odds >= Existence().log_odds
