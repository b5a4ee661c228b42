"""Figures of whole runs on simulated courses: the paper's, a person in the wood, felled trees."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from evaluation.alignment import Alignment
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import each_seed
from evaluation.landmarks import compare_map
from evaluation.trajectory import compare_path, rmse
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.landmarks import Landmark
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.results import RunResult
from semgraph.settings import Settings
from sensors.catalog import open_source
from sensors.truth import Source

Value = TypeVar("Value")
_SAME_M: Final = 0.6
_AT_THE_END_S: Final = 2.0
_VISIBLE_MISSES: Final = 5


def paper_course(seeds: Sequence[int]) -> list[Row]:
    """The paper's simulated test from laser scans: Fig. 4 and 5 in figures."""
    laps = each_seed(_paper_lap, seeds)
    found, confirmed, there = (sum(getattr(lap, name) for lap in laps) for name in _COUNTS)
    return [
        Row("fast drift, the worst run", max(lap.drift_m for lap in laps), "m", Better.LOWER, 0.5),
        Row(
            "runs whose drift falls when the start is seen again",
            float(np.mean([lap.falls for lap in laps])),
            "",
            Better.HIGHER,
            1.0,
        ),
        Row(
            "smoothed RMSE, median of runs",
            float(np.median([lap.smoothed_rmse_m for lap in laps])),
            "m",
            Better.LOWER,
            0.05,
        ),
        Row("map precision, all runs", found / max(confirmed, 1), "", Better.HIGHER, 0.97),
        Row("map recall, all runs", found / max(there, 1), "", Better.HIGHER, 0.97),
    ]


def person_in_the_wood(seeds: Sequence[int]) -> list[Row]:
    """Landmarks that are there only because somebody walked by, of all runs together."""
    extra = sum(each_seed(_person, seeds))
    return [Row("person: confirmed landmarks", extra, "", Better.LOWER, 0.0)]


def felled_trees(seeds: Sequence[int]) -> list[Row]:
    """Trees felled between two laps; looks count once every 0.3 m driven."""
    laps = each_seed(_felled, seeds)
    looks = np.array([each for lap in laps for each in lap.looks])
    name = f"felled trees gone within {_VISIBLE_MISSES} visible misses"
    share = float(np.mean(looks <= _VISIBLE_MISSES)) if len(looks) else float("nan")
    lost = sum(lap.num_lost for lap in laps)
    return [
        Row(name, share, "", Better.HIGHER, 1.0),
        Row("standing trees taken for gone", lost, "", Better.LOWER, 0.0),
    ]


FIGURES: Final = (paper_course, person_in_the_wood, felled_trees)


@dataclass(frozen=True, slots=True)
class _Lap:
    drift_m: float
    falls: bool
    smoothed_rmse_m: float
    found: int
    confirmed: int
    there: int


_COUNTS: Final = ("found", "confirmed", "there")


@dataclass(frozen=True, slots=True)
class _Felled:
    """`looks` at the place of each felled tree until it was gone (inf: never)."""

    looks: tuple[float, ...]
    num_lost: int


def known(value: Value | None) -> Value:
    """What a simulated course always has."""
    if value is None:
        raise InputError("course: expected truth and a path to compare with it")
    return value


def run_course(course: str, **options: object) -> tuple[Source, RunResult]:
    """A course with its truth, and a run over it with the default settings."""
    source = open_source(course, options)
    return source, run_source(source)


def run_source(source: Source) -> RunResult:
    """A run with the default settings."""
    settings = Settings()
    return run(source.recording, settings, Perceiver(source.recording, settings), Silence(), {})


def _paper_lap(seed: int) -> _Lap:
    source, result = run_course("course:paper", seed=seed)
    path = known(source.truth.path)
    fast = known(compare_path(result.fast, path, Alignment.ORIGIN))
    smoothed = known(compare_path(result.smoothed, path))
    drifts_m = fast.distances
    seconds = (path.stamps_ns[fast.rows] - path.stamps_ns[fast.rows[-1]]) * 1e-9
    errors = known(compare_map(result.landmarks, source.truth, smoothed.world_T_map))
    return _Lap(
        float(drifts_m.max()),
        bool(drifts_m[seconds > -_AT_THE_END_S].mean() < drifts_m.max()),
        rmse(smoothed.distances),
        len(errors.map_rows),
        len(result.landmarks),
        len(errors.map_rows) + len(errors.missed),
    )


def _person(seed: int) -> int:
    """How many landmarks where a person walked the same run without the person does not have."""
    (source, alone), (walked, result) = (
        run_course("course:forest", seed=seed, person=person) for person in (False, True)
    )
    places = _places(walked, result, result.landmarks)
    without = np.vstack([_places(source, alone, alone.landmarks), _standing(source)])
    is_extra = _distances(places, without) > _SAME_M
    is_where_walked = _distances(places, known(walked.truth.walked)) <= _SAME_M
    return int((is_extra & is_where_walked).sum())


def _felled(seed: int) -> _Felled:
    source, result = run_course("course:forest", seed=seed, felled=True)
    felled = known(source.truth.felled)
    gone = _places(source, result, [each.landmark for each in result.gone])
    misses = np.array([float(each.num_misses) for each in result.gone])
    looks = []
    for place in felled.world_t_landmarks:
        near = np.linalg.norm(gone - place, axis=1) < _SAME_M
        looks.append(float(misses[near].min()) if near.any() else float("inf"))
    return _Felled(tuple(looks), int((_distances(gone, _standing(source)) < _SAME_M).sum()))


def _standing(source: Source) -> FloatArray:
    return known(source.truth.landmarks).world_t_landmarks


def _places(source: Source, result: RunResult, landmarks: Sequence[Landmark]) -> FloatArray:
    """(n, 2) of landmarks, in the world."""
    smoothed = known(compare_path(result.smoothed, known(source.truth.path)))
    places = np.array([each.map_t_landmark for each in landmarks]).reshape(-1, 2)
    return smoothed.world_T_map.transform(places)


def _distances(places: FloatArray, others: FloatArray) -> FloatArray:
    """(n,) of each place to the nearest of the others."""
    distances: FloatArray = np.linalg.norm(places[:, None] - others[None], axis=2)
    nearest: FloatArray = distances.min(axis=1, initial=np.inf)
    return nearest
