import itertools
from dataclasses import replace

import numpy as np
import pytest

from evaluation.landmarks import MapErrors, compare_map, match, suspected_duplicates
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Landmark, semantic_object
from sensors.truth import TrueLandmarks, Truth
from tests.evaluation.course import START, make_run


def tree(x: float, y: float, sigma_m: float = 0.05, **of: float | str) -> Landmark:
    diameter_m, identity = float(of.get("diameter_m", np.nan)), str(of.get("identity", ""))
    semantics = semantic_object(Kind.TREE, diameter_m, 0.02, identity)
    return Landmark(0, semantics, np.array([x, y]), np.eye(2) * sigma_m**2, 3, 0.9)


def rock(x: float, y: float) -> Landmark:
    return replace(tree(x, y), semantics=semantic_object(Kind.ROCK))


def true_trees(*positions: tuple[float, float]) -> TrueLandmarks:
    n = len(positions)
    points = np.array(positions, dtype=np.float64).reshape(-1, 2)
    return TrueLandmarks(points, np.zeros(n, dtype=np.int64), np.full(n, np.nan))


def judged(landmarks: list[Landmark], truth: Truth, start: Pose2 | None = None) -> MapErrors:
    errors = compare_map(landmarks, truth, start)
    assert errors is not None
    return errors


ONCE = [[1, 2]]
CORNERS = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]


def test_a_perfect_map_has_no_errors() -> None:
    errors = judged([tree(*corner) for corner in CORNERS], Truth(None, true_trees(*CORNERS)))
    assert len(errors.map_rows) == 4
    assert np.abs(errors.errors).max() < 1e-12
    for wrong in (errors.missed, errors.false, errors.duplicates):
        assert len(wrong) == 0


def test_hand_counted_map() -> None:
    landmarks = [
        tree(0.1, 0.0),
        tree(10.1, 0.0),
        tree(10.1, 10.0),
        tree(0.6, 0.0),
        tree(5.0, 5.0),
        rock(0.0, 10.0),
    ]
    errors = judged(landmarks, Truth(None, true_trees(*CORNERS)))
    assert errors.gate_m == 1.0
    np.testing.assert_array_equal(errors.map_rows, [0, 1, 2])
    np.testing.assert_array_equal(errors.true_rows, [0, 1, 2])
    np.testing.assert_array_equal(errors.missed, [3])
    np.testing.assert_array_equal(errors.duplicates, [3])
    np.testing.assert_array_equal(errors.false, [4, 5])
    assert np.abs(errors.errors).max() < 1e-9
    np.testing.assert_allclose(errors.path_errors, [[0.1, 0.0]] * 3, atol=1e-12)


def test_only_what_was_really_sighted_can_be_missed() -> None:
    sightings = {k: np.array([0, 1, -1, 2] if k < 3 else [3]) for k in range(5)}
    truth = Truth(None, true_trees(*CORNERS), sightings)
    errors = judged([tree(0.0, 0.0), tree(10.0, 0.0)], truth)
    np.testing.assert_array_equal(errors.missed, [2])


def test_the_gate_shrinks_with_the_spacing_of_the_truth() -> None:
    close = [(0.8 * k, 0.0) for k in range(10)]
    errors = judged([tree(0.0, 0.45)], Truth(None, true_trees(*close)))
    assert errors.gate_m == pytest.approx(0.4)
    np.testing.assert_array_equal(errors.false, [0])


def test_an_empty_map_or_an_empty_truth_is_counted() -> None:
    nothing_found = judged([], Truth(None, true_trees(*CORNERS)))
    assert len(nothing_found.missed) == 4
    nothing_there = judged([tree(0.0, 0.0)], Truth(None, true_trees()))
    assert len(nothing_there.false) == 1
    assert compare_map([tree(0.0, 0.0)], Truth(), None) is None


def test_the_map_finds_its_own_alignment_from_the_paths() -> None:
    result, truth = make_run(1, sigma_m=1e-6)
    nearly = START @ Pose2(0.1, -0.1, 0.02)
    errors = judged(list(result.landmarks), truth, nearly)
    assert len(errors.map_rows) == 30
    assert np.abs(errors.errors).max() < 1e-4
    assert np.abs(errors.path_errors).max() > 0.1
    np.testing.assert_allclose(errors.diameter_errors_m, 0.02, atol=1e-12)


@pytest.mark.parametrize("seed", range(30))
def test_pairs_are_as_many_as_possible_then_the_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ours, theirs = rng.uniform(0.0, 2.0, (5, 2)), rng.uniform(0.0, 2.0, (5, 2))
    kinds = rng.integers(0, 2, 5)
    true = TrueLandmarks(theirs, rng.integers(0, 2, 5), np.full(5, np.nan))
    best = (0, 0.0)
    for order in itertools.permutations(range(5)):
        distances = np.linalg.norm(ours - theirs[list(order)], axis=1)
        fits = (distances <= 0.8) & (kinds == true.kinds[list(order)])
        best = max(best, (int(fits.sum()), -float(np.sum(distances[fits] ** 2))))
    pairs = match(ours, kinds, true, 0.8)
    offsets = ours[pairs[:, 0]] - theirs[pairs[:, 1]]
    assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs) == best[0]
    assert -np.sum(offsets**2) == pytest.approx(best[1])


def test_thousands_of_landmarks_are_matched_at_once() -> None:
    rng = np.random.default_rng(0)
    theirs = rng.uniform(0.0, 300.0, (8000, 2))
    true = TrueLandmarks(theirs, np.zeros(8000, dtype=np.int64), np.full(8000, np.nan))
    pairs = match(theirs + rng.normal(0.0, 0.05, (8000, 2)), true.kinds, true, 0.5)
    assert len(pairs) == 8000
    assert np.mean(pairs[:, 0] == pairs[:, 1]) > 0.99


@pytest.mark.parametrize(
    ("first", "second", "suspected"),
    [
        (tree(0.0, 0.0), tree(0.2, 0.0), ONCE),
        (tree(0.0, 0.0), tree(0.5, 0.0), []),
        (tree(0.0, 0.0, 0.3), tree(0.5, 0.0), ONCE),
        (tree(0.0, 0.0, 3.0), tree(1.5, 0.0, 3.0), []),
        (tree(0.0, 0.0), rock(0.2, 0.0), []),
        (tree(0.0, 0.0, identity="7"), tree(0.1, 0.0, identity="8"), []),
        (tree(0.0, 0.0, identity="7"), tree(0.1, 0.0), ONCE),
        (tree(0.0, 0.0, 0.3, diameter_m=0.2), tree(0.5, 0.0, diameter_m=0.6), []),
    ],
)
def test_what_may_be_one_landmark_twice(
    first: Landmark, second: Landmark, suspected: list[list[int]]
) -> None:
    pairs = suspected_duplicates([rock(9.0, 9.0), first, second])
    assert pairs.tolist() == suspected
    assert len(suspected_duplicates([first])) == 0
