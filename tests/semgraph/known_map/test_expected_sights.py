"""What should have been seen and was not: it tells two places that look alike apart."""

import numpy as np
import pytest

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, relative_poses
from semgraph.known_map.expected_sights import ExpectedSights, Lately
from semgraph.known_map.fixed_map import FixedMap
from semgraph.landmarks import Kind, Perceptions, polar_covariances

PAIR = np.array([[6.0, 2.0], [4.0, -3.0]])
AHEAD = np.array([[5.0, 0.0], [8.0, 5.0], [7.0, -4.0], [9.0, 1.0]])
FAR = np.array([100.0, 0.0])


def mapped(places: FloatArray) -> FixedMap:
    m = len(places)
    unknown = np.full(m, np.nan)
    covariances = np.tile(0.01 * np.eye(2), (m, 1, 1))
    kinds = np.full(m, int(Kind.TREE))
    return FixedMap(places, covariances, kinds, unknown, unknown, np.full(m, "", dtype=np.str_))


def seen(base_t: FloatArray) -> Perceptions:
    n = len(base_t)
    ranges_m, bearings = np.hypot(*base_t.T), np.arctan2(base_t[:, 1], base_t[:, 0])
    covariances = polar_covariances(np.full(n, 0.03), np.full(n, 0.005))
    return Perceptions.from_arrays(0, Kind.TREE, ranges_m, bearings, covariances)


def evidence(
    places: FloatArray, trees: FloatArray, lately: Lately, half_field: float
) -> FloatArray:
    sights = ExpectedSights(mapped(trees), np.random.default_rng(0))
    return sights.evidence(places, lately, 12.0, half_field)


def test_the_place_where_nothing_else_stands_is_the_likelier() -> None:
    trees = np.vstack([PAIR, PAIR + FAR, AHEAD + FAR])
    places = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    alone, crowded = evidence(places, trees, Lately.now(seen(PAIR)), np.pi)
    # 2 of 2 are seen, and 2 of 6: half believed.
    assert alone - crowded == pytest.approx(0.5 * np.log(1 / 3) - 0.5 * np.log(2 * 24 / 5040))


def test_what_is_out_of_view_is_not_missed() -> None:
    trees = np.vstack([PAIR, PAIR + FAR, -AHEAD + FAR])
    places = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    alone, crowded = evidence(places, trees, Lately.now(seen(PAIR)), 1.0)
    assert alone == pytest.approx(crowded)


def test_what_was_in_view_on_the_way_is_missed() -> None:
    trees = np.vstack([PAIR, PAIR + FAR, AHEAD + FAR - (25.0, 0.0)])
    places = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    way = np.column_stack([np.arange(-20.0, 1.0), np.zeros((21, 2))])
    base_T_then = relative_poses(np.zeros((21, 3)), way)
    alone, crowded = evidence(places, trees, Lately(seen(PAIR), base_T_then), 1.0)
    assert alone > crowded + 1.0


def test_places_and_things_move_together() -> None:
    rng = np.random.default_rng(3)
    trees, lately = rng.uniform(-20.0, 20.0, (60, 2)), Lately.now(seen(PAIR))
    places = np.column_stack([rng.uniform(-15.0, 15.0, (8, 2)), rng.uniform(-3.0, 3.0, 8)])
    first = evidence(places, trees, lately, 1.5)
    a_T_map = Pose2(7.0, -4.0, 0.0)
    moved = places + a_T_map.as_array()
    assert evidence(moved, a_T_map.transform(trees), lately, 1.5) == pytest.approx(first)
    assert len(evidence(places[:0], trees, lately, 1.5)) == 0
