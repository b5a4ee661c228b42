"""Means, bins and times of a bench; none of nothing."""

import math
import time

import numpy as np
import pytest

from evaluation.benches.bench_statistics import mean, median_ms, rms, worst_bin


def test_nothing_has_no_mean() -> None:
    assert math.isnan(mean(np.zeros(0)))
    assert math.isnan(rms(np.zeros(0)))
    assert mean(np.array([True, False])) == 0.5
    assert rms(np.array([3.0, 4.0])) == pytest.approx(math.sqrt(12.5))


def test_the_worst_bin_is_the_worst_that_is_large_enough() -> None:
    said = np.array([0.15] * 10 + [0.95] * 10 + [0.55])
    right = np.array([True] * 3 + [False] * 7 + [True] * 10 + [False])
    assert worst_bin(said, right, 5) == pytest.approx(0.15)
    assert worst_bin(said, right, 1) == pytest.approx(0.55)
    assert math.isnan(worst_bin(said, right, 100))
    assert worst_bin(np.ones(3), np.ones(3, dtype=bool), 1) == 0.0


def test_each_call_is_made_twice_and_timed_once() -> None:
    calls: list[int] = []

    def work() -> None:
        calls.append(1)
        until = time.process_time() + 0.002
        while time.process_time() < until:
            pass

    assert 1.9 < median_ms([work, work, work]) < 10.0
    assert len(calls) == 6
