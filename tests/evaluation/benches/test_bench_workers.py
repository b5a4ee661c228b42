"""Trials in processes: in order, told one by one, their errors brought home."""

import os
from collections.abc import Callable, Sequence
from functools import partial

import pytest

from evaluation.benches import bench_workers
from evaluation.benches.bench import Section, measure
from evaluation.benches.bench_table import Row
from evaluation.benches.bench_workers import alone, each_seed
from semgraph.errors import InputError, SemgraphError


def trial(seed: int) -> int:
    if seed == 13:
        raise InputError("unlucky")
    return seed**2


def half_way(fault: str, tell: Callable[[float], None]) -> int:
    tell(0.5)
    if fault == "refused":
        raise InputError("no such thing")
    if fault == "killed":
        os._exit(9)
    return os.getpid()


class Told(list[int]):
    def done(self, count: int) -> None:
        self.append(count)

    def note(self, text: str) -> None:
        pass


def test_outcomes_come_in_the_order_of_the_seeds_and_each_is_told() -> None:
    outcomes: list[int] = []

    def figures(seeds: Sequence[int]) -> list[Row]:
        outcomes.extend(each_seed(trial, seeds))
        return []

    told = Told()
    measure([Section("one", (figures,), 1.0)], range(4), told)
    assert outcomes == [0, 1, 4, 9]
    assert told == [25, 50, 75, 100]


def test_more_trials_than_a_process_takes_all_come_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_workers, "_TRIALS_A_PROCESS", 1)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    seeds = range(20, 25)
    assert each_seed(trial, seeds) == [seed**2 for seed in seeds]


def test_what_is_missing_in_a_worker_is_said() -> None:
    with pytest.raises(InputError, match="unlucky"):
        each_seed(trial, [1, 13, 2])


def test_a_trial_alone_has_a_process_of_its_own() -> None:
    assert alone(partial(half_way, "")) != os.getpid()


@pytest.mark.parametrize(("fault", "words"), [("refused", "no such thing"), ("killed", "with 9")])
def test_a_trial_alone_that_fails_is_a_known_error(fault: str, words: str) -> None:
    with pytest.raises(SemgraphError, match=words):
        alone(partial(half_way, fault))
