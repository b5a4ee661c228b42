"""A recording in time: nothing before its stamp, and lateness is told."""

import time

import pytest

from semgraph.errors import InputError
from semgraph.pacing import Pace


def test_nothing_comes_before_its_time() -> None:
    pace = Pace(2.0)
    started = time.monotonic()
    for k in range(5):
        pace.wait(7_000_000_000 + 100_000_000 * k)
        assert time.monotonic() - started >= 0.05 * k
    assert pace.let_go_s >= started + 0.2


def test_what_is_late_is_let_go_at_once_and_told() -> None:
    pace = Pace(1.0)
    pace.wait(0)
    time.sleep(0.2)
    before = time.monotonic()
    pace.wait(100_000_000)
    assert time.monotonic() - before < 0.05
    assert 0.1 <= pace.late_s < 1.0
    assert "late by at most 0.1" in pace.events[0] or pace.late_s >= 0.2


def test_without_a_speed_it_goes_as_fast_as_it_can() -> None:
    pace = Pace()
    started = time.monotonic()
    for k in range(100):
        pace.wait(10**12 * k)
    assert time.monotonic() - started < 1.0
    assert (pace.events, pace.late_s) == ((), 0.0)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_a_speed_is_positive(speed: float) -> None:
    with pytest.raises(InputError, match="positive"):
        Pace(speed)
