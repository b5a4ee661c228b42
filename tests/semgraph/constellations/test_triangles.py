"""Triangles: each once, from the longest side and counter-clockwise, found again by their sides."""

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.constellations.triangles import TriangleIndex, triangles_of
from semgraph.geometry import Pose2

REACH_M = 15.0
MANY = 100_000


def scattered(seed: int, n: int = 60) -> FloatArray:
    return np.random.default_rng(seed).uniform(0.0, 60.0, (n, 2))


def trees(positions: FloatArray) -> IntArray:
    return np.zeros(len(positions), dtype=np.int64)


def same(seen: IntArray, mapped: IntArray) -> set[tuple[int, ...]]:
    """The triangles seen that were matched with themselves."""
    return {tuple(a) for a, b in zip(seen.tolist(), mapped.tolist(), strict=True) if a == b}


def test_each_triangle_is_there_once_and_within_reach() -> None:
    positions = scattered(0)
    found = triangles_of(positions, trees(positions), REACH_M)
    assert len({tuple(sorted(corners)) for corners in found.corners.tolist()}) == len(found)
    assert (np.sort(found.sides_m, axis=1)[:, :2] <= REACH_M).all()


def test_corners_run_counter_clockwise_from_the_longest_side() -> None:
    positions = scattered(1)
    found = triangles_of(positions, trees(positions), REACH_M)
    a, b, c = positions[found.corners].transpose(1, 0, 2)
    cross = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (cross >= 0.0).all()
    assert (found.sides_m[:, 0] == found.sides_m.max(axis=1)).all()
    np.testing.assert_allclose(found.sides_m[:, 0], np.linalg.norm(b - a, axis=1))
    np.testing.assert_allclose(found.sides_m[:, 1], np.linalg.norm(c - b, axis=1))


def test_moved_triangles_are_found_again_with_their_corners_in_order() -> None:
    positions = scattered(2)
    index = TriangleIndex(positions, trees(positions), REACH_M)
    moved = Pose2(300.0, -20.0, 2.0).transform(positions)
    seen = triangles_of(moved, trees(moved), REACH_M)
    assert len(same(*index.matches(seen, np.full(len(seen), 1e-6), MANY))) == len(seen)


def test_where_two_sides_are_as_long_noise_may_not_hide_a_triangle() -> None:
    corners = np.array([[0.0, 0.0], [6.0, 0.0], [3.0, 5.2]])
    index = TriangleIndex(corners, trees(corners), REACH_M)
    for seed in range(20):
        noisy = corners + np.random.default_rng(seed).normal(0.0, 0.05, (3, 2))
        seen = triangles_of(noisy, trees(noisy), REACH_M)
        rows, columns = index.matches(seen, np.array([0.3]), MANY)
        assert (rows == columns).all(axis=1).any()


def test_a_mirror_image_and_other_kinds_are_other_triangles() -> None:
    corners = np.array([[0.0, 0.0], [9.0, 0.0], [2.0, 4.0]])
    index = TriangleIndex(corners, trees(corners), REACH_M)
    tolerance_m = np.array([0.1])
    mirrored = triangles_of(corners * (1.0, -1.0), trees(corners), REACH_M)
    others = triangles_of(corners, np.array([0, 0, 1]), REACH_M)
    assert len(index.matches(mirrored, tolerance_m, MANY)[0]) == 0
    assert len(index.matches(others, tolerance_m, MANY)[0]) == 0


def test_the_rarest_come_first_and_whole() -> None:
    common = np.array([[0.0, 0.0], [9.0, 0.0], [2.0, 4.0]])
    rare = np.array([[0.0, 0.0], [11.0, 0.0], [4.0, 7.0]])
    places = [common + np.array([100.0 * k, 0.0]) for k in range(5)]
    positions = np.vstack([*places, rare + np.array([0.0, 500.0])])
    index = TriangleIndex(positions, trees(positions), REACH_M)
    seen = triangles_of(positions[12:], trees(positions[12:]), REACH_M)
    few, _ = index.matches(seen, np.full(len(seen), 0.1), 1)
    every, _ = index.matches(seen, np.full(len(seen), 0.1), MANY)
    assert (np.sort(few, axis=1) == [3, 4, 5]).all()
    assert len(few) == 1
    assert len(every) == 6


def test_the_widest_of_each_landmark_are_chosen_first() -> None:
    positions = scattered(3)
    found = triangles_of(positions, trees(positions), REACH_M)
    firsts = set(found.corners.min(axis=1).tolist())
    chosen = found.select(found.spread(len(firsts)))
    assert set(chosen.corners.min(axis=1).tolist()) == firsts
    assert len(found.spread(MANY)) == len(found)
