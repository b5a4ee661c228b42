import time

import numpy as np
import pytest

from semgraph.arrays import FloatArray, IntArray
from semgraph.landmarks import Kind, Perceptions, Tree
from semgraph.navigation_map import Averaging, NavigationMap


def perceptions_of(
    n: int,
    *,
    kind: Kind | IntArray = Kind.TREE,
    diameters_m: FloatArray | None = None,
    diameter_sigmas_m: FloatArray | None = None,
    identities: list[str] | None = None,
    reliabilities: FloatArray | None = None,
) -> Perceptions:
    """n perceptions; where they are is told to the map apart."""
    return Perceptions.from_arrays(
        0,
        kind,
        np.ones(n),
        np.zeros(n),
        np.tile(np.eye(2), (n, 1, 1)),
        diameters_m=diameters_m,
        diameter_sigmas_m=diameter_sigmas_m,
        identities=None if identities is None else np.array(identities, dtype=np.str_),
        reliabilities=reliabilities,
    )


def same_covariances(n: int, sigma_m: float = 0.1) -> FloatArray:
    return np.tile(sigma_m**2 * np.eye(2), (n, 1, 1))


def random_covariances(rng: np.random.Generator, n: int) -> FloatArray:
    roots = 0.1 * (np.eye(2) + 0.4 * rng.standard_normal((n, 2, 2)))
    return roots @ roots.transpose(0, 2, 1) + 1e-4 * np.eye(2)


def filled(rng: np.random.Generator, n: int, side_m: float) -> NavigationMap:
    navigation_map = NavigationMap()
    positions = rng.uniform(0.0, side_m, (n, 2))
    navigation_map.insert(perceptions_of(n), positions, same_covariances(n))
    return navigation_map


def brute_force(navigation_map: NavigationMap, point: FloatArray, radius_m: float) -> IntArray:
    positions = navigation_map.positions(np.arange(len(navigation_map)))
    return np.flatnonzero(np.hypot(*(positions - point).T) <= radius_m)


def test_an_empty_map_has_nothing_near() -> None:
    navigation_map = NavigationMap()
    assert len(navigation_map) == 0
    assert list(navigation_map) == []
    assert len(navigation_map.near(np.zeros(2), 100.0)) == 0
    assert navigation_map.with_identity(Kind.MARKER, "A1") is None
    assert len(navigation_map.insert(perceptions_of(0), np.zeros((0, 2)), same_covariances(0))) == 0


@pytest.mark.parametrize("averaging", list(Averaging))
def test_near_is_brute_force_after_thousands_of_changes(averaging: Averaging) -> None:
    """Inserts, updates in place and updates that move landmarks across many cells."""
    rng = np.random.default_rng(0)
    navigation_map = NavigationMap(averaging)
    num_changes = 0
    for _ in range(300):
        n = int(rng.integers(1, 12))
        if len(navigation_map) < 30 or rng.uniform() < 0.4:
            positions = rng.uniform(-40.0, 40.0, (n, 2))
            ids = navigation_map.insert(perceptions_of(n), positions, random_covariances(rng, n))
        else:
            ids = rng.choice(len(navigation_map), n, replace=False)
            reach = rng.choice([0.1, 5.0, 60.0])
            positions = navigation_map.positions(ids) + reach * rng.standard_normal((n, 2))
            navigation_map.update(
                ids, perceptions_of(n), positions, 0.1 * random_covariances(rng, n)
            )
        num_changes += len(ids)
        for radius_m in (0.5, 5.0, 23.0):
            point = rng.uniform(-45.0, 45.0, 2)
            np.testing.assert_array_equal(
                navigation_map.near(point, radius_m), brute_force(navigation_map, point, radius_m)
            )
    assert num_changes > 1500
    everything = navigation_map.near(np.zeros(2), 1e3)
    np.testing.assert_array_equal(everything, np.arange(len(navigation_map)))


def test_near_includes_its_rim_and_negative_cells() -> None:
    navigation_map = NavigationMap()
    positions = np.array([[-5.0, -5.0], [-2.0, -5.0], [-5.0, 0.0], [5.0, 5.0]])
    navigation_map.insert(perceptions_of(4), positions, same_covariances(4))
    np.testing.assert_array_equal(navigation_map.near(np.array([-5.0, -5.0]), 3.0), [0, 1])
    np.testing.assert_array_equal(navigation_map.near(np.array([-5.0, -5.0]), 5.0), [0, 1, 2])


