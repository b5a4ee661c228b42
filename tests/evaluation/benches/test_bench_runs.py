"""Figures of whole runs, from runs whose outcome is known beforehand."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from evaluation.benches import bench_runs
from evaluation.benches.bench_table import Row
from semgraph.landmarks import Gone
from semgraph.results import RunResult
from sensors.measurements import Recording
from sensors.truth import Source, TrueLandmarks, Truth
from tests.evaluation.course import START, make_run

Edit = Callable[[RunResult, Truth, dict[str, object]], tuple[RunResult, Truth]]


def plant(monkeypatch: pytest.MonkeyPatch, edit: Edit) -> None:
    """Every run is the made one, edited; in one process."""

    def run(course: str, **options: object) -> tuple[Source, RunResult]:
        seed = options["seed"]
        assert isinstance(seed, int)
        assert course.startswith("course:")
        result, truth = edit(*make_run(seed), options)
        return Source(Recording(course, [], 0), truth), result

    def each(trial: Callable[[int], object], seeds: Sequence[int]) -> list[object]:
        return [trial(seed) for seed in seeds]

    monkeypatch.setattr(bench_runs, "run_course", run)
    monkeypatch.setattr(bench_runs, "each_seed", each)


def values(figures: Callable[[Sequence[int]], list[Row]]) -> dict[str, float]:
    return {row.name: row.value for row in figures([1, 2, 3])}


def half_the_map(
    result: RunResult, truth: Truth, options: dict[str, object]
) -> tuple[RunResult, Truth]:
    return replace(result, landmarks=result.landmarks[::2]), truth


def test_of_half_a_map_recall_is_half_and_precision_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    plant(monkeypatch, half_the_map)
    measured = values(bench_runs.paper_course)
    assert measured["map precision, all runs"] == 1.0
    assert measured["map recall, all runs"] == pytest.approx(0.5)
    assert 0.0 < measured["smoothed RMSE, median of runs"] < measured["fast drift, the worst run"]


@pytest.mark.parametrize(("offset_m", "expected"), [(0.1, 3), (3.0, 0)])
def test_a_landmark_counts_as_a_person_where_one_walked(
    monkeypatch: pytest.MonkeyPatch, offset_m: float, expected: int
) -> None:
    def edit(
        result: RunResult, truth: Truth, options: dict[str, object]
    ) -> tuple[RunResult, Truth]:
        assert truth.path is not None
        if not options["person"]:
            return result, truth
        middle = np.array([0.0, 8.0])
        extra = replace(result.landmarks[0], id=99, map_t_landmark=middle)
        world = START.transform(middle[None])
        walked = replace(truth, walked=world + offset_m)
        return replace(result, landmarks=(*result.landmarks, extra)), walked

    plant(monkeypatch, edit)
    assert values(bench_runs.person_in_the_wood)["person: confirmed landmarks"] == expected


def test_looks_at_felled_trees_and_standing_ones_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first is felled and found gone; the second was felled and is not; the third stands."""

    def edit(
        result: RunResult, truth: Truth, options: dict[str, object]
    ) -> tuple[RunResult, Truth]:
        true = truth.landmarks
        assert true is not None
        assert options["felled"]
        felled, standing = (
            TrueLandmarks(true.world_t_landmarks[rows], true.kinds[rows], true.diameters_m[rows])
            for rows in (slice(0, 2), slice(2, None))
        )
        gone = tuple(Gone(result.landmarks[k], 4) for k in (0, 2))
        return replace(result, gone=gone), replace(truth, landmarks=standing, felled=felled)

    plant(monkeypatch, edit)
    measured = values(bench_runs.felled_trees)
    assert measured["felled trees gone within 5 visible misses"] == 0.5
    assert measured["standing trees taken for gone"] == 3.0
