from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2, rotation
from semgraph.landmarks import Kind, Perceptions
from semgraph.matching import (
    Assignment,
    LocalMap,
    Matches,
    SweepRule,
    compatible,
    local_map,
    match,
)
from semgraph.navigation_map import NavigationMap

SEEDS = st.integers(0, 2**32 - 1)
NO_TURN = np.zeros(1)


def perceived_at(
    points: FloatArray,
    kinds: Kind | IntArray = Kind.TREE,
    diameters_m: list[float] | None = None,
    identities: list[str] | None = None,
) -> Perceptions:
    """Perceptions of points (n, 2) in base; diameters with a sigma of 1 %."""
    n = len(points)
    diameters = None if diameters_m is None else np.array(diameters_m)
    return Perceptions.from_arrays(
        0,
        kinds,
        np.hypot(points[:, 0], points[:, 1]),
        np.arctan2(points[:, 1], points[:, 0]),
        np.tile(np.diag([1e-4, 1e-5]), (n, 1, 1)),
        diameters_m=diameters,
        diameter_sigmas_m=None if diameters is None else 0.01 * diameters,
        identities=None if identities is None else np.array(identities, dtype=np.str_),
    )


def mapped_at(
    points: FloatArray,
    kinds: Kind | IntArray = Kind.TREE,
    diameters_m: list[float] | None = None,
    identities: list[str] | None = None,
) -> LocalMap:
    n = len(points)
    diameters = np.full(n, np.nan) if diameters_m is None else np.array(diameters_m)
    return LocalMap(
        np.arange(n) + 100,
        points,
        np.zeros((n, 2, 2)),
        np.full(n, kinds) if isinstance(kinds, Kind) else kinds,
        diameters,
        0.01 * diameters,
        [""] * n if identities is None else identities,
    )


def pairs_of(matches: Matches) -> set[tuple[int, int]]:
    return set(zip(matches.rows.tolist(), matches.columns.tolist(), strict=True))


def scattered(
    rng: np.random.Generator, n: int, m: int, reach_m: float = 2.0
) -> tuple[FloatArray, FloatArray]:
    """Points dense enough that several are in reach of each."""
    return rng.uniform(-reach_m, reach_m, (n, 2)), rng.uniform(-reach_m, reach_m, (m, 2))


@given(SEEDS, st.integers(0, 8), st.integers(0, 8))
def test_matches_are_one_to_one_and_within_the_radius(seed: int, n: int, m: int) -> None:
    perceived, mapped = scattered(np.random.default_rng(seed), n, m)
    matches = match(perceived_at(perceived), mapped_at(mapped), NO_TURN, 1.0)
    assert len(set(matches.rows.tolist())) == len(matches)
    assert len(set(matches.columns.tolist())) == len(matches)
    distances = np.linalg.norm(perceived[matches.rows] - mapped[matches.columns], axis=1)
    np.testing.assert_allclose(matches.deviations_m, distances, atol=1e-12)
    assert (matches.deviations_m <= 1.0).all()


@given(SEEDS, st.integers(1, 4), st.integers(1, 4))
def test_as_many_as_possible_and_among_those_the_nearest(seed: int, n: int, m: int) -> None:
    perceived, mapped = scattered(np.random.default_rng(seed), n, m, 1.2)
    matches = match(perceived_at(perceived), mapped_at(mapped), NO_TURN, 1.0)
    distances = np.linalg.norm(perceived[:, None] - mapped[None], axis=2)
    if n > m:
        distances = distances.T
    best = min(
        (-len(kept), float((np.array(kept) ** 2).sum()))
        for columns in permutations(range(max(n, m)), min(n, m))
        for kept in [[d for d in distances[range(min(n, m)), columns] if d <= 1.0]]
    )
    assert len(matches) == -best[0]
    assert (matches.deviations_m**2).sum() == pytest.approx(best[1])


