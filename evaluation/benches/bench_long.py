"""A course of many kilometres: whether the smoother's cost and memory grow with the time driven."""

import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from mmap import PAGESIZE
from pathlib import Path
from typing import Final

import numpy as np

from evaluation.benches.bench import Section
from evaluation.benches.bench_runs import known
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import Tell, alone
from evaluation.trajectory import compare_path, rmse
from semgraph.arrays import BoolArray, FloatArray
from semgraph.errors import InputError
from semgraph.fast_estimator import FastEstimator
from semgraph.files.yaw_rates import YawRateLog
from semgraph.graph.smoother import Smoother
from semgraph.moments import Moment, moments
from semgraph.perceiving import Perceiver
from semgraph.settings import Settings
from sensors.catalog import open_source
from sensors.measurements import Recording
from sensors.truth import Source

_COURSE: Final = "course:lanes"
_MEMORY: Final = Path("/proc/self/statm")
_CLOSED: Final = re.compile(r"(?:loop closed|track resumed) at scan (\d+)")
_TELL_EVERY: Final = 200
# The first scans import what they need and fill what is kept anyway.
_WARM_UP: Final = 100


@dataclass(frozen=True, slots=True, eq=False)
class Costs:
    """What each scan of a long run cost.

    Attributes:
        cpu_s: (n,) of tracker and smoother.
        wall_s: (n,) of the smoother's call.
        is_closing: (n,) whether landmarks became one in it.
        bytes_a_scan: by which the process grew.
        path_rmse_m: after the end, which is not measured: who is lost is quick.
    """

    cpu_s: FloatArray
    wall_s: FloatArray
    is_closing: BoolArray
    bytes_a_scan: float
    path_rmse_m: float


def rows(costs: Costs) -> list[Row]:
    """Growth, memory, and the longest calls."""
    tenth = max(len(costs.cpu_s) // 10, 1)
    growth = float(costs.cpu_s[-tenth:].mean() / costs.cpu_s[:tenth].mean())
    longest_s, closing_s = (
        float(costs.wall_s[rows].max(initial=0.0)) for rows in (~costs.is_closing, costs.is_closing)
    )
    return [
        Row("CPU a scan, last tenth / first", growth, "", Better.LOWER, 1.5),
        Row("memory a scan", costs.bytes_a_scan / 1000.0, "kB", Better.LOWER, 2.0),
        Row("longest update without a closure", 1e3 * longest_s, "ms", Better.LOWER, 250.0),
        Row("longest update with a closure", 1e3 * closing_s, "ms", Better.LOWER, 1500.0),
        Row("path, RMSE", costs.path_rmse_m, "m", Better.LOWER, 1.0),
    ]


def drive(source: Source, tell: Tell) -> Costs:
    """The costs of a source's scans, one by one.

    Raises:
        InputError: this system does not say how much memory a process has; or no path is known.
    """
    recording, settings = source.recording, Settings()
    tracker = FastEstimator(settings.tracker, recording.map_T_start)
    smoother = Smoother(settings.smoother, recording.map_T_start)
    n = recording.num_scans
    cpu_s, wall_s, before = np.zeros(n), np.zeros(n), 0
    for k, moment in enumerate(_moments(recording, settings)):
        cpu_s[k], wall_s[k] = _timed(tracker, smoother, moment)
        if k == min(_WARM_UP, n - 1):
            before = _resident_bytes()
        if k % _TELL_EVERY == 0:
            tell(k / n)
    bytes_a_scan = (_resident_bytes() - before) / max(n - _WARM_UP, 1)
    is_closing = np.zeros(n, dtype=np.bool_)
    is_closing[[int(found[1]) for found in map(_CLOSED.match, smoother.events) if found]] = True
    smoother.finish(lambda _: None)
    errors = known(compare_path(smoother.trajectory(), known(source.truth.path)))
    return Costs(cpu_s, wall_s, is_closing, bytes_a_scan, rmse(errors.distances))


def _moments(recording: Recording, settings: Settings) -> Iterator[Moment]:
    return moments(recording, Perceiver(recording, settings), YawRateLog())


def _timed(tracker: FastEstimator, smoother: Smoother, moment: Moment) -> tuple[float, float]:
    """CPU seconds of both, wall seconds of the smoother."""
    cpu_before = time.process_time()
    step = tracker.step(moment.perceptions, moment.odometry)
    started = time.perf_counter()
    smoother.add(step, moment.perceptions, moment.views)
    return time.process_time() - cpu_before, time.perf_counter() - started


def _resident_bytes() -> int:
    try:
        return int(_MEMORY.read_text().split()[1]) * PAGESIZE
    except (OSError, ValueError, IndexError):
        raise InputError(f"expected {_MEMORY} to tell this process's memory (Linux)") from None


def _course(length_m: float, seed: int, tell: Tell) -> Costs:
    return drive(open_source(_COURSE, {"length_m": length_m, "seed": seed}), tell)


def _figures(length_m: float, seeds: Sequence[int]) -> list[Row]:
    """Of the first seed: a second one would tell the same."""
    return rows(alone(partial(_course, length_m, seeds[0])))


SECTIONS: Final = tuple(
    Section(f"long: {km} km", (partial(_figures, 1000.0 * km),), work, asked_only=True)
    for km, work in ((2, 1.0), (20, 60.0))
)
