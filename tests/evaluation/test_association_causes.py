"""Wrong associations are counted where they are made."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.association_causes import associations, num_wrong
from evaluation.trajectory import compare_path, rmse
from semgraph.errors import InputError
from semgraph.settings import Settings
from sensors.catalog import open_source
from sensors.truth import Source, Truth

SHORT = {"num_trees": 40, "lap_s": 20.0, "overlap_s": 3.0, "scan_rate_hz": 5.0, "clutter": 0.5}


@pytest.fixture(scope="module")
def course() -> Source:
    return open_source("course:perceptions", {"seed": 1, "track_radius_m": 10.0, **SHORT})


def error_m(source: Source, settings: Settings, longest_gap_s: float | None) -> float:
    path = source.truth.path
    assert path is not None
    found = compare_path(associations(source, settings, longest_gap_s).trajectory, path)
    assert found is not None
    return rmse(found.distances)


def test_trees_apart_are_followed_one_by_one(course: Source) -> None:
    found = associations(course, Settings())
    assert found.num_perceptions > 500
    assert found.wrong_in_tracks < 0.01 * found.num_perceptions
    assert found.wrong_in_landmarks < 0.01 * found.num_perceptions
    assert found.num_landmarks <= found.num_tracks


def test_true_tracks_are_pure_end_when_out_of_sight_and_give_as_good_a_path(
    course: Source,
) -> None:
    whole, cut = (associations(course, Settings(), gap_s) for gap_s in (np.inf, 2.0))
    assert whole.wrong_in_tracks == cut.wrong_in_tracks == 0
    truth = course.truth.associations
    assert truth is not None
    seen = np.unique(np.concatenate(list(truth.values())))
    assert whole.num_tracks == (seen >= 0).sum()
    assert cut.num_tracks > whole.num_tracks
    assert error_m(course, Settings(), np.inf) < 0.03


def test_what_the_tracker_mixes_is_told_as_its_own(course: Source) -> None:
    """Trees of which every second is said to be its neighbour: half of the sightings are wrong."""
    truth = course.truth.associations
    assert truth is not None
    odd = {
        stamp: np.where(rows >= 0, rows * 2 + k % 2, -1)
        for k, (stamp, rows) in enumerate(truth.items())
    }
    told = Source(course.recording, replace(course.truth, associations=odd))
    found = associations(told, Settings())
    assert 0.4 * found.num_perceptions < found.wrong_in_tracks < 0.5 * found.num_perceptions


@given(st.lists(st.tuples(st.integers(-1, 4), st.integers(-1, 4)), max_size=40))
def test_wrong_ones_are_those_beside_the_most_of_each_group(pairs: list[tuple[int, int]]) -> None:
    taken_for, rows = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    expected = 0
    for group in range(5):
        members = [row for each, row in pairs if each == group and row >= 0]
        expected += len(members) - max((members.count(row) for row in members), default=0)
    assert num_wrong(taken_for, rows) == expected
    renamed = np.where(taken_for >= 0, 9 - taken_for, -1)
    assert num_wrong(renamed, rows) == expected


def test_without_true_associations_there_is_nothing_to_count(course: Source) -> None:
    with pytest.raises(InputError, match="true landmark of each perception"):
        associations(Source(course.recording, Truth()), Settings())