@pytest.mark.parametrize("assignment", list(Assignment))
@given(SEEDS)
def test_the_order_of_perceptions_changes_nothing(assignment: Assignment, seed: int) -> None:
    rng = np.random.default_rng(seed)
    perceived, mapped = scattered(rng, 8, 8)
    perceptions, near = perceived_at(perceived), mapped_at(mapped)
    rotations = np.array([0.0, 0.1, -0.1, 0.2, -0.2])
    order, columns = rng.permutation(8), rng.permutation(8)
    expected = pairs_of(match(perceptions, near, rotations, 1.0, assignment))
    shuffled = match(perceptions.select(order), near, rotations, 1.0, assignment)
    assert {(int(order[row]), column) for row, column in pairs_of(shuffled)} == expected
    shuffled = match(perceptions, mapped_at(mapped[columns]), rotations, 1.0, assignment)
    assert {(row, int(columns[column])) for row, column in pairs_of(shuffled)} == expected


def test_the_nearest_may_be_taken_twice_where_that_is_the_rule() -> None:
    perceptions = perceived_at(np.array([[5.0, 0.1], [5.0, -0.2]]))
    near = mapped_at(np.array([[5.0, 0.0], [5.0, 0.9]]))
    nearest = match(perceptions, near, NO_TURN, 1.0, Assignment.NEAREST)
    assert pairs_of(nearest) == {(0, 0), (1, 0)}
    assert pairs_of(match(perceptions, near, NO_TURN, 1.0)) == {(0, 1), (1, 0)}


def test_kinds_do_not_mix() -> None:
    points = np.array([[5.0, 0.0], [0.0, 5.0], [-5.0, 0.0]])
    kinds = np.array([Kind.TREE, Kind.ROCK, Kind.MARKER])
    assert len(match(perceived_at(points, kinds), mapped_at(points, kinds), NO_TURN, 1.0)) == 3
    for shift in (1, 2):
        other = mapped_at(points, np.roll(kinds, shift))
        assert len(match(perceived_at(points, kinds), other, NO_TURN, 1.0)) == 0


@pytest.mark.parametrize(
    ("mean_m", "num_matches"),
    [(0.30, 1), (0.33, 1), (0.36, 0), (0.24, 0), (np.nan, 1)],
)
def test_diameters_may_differ_by_three_sigma(mean_m: float, num_matches: int) -> None:
    """sqrt(1 %^2 + 1 %^2 + 5 %^2) is 5.2 %: a ratio of exp(0.156) or 1.17 is the gate."""
    point = np.array([[5.0, 0.0]])
    for one_m, other_m in ((0.30, mean_m), (mean_m, 0.30)):
        perceptions, near = perceived_at(point), mapped_at(point, diameters_m=[other_m])
        if not np.isnan(one_m):
            perceptions = perceived_at(point, diameters_m=[one_m])
        assert compatible(perceptions, near)[0, 0] == bool(num_matches)
        assert len(match(perceptions, near, NO_TURN, 1.0)) == num_matches


def test_an_identity_outweighs_any_distance_and_any_diameter() -> None:
    perceptions = perceived_at(
        np.array([[5.0, 0.0], [0.0, 5.0]]), Kind.MARKER, [0.3, 0.3], ["A1", "B2"]
    )
    near = mapped_at(np.array([[0.0, 5.0], [50.0, 0.0]]), Kind.MARKER, [0.9, 0.9], ["A1", "B2"])
    assert pairs_of(match(perceptions, near, NO_TURN, 1.0)) == {(0, 0), (1, 1)}


@pytest.mark.parametrize("identity", ["B2", ""])
def test_another_identity_or_none_is_another_object(identity: str) -> None:
    point = np.array([[5.0, 0.0]])
    perceptions = perceived_at(point, Kind.MARKER, identities=["A1"])
    near = mapped_at(point, Kind.MARKER, identities=[identity])
    assert len(match(perceptions, near, NO_TURN, 1.0)) == 0


@pytest.mark.parametrize("turn", [-0.3, -0.1, 0.2, 0.3])
def test_the_sweep_finds_the_rotation(turn: float) -> None:
    perceived = np.random.default_rng(1).uniform(-12.0, 12.0, (15, 2))
    near = mapped_at(perceived @ rotation(turn).T)
    perceptions = perceived_at(perceived)
    steps = 0.05 * np.arange(1, 8)
    sweep = np.concatenate([NO_TURN, np.column_stack([steps, -steps]).ravel()])
    for rule in SweepRule:
        found = match(perceptions, near, sweep, 0.5, rule=rule)
        assert pairs_of(found) == {(k, k) for k in range(15)}
        np.testing.assert_allclose(found.deviations_m, 0.0, atol=1e-6)
    assert pairs_of(match(perceptions, near, NO_TURN, 0.5)) != {(k, k) for k in range(15)}


