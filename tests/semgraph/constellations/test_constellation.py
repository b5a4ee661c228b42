"""Where a constellation stands in a map: exact, sure where it may be, and never where it is not."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from semgraph.arrays import FloatArray, IntArray
from semgraph.constellations.constellation import Constellation, MapIndex, Placement
from semgraph.errors import InputError
from semgraph.geometry import Pose2, UncertainPose2, rotation, wrap_angle
from semgraph.landmarks import Kind

CONFIDENT = float(np.log(100.0))
DENSITY = 0.0146
SIGMA_M = 0.07


def constellation(
    positions: FloatArray,
    sigma_m: float = SIGMA_M,
    kinds: ArrayLike = Kind.TREE,
    diameters_m: ArrayLike = np.nan,
    identities: ArrayLike = "",
) -> Constellation:
    n = len(positions)
    diameters = np.broadcast_to(np.asarray(diameters_m, dtype=float), n)
    return Constellation(
        positions,
        np.tile(sigma_m**2 * np.eye(2), (n, 1, 1)),
        np.broadcast_to(np.asarray(kinds, dtype=np.int64), n),
        diameters,
        np.where(np.isnan(diameters), np.nan, 0.03),
        np.broadcast_to(np.asarray(identities, dtype=np.str_), n),
    )


def rows_of(group: Constellation, rows: ArrayLike) -> Constellation:
    chosen = np.asarray(rows)
    return Constellation(
        group.positions[chosen],
        group.covariances[chosen],
        group.kinds[chosen],
        group.diameters_m[chosen],
        group.diameter_sigmas_m[chosen],
        group.identities[chosen],
    )


def forest(rng: np.random.Generator, num_trees: int = 400) -> FloatArray:
    return rng.uniform(0.0, (num_trees / DENSITY) ** 0.5, (num_trees, 2))


def near(positions: FloatArray, place: FloatArray, within_m: float) -> IntArray:
    return np.flatnonzero(np.linalg.norm(positions - place, axis=1) <= within_m)


def moved(group: Constellation, a_T_b: Pose2) -> Constellation:
    """The same landmarks in frame a."""
    turn = rotation(a_T_b.theta)
    return replace(
        group,
        positions=a_T_b.transform(group.positions),
        covariances=turn @ group.covariances @ turn.T,
    )


def in_base(positions: FloatArray, map_T_base: Pose2) -> FloatArray:
    return map_T_base.inverse().transform(positions)


def difference(one: Pose2, other: Pose2) -> FloatArray:
    return np.abs(one.between(other).as_array())


def pairs(placement: Placement) -> set[tuple[int, int]]:
    return set(zip(placement.rows.tolist(), placement.columns.tolist(), strict=True))


def looked_at(seed: int) -> tuple[Constellation, Constellation, Pose2]:
    """A map, what is seen of it with noise, misses and clutter, and from where."""
    rng = np.random.default_rng(seed)
    trees = forest(rng)
    side_m = float(np.ptp(trees[:, 0]))
    place = rng.uniform(0.2 * side_m, 0.8 * side_m, 2)
    map_T_base = Pose2(float(place[0]), float(place[1]), float(rng.uniform(-np.pi, np.pi)))
    rows = near(trees, place, 20.0)
    rows = rows[rng.uniform(size=len(rows)) > 0.1]
    seen = np.vstack([in_base(trees[rows], map_T_base), rng.uniform(-14.0, 14.0, (1, 2))])
    return (
        constellation(trees + rng.normal(0.0, SIGMA_M, trees.shape)),
        constellation(seen + rng.normal(0.0, SIGMA_M, seen.shape)),
        map_T_base,
    )


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10_000))
def test_without_noise_it_is_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    trees = forest(rng)
    map_T_base = Pose2(80.0, 90.0, float(rng.uniform(-np.pi, np.pi)))
    rows = rng.permutation(near(trees, np.array([80.0, 90.0]), 20.0))
    best = MapIndex(constellation(trees)).place(constellation(in_base(trees[rows], map_T_base)))[0]
    assert difference(best.map_T_local.pose, map_T_base).max() < 1e-6
    assert pairs(best) == set(enumerate(rows.tolist()))
    assert best.log_odds > CONFIDENT


@pytest.mark.parametrize("seed", range(5))
def test_with_noise_misses_and_clutter_the_error_is_as_the_covariance_says(seed: int) -> None:
    mapped, seen, map_T_base = looked_at(seed)
    best = MapIndex(mapped).place(seen)[0]
    error = best.map_T_local.pose.between(map_T_base).as_array()
    # 99.99 % of chi-square, 3 degrees of freedom.
    assert error @ np.linalg.solve(best.map_T_local.covariance, error) < 21.1
    assert best.log_odds > CONFIDENT
    assert len(seen) - 1 not in best.rows


def half_found(seed: int) -> tuple[Constellation, Constellation, Pose2]:
    """A dense wood of which every second tree is mapped, and every second one in sight is seen."""
    rng = np.random.default_rng(seed)
    trees = 0.6 * forest(rng, 1200)
    x, y, theta = rng.uniform([60.0, 60.0, -np.pi], [110.0, 110.0, np.pi]).tolist()
    map_T_base = Pose2(x, y, theta)
    mapped = trees[rng.uniform(size=len(trees)) < 0.5]
    in_sight = trees[near(trees, map_T_base.as_array()[:2], 15.0)]
    seen = in_base(in_sight[rng.uniform(size=len(in_sight)) < 0.5], map_T_base)
    return (
        constellation(mapped + rng.normal(0.0, 0.04, mapped.shape), 0.04),
        constellation(seen + rng.normal(0.0, 0.04, seen.shape), 0.04),
        map_T_base,
    )


def test_where_half_is_found_the_place_is_more_likely_than_not_and_no_other_one() -> None:
    is_found = []
    for seed in range(12):
        mapped, seen, map_T_base = half_found(seed)
        best = MapIndex(mapped).place(seen)[0]
        is_right = difference(best.map_T_local.pose, map_T_base)[:2].max() < 0.3
        assert is_right or best.log_odds < 0.0
        is_found.append(is_right and best.log_odds > 0.0)
    assert sum(is_found) >= 8


@settings(max_examples=5, deadline=None)
@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-3.1, 3.1), st.integers(0, 99))
def test_the_placement_moves_with_the_map(x: float, y: float, theta: float, seed: int) -> None:
    mapped, seen, _ = looked_at(seed)
    new_T_map = Pose2(x, y, theta)
    before = MapIndex(mapped).place(seen)[0]
    after = MapIndex(moved(mapped, new_T_map)).place(seen)[0]
    assert difference(after.map_T_local.pose, new_T_map @ before.map_T_local.pose).max() < 1e-5
    np.testing.assert_allclose(after.map_T_local.covariance, before.map_T_local.covariance, 1e-4)
    assert pairs(after) == pairs(before)


@settings(max_examples=5, deadline=None)
@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-3.1, 3.1), st.integers(0, 99))
def test_the_local_frame_does_not_matter(x: float, y: float, theta: float, seed: int) -> None:
    mapped, seen, _ = looked_at(seed)
    other_T_local = Pose2(x, y, theta)
    index = MapIndex(mapped)
    before, after = index.place(seen)[0], index.place(moved(seen, other_T_local))[0]
    expected = before.map_T_local.pose @ other_T_local.inverse()
    middle = other_T_local.transform(seen.positions.mean(axis=0, keepdims=True))
    np.testing.assert_allclose(
        after.map_T_local.pose.transform(middle), expected.transform(middle), atol=1e-5
    )
    assert abs(wrap_angle(after.map_T_local.pose.theta - expected.theta)) < 1e-6
    assert after.log_odds == pytest.approx(before.log_odds, abs=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_landmarks_does_not_matter(seed: int) -> None:
    mapped, seen, _ = looked_at(seed)
    rng = np.random.default_rng(seed)
    of_map, of_seen = rng.permutation(len(mapped)), rng.permutation(len(seen))
    before = MapIndex(mapped).place(seen)[0]
    after = MapIndex(rows_of(mapped, of_map)).place(rows_of(seen, of_seen))[0]
    back = {(int(of_seen[row]), int(of_map[column])) for row, column in pairs(after)}
    assert back == pairs(before)
    assert difference(after.map_T_local.pose, before.map_T_local.pose).max() < 1e-6
    assert after.log_odds == pytest.approx(before.log_odds, abs=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_nowhere_in_the_map_nothing_is_confident(seed: int) -> None:
    rng = np.random.default_rng(seed)
    index = MapIndex(constellation(forest(rng)))
    elsewhere = constellation(forest(rng, 12))
    assert all(each.log_odds < CONFIDENT for each in index.place(elsewhere))


@pytest.mark.parametrize("seed", range(5))
def test_a_mirror_image_is_not_the_place(seed: int) -> None:
    mapped, seen, _ = looked_at(seed)
    mirrored = replace(seen, positions=seen.positions * (1.0, -1.0))
    assert all(each.log_odds < CONFIDENT for each in MapIndex(mapped).place(mirrored))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("num_columns", [20, 60])
def test_rows_that_look_alike_leave_every_placement_in_doubt(seed: int, num_columns: int) -> None:
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(4.0 * np.arange(20), 3.0 * np.arange(num_columns)), axis=-1)
    trees = grid.reshape(-1, 2) + rng.normal(0.0, 0.05, (20 * num_columns, 2))
    rows = near(trees, trees.mean(axis=0), 13.0)
    placements = MapIndex(constellation(trees + rng.normal(0.0, 0.1, trees.shape), 0.1)).place(
        constellation(trees[rows] + rng.normal(0.0, SIGMA_M, (len(rows), 2)))
    )
    assert len(placements) > 1
    assert all(each.log_odds < CONFIDENT for each in placements)


def test_a_prior_tells_places_apart_that_are_alike() -> None:
    rng = np.random.default_rng(3)
    trees = forest(rng, 200)
    there = Pose2(60.0, -100.0, 2.0)
    index = MapIndex(constellation(np.vstack([trees, there.transform(trees)])))
    rows = near(trees, trees.mean(axis=0), 20.0)
    seen = constellation(trees[rows])
    for place, columns in ((Pose2(), rows), (there, rows + 200)):
        believed = UncertainPose2(place @ Pose2(0.5, 0.3, 0.02), np.diag([1.0, 1.0, 0.1**2]))
        best, *others = index.place(seen, prior=believed)
        assert best.columns.tolist() == columns.tolist()
        assert best.log_odds > CONFIDENT
        assert all(other.log_odds < -CONFIDENT for other in others)
    nowhere = UncertainPose2(Pose2(30.0, 0.0, 0.0), np.diag([1.0, 1.0, 0.1**2]))
    assert all(each.log_odds < CONFIDENT for each in index.place(seen, prior=nowhere))


def test_a_wide_prior_is_none() -> None:
    """Where it leaves all of the map open, placements and odds are those without."""
    rng = np.random.default_rng(5)
    trees = forest(rng, 100)
    rows = near(trees, trees.mean(axis=0), 15.0)
    index = MapIndex(constellation(trees))
    wide = UncertainPose2(Pose2(*trees.mean(axis=0).tolist()), np.diag([40.0, 40.0, 3.0]) ** 2)
    with_prior, without = (
        index.place(constellation(trees[rows]), prior=prior)[0] for prior in (wide, None)
    )
    assert pairs(with_prior) == pairs(without)
    assert with_prior.log_odds == pytest.approx(without.log_odds, abs=3.0)


def test_of_two_places_that_are_alike_both_are_found_and_neither_is_sure() -> None:
    rng = np.random.default_rng(3)
    trees = forest(rng, 200)
    there = Pose2(300.0, -100.0, 2.0)
    twice = np.vstack([trees, there.transform(trees)])
    rows = near(trees, trees.mean(axis=0), 20.0)
    best, second = MapIndex(constellation(twice)).place(constellation(trees[rows]))[:2]
    assert {tuple(each.columns.tolist()) for each in (best, second)} == {
        tuple(rows.tolist()),
        tuple((rows + 200).tolist()),
    }
    assert best.log_odds == pytest.approx(0.0, abs=0.2)


def test_a_diameter_tells_apart_what_shape_does_not() -> None:
    rng = np.random.default_rng(3)
    trees = forest(rng, 200)
    twice = np.vstack([trees, Pose2(300.0, -100.0, 2.0).transform(trees)])
    diameters_m = rng.uniform(0.1, 0.8, 400)
    rows = near(trees, trees.mean(axis=0), 20.0)
    index = MapIndex(constellation(twice, diameters_m=diameters_m))
    best = index.place(constellation(trees[rows], diameters_m=diameters_m[rows + 200]))[0]
    assert best.columns.tolist() == (rows + 200).tolist()
    assert best.log_odds > CONFIDENT


def test_kinds_are_respected() -> None:
    mapped, seen, _ = looked_at(1)
    rocks = replace(seen, kinds=np.full(len(seen), int(Kind.ROCK)))
    assert MapIndex(mapped).place(rocks) == ()


def test_a_landmark_of_another_kind_is_left_unpaired() -> None:
    mapped, seen, _ = looked_at(1)
    kinds = np.array(seen.kinds)
    kinds[0] = Kind.ROCK
    best = MapIndex(mapped).place(replace(seen, kinds=kinds))[0]
    assert 0 in MapIndex(mapped).place(seen)[0].rows
    assert 0 not in best.rows
    assert best.log_odds > CONFIDENT


def test_two_markers_with_names_tell_the_place() -> None:
    rng = np.random.default_rng(0)
    markers = rng.uniform(0.0, 150.0, (10, 2))
    names = np.array([f"tag {k}" for k in range(10)])
    index = MapIndex(constellation(markers, kinds=Kind.MARKER, identities=names))
    map_T_base = Pose2(30.0, 40.0, 1.0)
    seen = constellation(
        in_base(markers[[2, 7]], map_T_base), kinds=Kind.MARKER, identities=names[[2, 7]]
    )
    best = index.place(seen)[0]
    assert difference(best.map_T_local.pose, map_T_base).max() < 1e-6
    assert best.columns.tolist() == [2, 7]
    assert best.log_odds > CONFIDENT


def test_another_name_is_another_landmark() -> None:
    mapped, seen, _ = looked_at(1)
    names = np.array([f"tree {k}" for k in range(len(mapped))])
    best = MapIndex(replace(mapped, identities=names)).place(seen)[0]
    row, column = int(best.rows[0]), int(best.columns[0])
    identities = np.full(len(seen), "", dtype=names.dtype)
    for name, is_paired in ((names[column], True), ("another", False)):
        identities[row] = name
        placements = MapIndex(replace(mapped, identities=names)).place(
            replace(seen, identities=identities)
        )
        assert (row in placements[0].rows) is is_paired


@pytest.mark.parametrize("num_seen", [0, 1, 2])
def test_too_few_to_make_a_shape_have_no_placement(num_seen: int) -> None:
    trees = forest(np.random.default_rng(0))
    assert MapIndex(constellation(trees)).place(constellation(trees[:num_seen])) == ()


@pytest.mark.parametrize("num_mapped", [0, 1, 2])
def test_in_too_small_a_map_there_is_no_placement(num_mapped: int) -> None:
    trees = forest(np.random.default_rng(0))
    assert MapIndex(constellation(trees[:num_mapped])).place(constellation(trees[:10])) == ()


def test_three_in_a_map_of_three_are_placed_without_being_sure() -> None:
    trees = np.array([[0.0, 0.0], [7.0, 0.0], [2.0, 5.0]])
    best = MapIndex(constellation(trees)).place(constellation(trees))[0]
    assert best.columns.tolist() == [0, 1, 2]


def test_no_more_placements_than_asked_for_the_best_first() -> None:
    rows = forest(np.random.default_rng(0), 200)
    often = np.vstack([rows + np.array([300.0 * k, 0.0]) for k in range(5)])
    index = MapIndex(constellation(often))
    placements = index.place(constellation(rows[near(rows, rows.mean(axis=0), 20.0)]), 4)
    odds = [each.log_odds for each in placements]
    assert len(odds) == 4
    assert odds == sorted(odds, reverse=True)


def test_one_uncertain_landmark_of_the_map_does_not_hide_the_others() -> None:
    mapped, seen, map_T_base = looked_at(2)
    covariances = np.array(mapped.covariances)
    covariances[::20] = 100.0 * np.eye(2)
    best = MapIndex(replace(mapped, covariances=covariances)).place(seen)[0]
    assert best.log_odds > CONFIDENT
    assert difference(best.map_T_local.pose, map_T_base)[:2].max() < 0.5


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("positions", np.zeros((2, 3)), "positions"),
        ("covariances", np.zeros((2, 2, 2)), "positive definite"),
        ("kinds", np.array([0, 9]), "codes of Kind"),
        ("diameters_m", np.array([-1.0, np.nan]), "positive"),
        ("identities", np.array([""]), "identities"),
    ],
)
def test_a_bad_value_is_refused(name: str, value: FloatArray, expected: str) -> None:
    good = constellation(np.array([[0.0, 0.0], [1.0, 0.0]]))
    values = {each.name: getattr(good, each.name) for each in fields(good)} | {name: value}
    with pytest.raises(InputError, match=expected):
        Constellation(**values)


def test_arrays_are_copied_and_read_only() -> None:
    positions = np.array([[0.0, 0.0], [1.0, 0.0]])
    group = constellation(positions)
    positions[0] = 9.0
    assert group.positions[0].tolist() == [0.0, 0.0]
    with pytest.raises(ValueError, match="read-only"):
        group.positions[0] = 9.0
