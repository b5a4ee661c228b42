"""Figures of whole runs over real recordings, with the default settings; seeds do not matter."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from evaluation.benches.bench import Section
from evaluation.benches.bench_replay import SOURCE as GRAPH
from evaluation.benches.bench_replay import replay
from evaluation.benches.bench_runs import run_source
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import each_seed
from evaluation.benches.plain_loop import KnownGraph, every_pose, every_scan, plain_loop
from evaluation.metrics import judge
from evaluation.trajectory import trajectory_difference
from semgraph.settings import Settings
from sensors.catalog import open_source

CAR_PARK: Final = "car_park"
VICTORIA_PARK: Final = "victoria_park"
MRCLAM: Final = "mrclam6"
WILD: Final = "wild_v03"

Case = tuple[str, Mapping[str, object]]
# The optimum with known identities, of robots 1 to 5, and what may be lost without them.
_MRCLAM_M: Final = (0.093, 0.100, 0.104, 0.114, 0.161)
_MRCLAM_SHARE: Final = 1.15
_GRAPH_LANDMARKS: Final = (148, 154)


def sections(data: Path) -> tuple[Section, ...]:
    """Each recording in a section of its own, left out where its folder is not in `data`."""
    return (
        Section("real: car park", (partial(_car_park, data),), 0.1),
        Section("real: Victoria Park", (partial(_victoria_park, data),), 2.2),
        Section("real: Victoria Park's graph, identities stripped", (_graph,), 0.3),
        Section("real: MRCLAM, identities stripped", (partial(_mrclam, data),), 0.5),
        Section("real: Wild-Places", (partial(_wild, data),), 5.0),
    )


def metrics(case: Case) -> dict[str, float]:
    """Of a run over a source with some options, all that can be judged, by name."""
    place, options = case
    source = open_source(place, options)
    return {each.name: each.value for each in judge(run_source(source), source.truth)}


def _car_park(data: Path, seeds: Sequence[int]) -> list[Row]:  # noqa: ARG001 - figures take seeds
    (found,) = each_seed(metrics, [(str(data / CAR_PARK), {})])
    return [
        _lower(found, "trajectory_rmse_m", "path, RMSE", 0.068),
        _lower(found, "map_rmse_m", "beacons, RMSE", 0.031),
        Row("beacons found of 15", found["landmarks_found"], "", Better.HIGHER, 15.0),
        Row("landmarks that are none", found["landmarks_false"], "", Better.LOWER, 0.0),
    ]


def _victoria_park(data: Path, seeds: Sequence[int]) -> list[Row]:  # noqa: ARG001
    (found,) = each_seed(metrics, [(str(data / VICTORIA_PARK), {})])
    return [
        _lower(found, "trajectory_median_m", "path to GPS, median of all fixes", 0.5),
        _lower(found, "trajectory_rmse_m", f"path to GPS, RMSE, {_outliers(found)}", 1.2),
    ]


def _outliers(found: Mapping[str, float]) -> str:
    outliers, compared = (found[f"reference_{name}"] for name in ("outliers", "compared"))
    return f"without {outliers:.0f} outliers of {compared:.0f} fixes"


def _graph(seeds: Sequence[int]) -> list[Row]:  # noqa: ARG001
    ((difference_m, num_landmarks),) = each_seed(_beside_the_known, [GRAPH])
    low, high = _GRAPH_LANDMARKS
    name = "path to the optimum with known identities, RMSE"
    return [
        Row(name, difference_m, "m", Better.LOWER, 0.10),
        Row("landmarks, tentative ones too, at least", num_landmarks, "", Better.HIGHER, low),
        Row("landmarks, tentative ones too, at most", num_landmarks, "", Better.LOWER, high),
    ]


def _beside_the_known(name: str) -> tuple[float, int]:
    """How far a run without identities lies from the optimum with them, and its landmarks.

    Of the published 151, too, 28 are sighted once.
    """
    known = open_source(name, {"identities": True}).recording
    plain = plain_loop(every_pose(known), known.map_T_start)
    graph = KnownGraph(every_scan(known), known.map_T_start)
    optimum = graph.optimum(plain, replay(known, Settings()).solution)
    result = run_source(open_source(name, {}))
    sighted = np.unique(np.concatenate(list(result.associations.values())))
    difference_m = trajectory_difference(result.smoothed, optimum.trajectory)
    return difference_m, int(np.count_nonzero(sighted >= 0))


def _mrclam(data: Path, seeds: Sequence[int]) -> list[Row]:  # noqa: ARG001
    robots = range(1, 1 + len(_MRCLAM_M))
    cases = [(str(data / MRCLAM), {"robot": robot, "identities": False}) for robot in robots]
    return [
        _lower(found, "trajectory_rmse_m", f"path of robot {robot}, RMSE", _MRCLAM_SHARE * limit_m)
        for robot, found, limit_m in zip(robots, each_seed(metrics, cases), _MRCLAM_M, strict=True)
    ]


def _wild(data: Path, seeds: Sequence[int]) -> list[Row]:  # noqa: ARG001
    cases = [(str(data / WILD), {"odometry": odometry}) for odometry in ("noisy-truth", "none")]
    with_wheels, without = each_seed(metrics, cases)
    return [
        _lower(with_wheels, "trajectory_rmse_m", "path with odometry, RMSE", 0.45),
        _lower(without, "trajectory_rmse_m", "path without odometry, RMSE", 0.6),
    ]


def _lower(found: Mapping[str, float], metric: str, name: str, target: float) -> Row:
    """A row in m; NaN where the run has no such metric."""
    return Row(name, found.get(metric, float("nan")), "m", Better.LOWER, target)
