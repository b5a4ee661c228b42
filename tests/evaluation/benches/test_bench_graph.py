"""Figures of the graph beside the oracle's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.benches.bench import measure
from evaluation.benches.bench_graph import (
    Outcome,
    as_good_as_the_oracle,
    disturbed,
    num_mixed,
    outcome,
    real_landmarks,
    sections,
)
from evaluation.benches.bench_runs import known, run_course
from evaluation.oracle import oracle
from semgraph.progress import Silence
from semgraph.results import RunResult
from semgraph.settings import Settings
from sensors.truth import Source

SHORT: dict[str, object] = {
    "seed": 4,
    "track_radius_m": 10.0,
    "num_trees": 40,
    "lap_s": 20.0,
    "overlap_s": 3.0,
}


@pytest.fixture(scope="module")
def short() -> tuple[Source, RunResult]:
    return run_course("course:perceptions", **SHORT)


def test_a_short_course_is_near_the_oracle(short: tuple[Source, RunResult]) -> None:
    source, result = short
    found = outcome(source, result, oracle(source, Settings()))
    assert 0.7 < found.path_ratio < 1.3
    assert 0.7 < found.map_ratio < 1.3
    assert 0.1 < found.pose_nees < 15.0
    assert (found.num_mixed, found.num_duplicates) == (0, 0)
    assert found.num_landmarks == len(result.landmarks) == 40
    assert found.num_closures > 0


def test_associations_are_right_and_a_wrong_merge_is_counted(
    short: tuple[Source, RunResult],
) -> None:
    source, result = short
    assert num_mixed(known(source.truth.associations), result) == 0
    assert len(result.associations) == result.num_scans
    one, other = (landmark.id for landmark in result.landmarks[:2])
    mixed = {
        stamp_ns: np.where(landmarks == other, one, landmarks)
        for stamp_ns, landmarks in result.associations.items()
    }
    assert num_mixed(known(source.truth.associations), replace(result, associations=mixed)) == 1


def test_a_landmark_of_nothing_is_not_held_against_the_tree_beside_it(
    short: tuple[Source, RunResult],
) -> None:
    source, result = short
    truly = known(source.truth.associations)
    assert real_landmarks(truly, result) == list(result.landmarks)
    first = result.landmarks[0].id
    of_first = {
        stamp_ns: np.where(result.associations[stamp_ns] == first, -1, rows)
        for stamp_ns, rows in truly.items()
    }
    assert real_landmarks(of_first, result) == list(result.landmarks[1:])


def test_rows_tell_good_outcomes_from_bad_ones() -> None:
    good = Outcome(1.0, 1.0, 3.0, 2.0, 100, 0, 0, 5)
    assert all(row.reached for row in as_good_as_the_oracle([good] * 50))
    assert all(row.reached for row in disturbed([good] * 50))
    for worse in (
        replace(good, path_ratio=1.4),
        replace(good, map_ratio=1.4),
        replace(good, pose_nees=4.0),
        replace(good, pose_nees=2.0),
        replace(good, landmark_nees=3.0),
        replace(good, num_duplicates=1),
        replace(good, num_mixed=1),
        replace(good, num_closures=0),
    ):
        assert not all(row.reached for row in as_good_as_the_oracle([worse] * 50))
    assert not all(row.reached for row in disturbed([replace(good, path_ratio=1.3)]))


def test_sections_have_names_of_their_own(tmp_path: Path) -> None:
    every = sections(tmp_path)
    assert len({section.name for section in every}) == len(every)
    assert all(section.work > 0.0 for section in every)


def test_without_a_stem_map_its_courses_are_left_out(tmp_path: Path) -> None:
    eights = [each for each in sections(tmp_path) if "eight" in each.name]
    assert len(eights) == 5
    for measured in measure(eights[:1], [1], Silence()):
        assert measured.rows == ()
        assert "longleaf.csv" in measured.left_out