def test_near_a_thousand_kilometres_looks_at_what_there_is_only() -> None:
    navigation_map = NavigationMap()
    positions = np.array([[-5.0, -5.0], [2.0, 0.0], [3e6, 0.0]])
    navigation_map.insert(perceptions_of(3), positions, same_covariances(3))
    np.testing.assert_array_equal(navigation_map.near(np.zeros(2), 1e6), [0, 1])


def test_near_leaves_out_what_was_last_sighted_earlier() -> None:
    navigation_map = NavigationMap()
    positions = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    navigation_map.insert(perceptions_of(3), positions, same_covariances(3), driven_m=10.0)
    navigation_map.update(
        np.array([1]), perceptions_of(1), positions[[1]], same_covariances(1), driven_m=25.0
    )
    for since_m, expected in ((10.0, [0, 1, 2]), (10.1, [1]), (25.0, [1]), (25.1, [])):
        np.testing.assert_array_equal(navigation_map.near(np.zeros(2), 5.0, since_m), expected)


def test_what_is_forgotten_is_near_nothing_until_it_is_sighted_again() -> None:
    navigation_map = NavigationMap()
    positions = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    for driven_m in (10.0, 20.0):
        navigation_map.insert(
            perceptions_of(3), positions + driven_m, same_covariances(3), driven_m=driven_m
        )
    here = np.array([11.0, 10.0])
    for _ in range(2):
        navigation_map.forget(20.0)
        np.testing.assert_array_equal(navigation_map.near(here, 50.0), [3, 4, 5])
    navigation_map.update(
        np.array([1]), perceptions_of(1), positions[[1]] + 10.0, same_covariances(1), driven_m=30.0
    )
    np.testing.assert_array_equal(navigation_map.near(here, 50.0), [1, 3, 4, 5])
    assert len(navigation_map) == 6


def sighted(averaging: Averaging, positions: FloatArray, covariances: FloatArray) -> NavigationMap:
    """One landmark, sighted at each of the positions (n, 2)."""
    navigation_map = NavigationMap(averaging)
    navigation_map.insert(perceptions_of(1), positions[:1], covariances[:1])
    for k in range(1, len(positions)):
        navigation_map.update(np.array([0]), perceptions_of(1), positions[[k]], covariances[[k]])
    return navigation_map


