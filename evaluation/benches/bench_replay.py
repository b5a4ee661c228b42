"""What the smoother costs beside the plain loop, on Victoria Park's graph with its identities."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.benches.bench import Section
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import Tell, alone
from evaluation.benches.plain_loop import KnownGraph, Solution, every_pose, every_scan, plain_loop
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.fast_estimator import FastEstimator
from semgraph.files.yaw_rates import YawRateLog
from semgraph.graph.smoother import Smoother
from semgraph.moments import moments
from semgraph.perceiving import Perceiver
from semgraph.settings import Settings
from sensors.catalog import open_source
from sensors.measurements import Recording

SOURCE: Final = "victoria-park-graph"


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """A whole recording through the smoother.

    Attributes:
        cpu_s: of all calls of the smoother, the end's included; not of the tracker before it.
        update_seconds: (k,) each call of `add` that takes in what came since the last update.
        solution: what came out.
    """

    cpu_s: float
    update_seconds: FloatArray
    solution: Solution


def replay(recording: Recording, settings: Settings) -> Replay:
    """All perceptions of a recording, scan by scan, and the end.

    Raises:
        InputError: no perceptions.
    """
    tracker = FastEstimator(settings.tracker, recording.map_T_start)
    smoother = Smoother(settings.smoother, recording.map_T_start)
    perceiver = Perceiver(recording, settings)
    cpu_s, seconds = 0.0, list[float]()
    for moment in moments(recording, perceiver, YawRateLog()):
        step = tracker.step(moment.perceptions, moment.odometry)
        started, cpu_before = time.perf_counter(), time.process_time()
        smoother.add(step, moment.perceptions, moment.views)
        cpu_s += time.process_time() - cpu_before
        seconds.append(time.perf_counter() - started)
    if not seconds:
        raise InputError(f"{recording.name}: expected perceptions, there are none")
    cpu_before = time.process_time()
    smoother.finish(lambda _: None)
    cpu_s += time.process_time() - cpu_before
    every = settings.smoother.update_every_scans
    places = {each.semantics.identity: each.map_t_landmark for each in smoother.landmarks()}
    solution = Solution(smoother.trajectory(), places)
    return Replay(cpu_s, np.array(seconds[every - 1 :: every]), solution)


def beside_the_plain_loop(seeds: Sequence[int]) -> list[Row]:  # noqa: ARG001 - figures take seeds
    """CPU, latency and cost; both in one process of their own, one after the other."""
    return alone(_beside_the_plain_loop)


def _beside_the_plain_loop(tell: Tell) -> list[Row]:
    recording = open_source(SOURCE, {"identities": True}).recording
    start, steps = recording.map_T_start, every_pose(recording)
    graph = KnownGraph(every_scan(recording), start)
    cpu_before = time.process_time()
    plain = plain_loop(steps, start)
    plain_cpu_s = time.process_time() - cpu_before
    tell(0.4)
    replayed = replay(recording, Settings())
    tell(0.9)
    optimum = graph.optimum(plain, replayed.solution)
    cost = graph.cost(replayed.solution) / graph.cost(optimum)
    slowest_s = replayed.update_seconds
    return [
        Row("CPU / plain loop's", replayed.cpu_s / plain_cpu_s, "", Better.LOWER, 0.2),
        Row("update, p99", 1e3 * float(np.quantile(slowest_s, 0.99)), "ms", Better.LOWER, 10.0),
        Row("update, max", 1e3 * float(slowest_s.max()), "ms", Better.LOWER, 60.0),
        Row("final cost / batch optimum's", cost, "", Better.LOWER, 1.001),
    ]


SECTION: Final = Section("replay", (beside_the_plain_loop,), 0.3)
