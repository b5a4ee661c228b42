import time

import numpy as np
import pytest

from semgraph.landmarks import Kind, Perceptions, polar_covariances
from semgraph.navigation_map import Averaging, NavigationMap


def perceptions(n: int, diameter_m: float = 0.3) -> Perceptions:
    return Perceptions.from_arrays(
        0,
        Kind.TREE,
        np.ones(n),
        np.zeros(n),
        polar_covariances(np.full(n, 0.1), np.full(n, 0.1)),
        diameters_m=np.full(n, diameter_m),
        diameter_sigmas_m=np.full(n, 0.1),
    )


def covariances(n: int, sigma_m: float = 0.1) -> np.ndarray:
    return np.tile(sigma_m**2 * np.eye(2), (n, 1, 1))


def test_near_equals_brute_force_while_landmarks_move() -> None:
    rng = np.random.default_rng(0)
    landmarks = NavigationMap(Averaging.SIGHTINGS)
    landmarks.insert(perceptions(500), rng.uniform(-40, 40, (500, 2)), covariances(500))
    for _ in range(30):
        ids = rng.choice(500, 50, replace=False)
        landmarks.update(ids, perceptions(50), rng.uniform(-40, 40, (50, 2)), covariances(50))
        point, radius_m = rng.uniform(-40, 40, 2), rng.uniform(0.5, 25.0)
        positions = landmarks.positions(np.arange(500))
        expected = np.flatnonzero(np.linalg.norm(positions - point, axis=1) <= radius_m)
        np.testing.assert_array_equal(landmarks.near(point, radius_m), expected)


@pytest.mark.parametrize("averaging", Averaging)
def test_position_and_diameter_are_means_of_all_sightings(averaging: Averaging) -> None:
    rng = np.random.default_rng(1)
    seen = rng.normal(5.0, 0.2, (40, 2))
    sigmas = rng.uniform(0.05, 0.5, 40)
    landmarks = NavigationMap(averaging)
    ids = landmarks.insert(perceptions(1, 0.2), seen[:1], covariances(1, sigmas[0]))
    for k in range(1, 40):
        landmarks.update(ids, perceptions(1, 0.4), seen[[k]], covariances(1, sigmas[k]))
    weights = sigmas**-2.0 if averaging is Averaging.INFORMATION else np.ones(40)
    landmark = landmarks.landmark(0)
    expected = np.average(seen, axis=0, weights=weights)
    np.testing.assert_allclose(landmark.map_t_landmark, expected, atol=1e-9)
    assert landmark.num_sightings == 40
    assert landmark.semantics.diameter is not None
    assert landmark.semantics.diameter.mean_m == pytest.approx((0.2 + 39 * 0.4) / 40)


def test_near_stays_fast_with_100_000_landmarks() -> None:
    rng = np.random.default_rng(2)
    medians = []
    for count in (1_000, 100_000):
        side_m = np.sqrt(count / 0.05)
        landmarks = NavigationMap()
        landmarks.insert(perceptions(count), rng.uniform(0, side_m, (count, 2)), covariances(count))
        seconds = []
        for _ in range(200):
            before = time.perf_counter()
            found = landmarks.near(np.array([side_m / 2, side_m / 2]), 15.0)
            seconds.append(time.perf_counter() - before)
            assert len(found) > 0
        medians.append(float(np.median(seconds)))
    assert medians[1] < 5.0 * medians[0]


def test_what_was_sighted_long_ago_is_left_out_on_demand() -> None:
    landmarks = NavigationMap()
    old = landmarks.insert(perceptions(1), np.zeros((1, 2)), covariances(1), 0.0)
    new = landmarks.insert(perceptions(1), np.ones((1, 2)), covariances(1), 30.0)
    assert landmarks.near(np.zeros(2), 5.0).tolist() == [*old, *new]
    assert landmarks.near(np.zeros(2), 5.0, since_m=10.0).tolist() == [*new]
