"""Figures of the refinement: rows of known outcomes, and a short course."""

from dataclasses import replace

import pytest

from evaluation.benches import bench_refine
from evaluation.benches.bench_refine import Solved, Updated, solved_rows, updated_rows
from evaluation.benches.bench_runs import known, run_course
from semgraph.graph.smoother import SmootherSettings
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.refinement import Refined, refine, refined
from semgraph.progress import Silence
from semgraph.results import RunResult
from sensors.truth import Source

GOOD = Solved(0.0, 1.0, 0.9, 0.9, is_settled=True)
TOLD = Updated(1.0, 20, 20, 20, 20, 0, 0)


def test_rows_tell_good_outcomes_from_bad_ones() -> None:
    assert all(row.reached for row in solved_rows([GOOD] * 3))
    for worse in (
        replace(GOOD, excess=2e-4),
        replace(GOOD, time_ratio=1.4),
        replace(GOOD, path_ratio=1.1),
        replace(GOOD, map_ratio=float("nan")),
        replace(GOOD, is_settled=False),
    ):
        assert not all(row.reached for row in solved_rows([worse] * 3))
    assert all(row.reached for row in updated_rows([TOLD] * 3))
    for mistold in (
        replace(TOLD, map_ratio=1.2),
        replace(TOLD, named_false=18),
        replace(TOLD, named_missing=18),
        replace(TOLD, num_lost=1),
        replace(TOLD, num_extra=1),
    ):
        assert not all(row.reached for row in updated_rows([mistold] * 3))


@pytest.fixture(scope="module")
def short() -> tuple[Source, RunResult, Refined]:
    source, result = run_course("course:paper", seed=3, track_radius_m=8.0, lap_s=16.0)
    log, settings = known(result.log), SmootherSettings()
    batch = Batch.of(log)
    begin = Belief(log.trajectory.map_T_bases, log.landmarks, {})
    belief, rounds = refine(batch, begin, settings, Silence().note)
    return source, result, refined(batch, belief, settings, rounds)


def test_a_short_course_is_solved_and_updated(short: tuple[Source, RunResult, Refined]) -> None:
    source, result, best = short
    found = bench_refine.solved(source, result, best)
    assert abs(found.excess) < 1e-4
    assert 0.1 < found.time_ratio < 10.0
    assert 0.3 < found.path_ratio < 1.5
    told = bench_refine.updated(source, result, best, 3)
    assert 0.7 < told.map_ratio < 1.5
    assert told.num_missing >= told.named_missing > 0
    assert told.num_false >= told.named_false
    assert told.num_lost <= 1
