"""Figures of the graph in a process of its own: `semgraph bench online`."""

import os
import re
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from time import monotonic
from typing import Final

import numpy as np

from evaluation.benches.bench import Section
from evaluation.benches.bench_table import Better, Row
from semgraph.arrays import FloatArray
from semgraph.beside.graph_beside import GraphBeside, GraphInProcess
from semgraph.beside.online import OnlineSmoother
from semgraph.fast_estimator import FastStep
from semgraph.landmarks import Perceptions
from semgraph.pacing import Pace
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.results import LOOP_CLOSED, RunResult
from semgraph.settings import Settings
from semgraph.smoothed import Smoothed
from sensors.catalog import open_source
from sensors.measurements import Recording
from sensors.views import View

_IN_TIME_S: Final = 1.0
_SETTINGS: Final = Settings()
_NUM_KILLS: Final = 3


@dataclass(slots=True)
class Stopwatch:
    """A graph beside the scan path, and when each scan was let go and had been handed over."""

    graph: GraphBeside
    pace: Pace
    let_go_s: list[float] = field(default_factory=list)
    handed_over_s: list[float] = field(default_factory=list)

    def add(self, step: FastStep, perceptions: Perceptions, views: Sequence[View]) -> None:
        """As `GraphBeside`."""
        self.let_go_s.append(self.pace.let_go_s)
        self.graph.add(step, perceptions, views)
        self.handed_over_s.append(monotonic())

    def finish(self, note: Callable[[str], None]) -> Smoothed:
        """As `GraphBeside`."""
        return self.graph.finish(note)

    @property
    def latencies_s(self) -> FloatArray:
        """(n,) from the measurement to perceptions, pose and the handing over to the graph."""
        latencies_s: FloatArray = np.array(self.handed_over_s) - np.array(self.let_go_s)
        return latencies_s

    def closure_delays_s(self, result: RunResult) -> FloatArray:
        """(k,) of each closed loop, until it has corrected the pose that is reported.

        From the first scan of its update, for any of these may hold the sighting. Infinite where
        the run went on for a second without it.
        """
        if result.online is None:
            return np.empty(0)
        num_taken = np.arange(1, len(result.online.lags) + 1) - result.online.lags
        delays_s = []
        for scan in _closed(result.events):
            first_s = self.let_go_s[max(scan - _SETTINGS.smoother.update_every_scans + 1, 0)]
            in_force = np.flatnonzero(num_taken > scan)
            if len(in_force):
                delays_s.append(self.handed_over_s[in_force[0]] - first_s)
            elif self.handed_over_s[-1] - first_s > _IN_TIME_S:
                delays_s.append(np.inf)
        return np.array(delays_s)


@dataclass(slots=True)
class Killing:
    """A graph whose process is killed at some scans, while it is at work."""

    graph: OnlineSmoother
    scans: frozenset[int]
    _num_scans: int = 0

    def add(self, step: FastStep, perceptions: Perceptions, views: Sequence[View]) -> None:
        """As `GraphBeside`."""
        self.graph.add(step, perceptions, views)
        if self._num_scans in self.scans and self.graph.worker_pid is not None:
            os.kill(self.graph.worker_pid, signal.SIGKILL)
        self._num_scans += 1

    def finish(self, note: Callable[[str], None]) -> Smoothed:
        """As `GraphBeside`."""
        return self.graph.finish(note)


@dataclass(frozen=True, slots=True)
class _Nothing:
    """No graph at all."""

    def add(self, step: FastStep, perceptions: Perceptions, views: Sequence[View]) -> None:
        """As `GraphBeside`."""

    def finish(self, note: Callable[[str], None]) -> Smoothed:
        """As `GraphBeside`."""
        note("no graph")
        return Smoothed()


@dataclass(frozen=True, slots=True)
class Drive:
    """A course played at `speed` times real time."""

    course: str
    options: Mapping[str, object]
    speed: float

    def recording(self, seed: int) -> Recording:
        """What the estimators may see of it."""
        return open_source(self.course, {**self.options, "seed": seed}).recording

    def played(self, recording: Recording, graph: GraphBeside) -> tuple[Stopwatch, RunResult]:
        """A run in time, with this graph beside it."""
        pace = Pace(self.speed)
        watch = Stopwatch(graph, pace)
        return watch, _run(recording, watch, pace)


