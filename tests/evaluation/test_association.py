import numpy as np
import pytest

from evaluation.association import Association, compare_associations
from semgraph.arrays import IntArray


def by_stamp(*scans: list[int]) -> dict[int, IntArray]:
    return {stamp: np.array(ids, dtype=np.int64) for stamp, ids in enumerate(scans)}


def test_all_right() -> None:
    true = by_stamp([0, 1], [1, 0], [0, -1])
    said = by_stamp([7, 3], [3, 7], [7, -1])
    assert compare_associations(said, true) == Association(said=4, true=4, right=4)


def test_by_hand() -> None:
    # Tree 0 is landmark 5 in scans 0 and 1, landmark 6 in scan 2; 6 is also a false perception's.
    true = by_stamp([0, 1], [0, 1], [0, -1])
    said = by_stamp([5, 8], [5, -1], [6, 6])
    pairs = compare_associations(said, true)
    # Said: 5-5, 6-6. True: three pairs of tree 0, one of tree 1. Both: 5-5.
    assert pairs == Association(said=2, true=4, right=1)
    assert pairs.precision == pytest.approx(0.5)
    assert pairs.recall == pytest.approx(0.25)


def test_names_do_not_matter() -> None:
    rng = np.random.default_rng(0)
    true = by_stamp(*rng.integers(-1, 6, (20, 8)).tolist())
    said = by_stamp(*rng.integers(-1, 9, (20, 8)).tolist())
    renamed = {stamp: np.where(ids >= 0, 100 - 7 * ids, -1) for stamp, ids in said.items()}
    assert compare_associations(said, true) == compare_associations(renamed, true)


def test_a_loop_left_open_costs_recall_alone() -> None:
    true = by_stamp(*[[0, 1, 2]] * 20)
    said = by_stamp(*[[0, 1, 2]] * 10, *[[3, 4, 5]] * 10)
    pairs = compare_associations(said, true)
    assert pairs is not None
    assert pairs.precision == 1.0
    assert pairs.recall == pytest.approx(2 * 45 / 190)


def test_what_cannot_be_compared() -> None:
    assert compare_associations(by_stamp([0, 1]), by_stamp([0])) is None
    assert compare_associations({}, by_stamp([0])) is None
    nothing = compare_associations(by_stamp([-1, -1]), by_stamp([0, 0]))
    assert nothing is not None
    assert np.isnan(nothing.precision)
    assert nothing.recall == 0.0
