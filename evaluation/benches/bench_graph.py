"""Figures of the graph beside the optimum with true associations: `semgraph bench graph`."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from evaluation.alignment import rigid_alignment
from evaluation.benches import bench_faults, bench_long, bench_real, bench_replay
from evaluation.benches.bench import Section
from evaluation.benches.bench_runs import known, run_course
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import each_seed
from evaluation.consistency import bounds_of_mean, gauge, landmark_nees, pose_nees
from evaluation.landmarks import compare_map
from evaluation.oracle import Oracle, oracle
from evaluation.trajectory import compare_path, rmse
from semgraph.arrays import IntArray
from semgraph.landmarks import Landmark
from semgraph.results import RunResult
from semgraph.settings import Settings
from sensors.truth import Source

Options = Mapping[str, object]

STEM_MAPS: Final = Path("stem_maps")
_ROUND: Final = "course:perceptions"
_SCANS: Final = "course:paper"
_EIGHT: Final = "course:eight"
_WIDE: Final = {"track_radius_m": 60.0, "num_trees": 200, "max_range_m": 15.0, "lap_s": 135.0}
_ODOMETRY: Final = {"odometry": True}
_BLIND: Final = {"num_blind": 3, "blind_s": 1.0}
_MOVING: Final = {"moving": 0.05}
_WRONG_SIGHTINGS: Final = 3


@dataclass(frozen=True, slots=True)
class Outcome:
    """One run beside the oracle.

    Attributes:
        path_ratio, map_ratio: RMSE, rigidly aligned, by the oracle's.
        pose_nees, landmark_nees: means over the run.
        num_landmarks, num_duplicates: of the map.
        num_mixed: landmarks that hold sightings of two true ones.
        num_closures: loops closed.
    """

    path_ratio: float
    map_ratio: float
    pose_nees: float
    landmark_nees: float
    num_landmarks: int
    num_duplicates: int
    num_mixed: int
    num_closures: int


def outcome(source: Source, result: RunResult, best: Oracle) -> Outcome:
    """The figures of a run on a course whose truth is known whole."""
    path, true = known(source.truth.path), known(source.truth.landmarks)
    smoothed = known(compare_path(result.smoothed, path))
    landmarks = real_landmarks(best.associations, result)
    errors = known(compare_map(landmarks, source.truth, smoothed.world_T_map))
    start = known(gauge(result.smoothed, path))
    return Outcome(
        rmse(smoothed.distances) / rmse(known(compare_path(best.trajectory, path)).distances),
        rmse(np.linalg.norm(errors.errors, axis=1)) / _map_rmse(source, best),
        float(np.nanmean(pose_nees(result.smoothed, result.smoothed_covariances, path, start))),
        float(np.nanmean(landmark_nees(landmarks, true, errors, start))),
        len(result.landmarks),
        len(errors.duplicates),
        num_mixed(best.associations, result),
        sum(event.startswith("loop closed") for event in result.events),
    )


def num_mixed(truly: Mapping[int, IntArray], result: RunResult) -> int:
    """How many landmarks of the map hold three sightings or more of a second true one.

    Args:
        truly: by stamp, the true landmark of each perception (n,), -1 for none.
        result: of a run over the same perceptions.
    """
    seconds = [
        sorted(row_counts.values())[-2]
        for row_counts in map(_of_true, _sightings(truly, result).values())
        if len(row_counts) > 1
    ]
    return sum(second >= _WRONG_SIGHTINGS for second in seconds)


def real_landmarks(truly: Mapping[int, IntArray], result: RunResult) -> list[Landmark]:
    """The landmarks of a map without those that mostly hold perceptions of nothing.

    A clump of twigs half a metre from a sapling nobody saw would be taken for it.
    """
    sightings = _sightings(truly, result)
    return [
        landmark
        for landmark in result.landmarks
        if 2 * sum(_of_true(sightings[landmark.id]).values()) >= sightings[landmark.id].total()
    ]


def _sightings(truly: Mapping[int, IntArray], result: RunResult) -> dict[int, Counter[int]]:
    """By landmark of the map, how many of its perceptions are of each true one, -1 for none."""
    counts = {landmark.id: Counter[int]() for landmark in result.landmarks}
    for stamp_ns, landmarks in result.associations.items():
        for landmark, row in zip(landmarks.tolist(), truly[stamp_ns].tolist(), strict=True):
            if landmark in counts:
                counts[landmark][row] += 1
    return counts


def _of_true(counts: Counter[int]) -> Counter[int]:
    """Without those of nothing."""
    return Counter({row: count for row, count in counts.items() if row >= 0})


def _map_rmse(source: Source, best: Oracle) -> float:
    true = known(source.truth.landmarks).world_t_landmarks[list(best.map_t_landmarks)]
    places = np.array(list(best.map_t_landmarks.values()))
    aligned = rigid_alignment(true, places).transform(places)
    return rmse(np.linalg.norm(aligned - true, axis=1))


def _trial(course: str, options: Options, seed: int) -> Outcome:
    source, result = run_course(course, seed=seed, **options)
    return outcome(source, result, oracle(source, Settings()))


def _figures(
    rows: Callable[[Sequence[Outcome]], list[Row]], course: str, options: Options
) -> Callable[[Sequence[int]], list[Row]]:
    def figures(seeds: Sequence[int]) -> list[Row]:
        return rows(each_seed(partial(_trial, course, options), seeds))

    return figures


def as_good_as_the_oracle(outcomes: Sequence[Outcome]) -> list[Row]:
    """Ratios, what was wrongly made one or left two, closed loops, and honest covariances."""
    ratios, of_map = (
        np.array([getattr(each, name) for each in outcomes]) for name in ("path_ratio", "map_ratio")
    )
    landmarks = sum(each.num_landmarks for each in outcomes)
    return [
        Row("path, RMSE / oracle's, median", float(np.median(ratios)), "", Better.LOWER, 1.05),
        Row("path, RMSE / oracle's, p95", float(np.quantile(ratios, 0.95)), "", Better.LOWER, 1.3),
        Row("map, RMSE / oracle's, median", float(np.median(of_map)), "", Better.LOWER, 1.05),
        Row("map, RMSE / oracle's, p95", float(np.quantile(of_map, 0.95)), "", Better.LOWER, 1.3),
        _wrong_merges(outcomes),
        Row(
            "duplicates, share of landmarks",
            sum(each.num_duplicates for each in outcomes) / max(landmarks, 1),
            "",
            Better.LOWER,
            0.005,
        ),
        Row(
            "runs with a closed loop",
            float(np.mean([each.num_closures > 0 for each in outcomes])),
            "",
            Better.HIGHER,
            1.0,
        ),
        *_honest("pose", np.mean([each.pose_nees for each in outcomes]), 3, len(outcomes)),
        *_honest("landmark", np.mean([each.landmark_nees for each in outcomes]), 2, len(outcomes)),
    ]


def disturbed(outcomes: Sequence[Outcome]) -> list[Row]:
    """With clutter, misses, blindness or what moves."""
    ratio = float(np.median([each.path_ratio for each in outcomes]))
    return [
        Row("path, RMSE / oracle's, median", ratio, "", Better.LOWER, 1.2),
        _wrong_merges(outcomes),
    ]


def _wrong_merges(outcomes: Sequence[Outcome]) -> Row:
    mixed = sum(each.num_mixed for each in outcomes)
    return Row("landmarks made of two true ones", mixed, "", Better.LOWER, 0.0)


def _honest(what: str, nees: np.floating, dof: int, num_runs: int) -> list[Row]:
    """Not below and not above what chance allows."""
    low, high = bounds_of_mean(dof, num_runs)
    name = f"{what} NEES, mean of runs, {dof} dof"
    return [
        Row(f"{name}, at least", float(nees), "", Better.HIGHER, low),
        Row(f"{name}, at most", float(nees), "", Better.LOWER, high),
    ]


def _beside(name: str, work: float, course: str, *parts: Options) -> Section:
    """A course beside the oracle."""
    options = {key: value for part in parts for key, value in part.items()}
    return Section(name, (_figures(as_good_as_the_oracle, course, options),), work)


def _disturbed(name: str, work: float, course: str, *parts: Options) -> Section:
    """A course on which perception is worse than the estimator is told."""
    options = {key: value for part in parts for key, value in part.items()}
    return Section(f"disturbed {name}", (_figures(disturbed, course, options),), work)


def _clutter(trees_a_scan: float) -> Options:
    """A fifth of all perceptions is false and a fifth of the trees missed."""
    return {"clutter": 0.2 * trees_a_scan, "missed": 0.2}


def courses(data: Path) -> tuple[Section, ...]:
    """Simulated courses; the stem maps of some are files of real data.

    `longleaf` is an open stand, with clearings from which no tree is in sight for seconds; `waka` a
    dense one, whose eight of 1 km is driven two and a half times.
    """
    longleaf, waka = (
        {"stem_map": data / STEM_MAPS / name} for name in ("longleaf.csv", "waka.csv")
    )
    all_at_once: Options = {**_BLIND, **_MOVING}
    return (
        _beside("paper, no odometry", 1.0, _ROUND),
        _beside("paper, odometry", 1.0, _ROUND, _ODOMETRY),
        _beside("scans of paper, no odometry", 10.0, _SCANS),
        _beside("wide, no odometry", 1.6, _ROUND, _WIDE),
        _beside("wide, odometry", 1.6, _ROUND, _WIDE, _ODOMETRY),
        _beside("eight longleaf, no odometry", 4.5, _EIGHT, longleaf),
        _beside("eight longleaf, odometry", 4.5, _EIGHT, longleaf, _ODOMETRY),
        _beside("eight waka, no odometry", 12.0, _EIGHT, waka),
        _beside("eight waka, odometry", 12.0, _EIGHT, waka, _ODOMETRY),
        _beside("rows, no odometry", 2.0, _ROUND, {"rows": True}),
        _beside("rows, odometry", 2.0, _ROUND, {"rows": True}, _ODOMETRY),
        _disturbed("paper, clutter and misses", 1.6, _ROUND, _clutter(16.0)),
        _disturbed("paper, blindness", 1.2, _ROUND, _BLIND),
        _disturbed("paper, moving things", 1.2, _ROUND, _MOVING),
        _disturbed("paper, all at once", 2.6, _ROUND, _clutter(16.0), all_at_once),
        _disturbed("wide, all at once", 3.5, _ROUND, _WIDE, _clutter(10.0), all_at_once),
        _disturbed("eight waka, all at once", 15.0, _EIGHT, waka, _clutter(27.0), all_at_once),
        _disturbed("rows, all at once", 4.5, _ROUND, {"rows": True}, _clutter(19.0), all_at_once),
    )


def sections(data: Path) -> tuple[Section, ...]:
    """All figures of the graph; `data` is the folder of the real recordings."""
    return (
        *courses(data),
        *bench_real.sections(data),
        bench_replay.SECTION,
        bench_faults.SECTION,
        *bench_long.SECTIONS,
    )