def in_time(drive: Drive, seeds: Sequence[int]) -> list[Row]:
    """The scan path's latency, and how soon a closed loop corrects the pose."""
    without, beside, within, delays_s = [], [], [], []
    for seed in seeds:
        recording = drive.recording(seed)
        without.append(drive.played(recording, _Nothing())[0].latencies_s)
        here = GraphInProcess(_SETTINGS.smoother, recording.map_T_start)
        within.append(drive.played(recording, here)[0].latencies_s)
        with _online(recording) as graph:
            watch, result = drive.played(recording, graph)
        beside.append(watch.latencies_s)
        delays_s.append(watch.closure_delays_s(result))
    off_ms, on_ms, same_ms = (
        1e3 * float(np.quantile(np.concatenate(each), 0.99)) for each in (without, beside, within)
    )
    closures_s = np.concatenate(delays_s)
    slowest_s = float(closures_s.max()) if len(closures_s) else np.nan
    return [
        Row("scan path, p99", on_ms, "ms", Better.LOWER, 40.0),
        Row("the same / without a graph", on_ms / off_ms, "", Better.LOWER, 1.3),
        Row("the same / with the graph in its process", on_ms / same_ms, "", Better.LOWER, 1.0),
        Row("closed loop in the reported pose, slowest", slowest_s, "s", Better.LOWER, _IN_TIME_S),
    ]


def killed(seeds: Sequence[int]) -> list[Row]:
    """How many runs come out otherwise when the graph's process is killed at work."""
    differing = sum(not _is_same_after_kills(seed) for seed in seeds)
    return [Row("runs that differ after 3 kills", differing, "", Better.LOWER, 0.0)]


def _is_same_after_kills(seed: int) -> bool:
    recording = open_source("course:perceptions", {"seed": seed}).recording
    scans = np.random.default_rng(seed).integers(50, recording.num_scans, _NUM_KILLS)
    with _online(recording) as graph:
        alone = _run(recording, graph)
    with _online(recording) as graph:
        disturbed = _run(recording, Killing(graph, frozenset(scans.tolist())))
    return is_same(alone, disturbed)


def is_same(one: RunResult, other: RunResult) -> bool:
    """Whether the graphs of two runs agree to the last bit."""
    return (
        len(one.smoothed) > 0
        and np.array_equal(one.smoothed.map_T_bases, other.smoothed.map_T_bases)
        and np.array_equal(one.smoothed_covariances, other.smoothed_covariances)
        and [each.id for each in one.landmarks] == [each.id for each in other.landmarks]
        and all(
            np.array_equal(a.map_t_landmark, b.map_t_landmark)
            and np.array_equal(a.covariance, b.covariance)
            for a, b in zip(one.landmarks, other.landmarks, strict=True)
        )
    )


def _online(recording: Recording) -> OnlineSmoother:
    return OnlineSmoother(_SETTINGS.smoother, _SETTINGS.online, recording.map_T_start)


def _run(recording: Recording, graph: GraphBeside, pace: Pace | None = None) -> RunResult:
    perceiver = Perceiver(recording, _SETTINGS)
    return run(recording, _SETTINGS, perceiver, Silence(), {}, graph=graph, pace=pace)


def _closed(events: Sequence[str]) -> list[int]:
    """The scans at which loops were closed."""
    found = [re.match(rf"{LOOP_CLOSED} at scan (\d+)", event) for event in events]
    return [int(match[1]) for match in found if match is not None]


SECTIONS: Final = (
    Section(
        "scans, real time", (partial(in_time, Drive("course:paper", {"lap_s": 25.0}, 1.0)),), 3.0
    ),
    Section("perceptions, 25 Hz", (partial(in_time, Drive("course:perceptions", {}, 2.5)),), 2.0),
    Section("its process killed", (killed,), 1.0),
)
