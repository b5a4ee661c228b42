"""Figures of the graph in a process of its own."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.benches.bench_online import (
    SECTIONS,
    Drive,
    Killing,
    Stopwatch,
    in_time,
    is_same,
)
from evaluation.benches.bench_runs import run_course
from semgraph.beside.graph_beside import GraphInProcess
from semgraph.beside.online import OnlineSmoother
from semgraph.estimates import Trajectory
from semgraph.pacing import Pace
from semgraph.results import RunResult
from semgraph.settings import Settings
from semgraph.smoothed import Online

SHORT: dict[str, object] = {
    "track_radius_m": 10.0,
    "num_trees": 40,
    "lap_s": 12.0,
    "overlap_s": 3.0,
}
SETTINGS = Settings()


@pytest.fixture(scope="module")
def result() -> RunResult:
    return run_course("course:perceptions", **SHORT, seed=4)[1]


def test_a_short_drive_gives_figures_in_time() -> None:
    rows = in_time(Drive("course:perceptions", SHORT, 5.0), [4])
    values = {row.name: row.value for row in rows}
    assert len(values) == 4
    assert 0.0 < values["scan path, p99"] < 1e3
    assert 0.1 < values["the same / without a graph"] < 100.0
    # NaN, which reaches no target, if the course ended too soon after its loop was closed.
    assert not values["closed loop in the reported pose, slowest"] <= 0.0


def test_a_closure_counts_from_its_updates_first_scan_until_the_pose_reported_has_it(
    result: RunResult,
) -> None:
    n = 50
    every = SETTINGS.smoother.update_every_scans
    watch = Stopwatch(GraphInProcess(SETTINGS.smoother, result.smoothed.pose(0)), Pace())
    watch.let_go_s = (0.1 * np.arange(n)).tolist()
    watch.handed_over_s = (0.1 * np.arange(n) + 0.01).tolist()
    some = Trajectory(result.fast.stamps_ns[:n], result.fast.map_T_bases[:n])

    def delays_s(lags: list[int], *scans: int) -> list[float]:
        events = tuple(f"loop closed at scan {scan}: tree 7 is 1" for scan in scans)
        online = Online(some, np.empty(0), np.array(lags))
        found = replace(result, events=("rebuilt", *events), online=online)
        return [float(delay_s) for delay_s in watch.closure_delays_s(found)]

    # Scan 20 is in the graph with scan 23.
    late = [1] * 20 + [1, 2, 3, 3] + [1] * 26
    assert delays_s(late, 20) == pytest.approx([0.1 * (23 - 21 + every) + 0.01])
    never = [1] * 20 + list(range(1, 31))
    assert delays_s(never, 30) == [np.inf]
    assert delays_s(never, 48) == []
    assert delays_s(late) == []
    assert watch.closure_delays_s(result).tolist() == []


def test_a_killed_process_is_seen_and_a_differing_run_too(result: RunResult) -> None:
    recording = Drive("course:perceptions", SHORT, 1.0).recording(4)
    with OnlineSmoother(SETTINGS.smoother, SETTINGS.online, recording.map_T_start) as graph:
        disturbed = Drive("", {}, np.inf).played(recording, Killing(graph, frozenset({100})))[1]
    assert disturbed.online is not None
    assert disturbed.online.num_restarts == 1
    assert is_same(result, disturbed)
    moved = Trajectory(result.smoothed.stamps_ns, np.nextafter(result.smoothed.map_T_bases, np.inf))
    assert not is_same(result, replace(result, smoothed=moved))
    assert not is_same(result, replace(result, landmarks=result.landmarks[1:]))


def test_sections_have_names_of_their_own() -> None:
    assert len({section.name for section in SECTIONS}) == len(SECTIONS)
