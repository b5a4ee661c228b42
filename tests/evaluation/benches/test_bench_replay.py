"""The smoother replayed on a course with identities: its calls are timed, its result is whole."""

from dataclasses import replace

import pytest

from evaluation.benches.bench_replay import replay
from evaluation.benches.plain_loop import KnownGraph, every_pose, every_scan, plain_loop
from semgraph.errors import InputError
from semgraph.settings import Settings
from tests.evaluation.known_course import known_course


def test_a_replay_reaches_the_optimum_and_times_every_update() -> None:
    recording = known_course().recording
    replayed = replay(recording, Settings())
    graph = KnownGraph(every_scan(recording), recording.map_T_start)
    best = graph.optimum(plain_loop(every_pose(recording), recording.map_T_start))
    assert graph.cost(replayed.solution) == pytest.approx(graph.cost(best), rel=1e-2)
    every = Settings().smoother.update_every_scans
    assert len(replayed.update_seconds) == recording.num_scans // every
    assert 0.0 < replayed.update_seconds.sum() <= 10.0 * replayed.cpu_s + 1.0


def test_nothing_to_replay_is_refused() -> None:
    recording = replace(known_course().recording, measurements=())
    with pytest.raises(InputError, match="there are none"):
        replay(recording, Settings())