def test_the_lowest_mean_deviation_favours_few_matches() -> None:
    """Three landmarks nearly agree unturned; turned by 0.5, one that is wrong agrees exactly."""
    perceived = np.array([[6.0, 0.0], [0.0, 6.0], [-6.0, 0.0]])
    wrong = perceived[:1] @ rotation(0.5).T
    near = mapped_at(np.vstack([perceived + 0.2, wrong]))
    sweep = np.array([0.0, 0.5])
    most = match(perceived_at(perceived), near, sweep, 0.5, rule=SweepRule.MOST_MATCHES)
    fewest = match(perceived_at(perceived), near, sweep, 0.5, rule=SweepRule.LOWEST_MEAN_DEVIATION)
    assert pairs_of(most) == {(0, 0), (1, 1), (2, 2)}
    assert pairs_of(fewest) == {(0, 3)}
    assert fewest.deviations_m.mean() < most.deviations_m.mean()


@pytest.mark.parametrize("assignment", list(Assignment))
@pytest.mark.parametrize("rule", list(SweepRule))
@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 3), (3, 0)])
def test_nothing_matches_nothing(assignment: Assignment, rule: SweepRule, n: int, m: int) -> None:
    found = match(
        perceived_at(np.ones((n, 2))), mapped_at(np.ones((m, 2))), NO_TURN, 1.0, assignment, rule
    )
    assert len(found) == 0
    assert found.select(np.zeros(0, dtype=np.bool_)).rows.dtype.kind == "i"


def navigation_map_of(map_t_landmarks: FloatArray, identities: list[str]) -> NavigationMap:
    navigation_map = NavigationMap()
    navigation_map.insert(
        perceived_at(map_t_landmarks, Kind.MARKER, [0.3] * len(identities), identities),
        map_t_landmarks,
        np.tile(1e-4 * np.eye(2), (len(identities), 1, 1)),
    )
    return navigation_map


def test_the_local_map_holds_what_is_in_reach_in_the_proposed_frame() -> None:
    map_t_landmarks = np.array([[10.0, 3.0], [10.0, 12.0], [300.0, 0.0], [500.0, 0.0]])
    navigation_map = navigation_map_of(map_t_landmarks, ["", "", "", "far"])
    map_T_proposed = Pose2(10.0, 0.0, np.pi / 2)
    near = local_map(
        navigation_map, map_T_proposed, perceived_at(np.array([[3.0, 0.0]]), Kind.MARKER), 2.0
    )
    np.testing.assert_array_equal(near.ids, [0])
    np.testing.assert_allclose(near.proposed_t_landmarks, [[3.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(near.diameters_m, [0.3])
    assert near.identities == [""]


def test_the_local_map_holds_a_perceived_identity_wherever_it_is() -> None:
    map_t_landmarks = np.array([[10.0, 3.0], [500.0, 0.0]])
    navigation_map = navigation_map_of(map_t_landmarks, ["near", "far"])
    perceptions = perceived_at(
        np.array([[3.0, 0.0], [4.0, 0.0]]), Kind.MARKER, identities=["far", "never seen"]
    )
    near = local_map(navigation_map, Pose2(10.0, 0.0, 0.0), perceptions, 2.0)
    np.testing.assert_array_equal(near.ids, [0, 1])
    assert near.identities == ["near", "far"]


def test_a_local_map_seen_from_a_better_frame_is_the_one_built_there() -> None:
    map_t_landmarks = np.random.default_rng(2).uniform(-5.0, 5.0, (6, 2))
    navigation_map = navigation_map_of(map_t_landmarks, [""] * 6)
    perceptions = perceived_at(np.array([[30.0, 0.0]]), Kind.MARKER)
    map_T_proposed, proposed_T_base = Pose2(1.0, 2.0, 0.5), Pose2(0.3, -0.1, 0.2)
    moved = local_map(navigation_map, map_T_proposed, perceptions, 1.0).seen_from(proposed_T_base)
    built = local_map(navigation_map, map_T_proposed @ proposed_T_base, perceptions, 1.0)
    np.testing.assert_array_equal(moved.ids, built.ids)
    np.testing.assert_allclose(moved.proposed_t_landmarks, built.proposed_t_landmarks, atol=1e-9)