@pytest.mark.parametrize("averaging", list(Averaging))
@pytest.mark.parametrize("n", [1, 2, 7, 500])
def test_equally_sure_sightings_average_to_the_mean(averaging: Averaging, n: int) -> None:
    positions = np.random.default_rng(n).uniform(-50.0, 50.0, (n, 2))
    landmark = sighted(averaging, positions, same_covariances(n, 0.2)).landmark(0)
    np.testing.assert_allclose(landmark.map_t_landmark, positions.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(landmark.covariance, 0.2**2 / n * np.eye(2), atol=1e-12)
    assert landmark.num_sightings == n


def test_information_weighs_each_sighting_by_its_covariance() -> None:
    rng = np.random.default_rng(1)
    positions, covariances = rng.uniform(-5.0, 5.0, (20, 2)), random_covariances(rng, 20)
    weights = np.linalg.inv(covariances)
    expected = np.linalg.solve(weights.sum(axis=0), np.einsum("nij,nj->i", weights, positions))
    landmark = sighted(Averaging.INFORMATION, positions, covariances).landmark(0)
    np.testing.assert_allclose(landmark.map_t_landmark, expected, atol=1e-9)
    np.testing.assert_allclose(landmark.covariance, np.linalg.inv(weights.sum(axis=0)), rtol=1e-9)


def test_sightings_are_averaged_plainly_whatever_their_covariances() -> None:
    rng = np.random.default_rng(2)
    positions, covariances = rng.uniform(-5.0, 5.0, (20, 2)), random_covariances(rng, 20)
    landmark = sighted(Averaging.SIGHTINGS, positions, covariances).landmark(0)
    np.testing.assert_allclose(landmark.map_t_landmark, positions.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(
        landmark.covariance, covariances.sum(axis=0) / len(covariances) ** 2, rtol=1e-9
    )


def test_every_landmark_has_its_own_counter() -> None:
    rng = np.random.default_rng(3)
    navigation_map = filled(rng, 150, 50.0)
    expected = np.ones(150, dtype=np.int64)
    for _ in range(100):
        ids = rng.choice(150, int(rng.integers(0, 20)), replace=False)
        n = len(ids)
        navigation_map.update(
            ids, perceptions_of(n), navigation_map.positions(ids), same_covariances(n)
        )
        expected[ids] += 1
    np.testing.assert_array_equal(navigation_map.num_sightings(np.arange(150)), expected)
    assert [landmark.num_sightings for landmark in navigation_map] == expected.tolist()
    assert [landmark.id for landmark in navigation_map] == list(range(150))


def test_diameters_are_averaged_by_their_sigmas_over_those_perceived() -> None:
    """And the mean is as sure as one of them: what shows one side of a thing errs alike."""
    diameters_m = np.array([np.nan, 0.30, 0.36, np.nan, 0.33])
    sigmas_m = np.array([np.nan, 0.03, 0.06, np.nan, 0.02])
    navigation_map = NavigationMap()
    for k in range(5):
        seen = perceptions_of(1, diameters_m=diameters_m[[k]], diameter_sigmas_m=sigmas_m[[k]])
        if k == 0:
            navigation_map.insert(seen, np.zeros((1, 2)), same_covariances(1))
            assert navigation_map.landmark(0).semantics == Tree()
        else:
            navigation_map.update(np.array([0]), seen, np.zeros((1, 2)), same_covariances(1))
    weights = sigmas_m[[1, 2, 4]] ** -2.0
    diameter = navigation_map.landmark(0).semantics.diameter
    assert diameter is not None
    assert diameter.mean_m == pytest.approx(np.average(diameters_m[[1, 2, 4]], weights=weights))
    assert diameter.sigma_m == pytest.approx((3 / weights.sum()) ** 0.5)


def test_reliability_is_that_not_all_sightings_were_false() -> None:
    navigation_map = NavigationMap()
    shares = [0.5, 0.2, 0.0]
    for k, share in enumerate(shares):
        seen = perceptions_of(1, reliabilities=np.array([share]))
        if k == 0:
            navigation_map.insert(seen, np.zeros((1, 2)), same_covariances(1))
        else:
            navigation_map.update(np.array([0]), seen, np.zeros((1, 2)), same_covariances(1))
    assert navigation_map.landmark(0).reliability == pytest.approx(1.0 - 0.5 * 0.8 * 1.0)


def test_identities_are_found_by_kind_and_text() -> None:
    navigation_map = NavigationMap()
    kinds = np.array([Kind.MARKER, Kind.MARKER, Kind.TREE, Kind.TREE])
    seen = perceptions_of(4, kind=kinds, identities=["A1", "B2", "A1", ""])
    navigation_map.insert(seen, np.arange(8.0).reshape(4, 2), same_covariances(4))
    assert navigation_map.with_identity(Kind.MARKER, "A1") == 0
    assert navigation_map.with_identity(Kind.MARKER, "B2") == 1
    assert navigation_map.with_identity(Kind.TREE, "A1") == 2
    assert navigation_map.with_identity(Kind.ROCK, "A1") is None
    assert navigation_map.with_identity(Kind.TREE, "") is None
    assert navigation_map.identities(np.array([2, 3, 0])) == ["A1", "", "A1"]
    np.testing.assert_array_equal(navigation_map.kinds(np.arange(4)), kinds)


def test_growing_keeps_every_landmark_as_it_was() -> None:
    rng = np.random.default_rng(5)
    positions, diameters_m = rng.uniform(-99.0, 99.0, (500, 2)), rng.uniform(0.1, 0.9, 500)
    navigation_map = NavigationMap()
    for k in range(500):
        seen = perceptions_of(
            1, diameters_m=diameters_m[[k]], diameter_sigmas_m=0.1 * diameters_m[[k]]
        )
        ids = navigation_map.insert(seen, positions[[k]], same_covariances(1))
        np.testing.assert_array_equal(ids, [k])
    np.testing.assert_array_equal(navigation_map.positions(np.arange(500)), positions)
    means, sigmas = navigation_map.diameters(np.arange(500))
    np.testing.assert_allclose(means, diameters_m)
    np.testing.assert_allclose(sigmas, 0.1 * diameters_m)


def median_seconds(navigation_map: NavigationMap, points: FloatArray) -> float:
    spans = []
    for point in points:
        start = time.perf_counter()
        navigation_map.near(point, 15.0)
        spans.append(time.perf_counter() - start)
    return float(np.median(spans))


def test_near_takes_as_long_in_a_hundred_times_larger_map() -> None:
    rng = np.random.default_rng(6)
    medians = []
    for n in (1_000, 100_000):
        side_m = np.sqrt(n / 0.05)
        navigation_map = filled(rng, n, side_m)
        points = rng.uniform(20.0, side_m - 20.0, (300, 2))
        for point in points[:20]:
            found = navigation_map.near(point, 15.0)
            np.testing.assert_array_equal(found, brute_force(navigation_map, point, 15.0))
        medians.append(median_seconds(navigation_map, points))
    assert medians[1] <= 5.0 * medians[0]
