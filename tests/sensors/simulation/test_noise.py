"""Noise processes against their closed-form moments."""

import numpy as np
import pytest

from sensors.simulation.noise import check_domain, gauss_markov, random_walk


def test_a_random_walk_grows_by_the_time_that_passes() -> None:
    rng = np.random.default_rng(101)
    seconds = np.array([0.0, 0.5, 0.6, 4.0, 9.0])
    walks = np.array([random_walk(seconds, 0.3, 0.2, rng) for _ in range(4000)])
    np.testing.assert_allclose(walks.var(axis=0), 0.09 + 0.04 * seconds, rtol=0.08)
    np.testing.assert_allclose(walks.mean(axis=0), 0.0, atol=0.04)


def test_gauss_markov_noise_is_stationary_and_forgets_as_told() -> None:
    rng = np.random.default_rng(102)
    seconds = np.array([0.0, 1.0, 1.5, 5.0, 20.0])
    noise = gauss_markov(seconds, 2.0, 3.0, 8000, rng)
    expected = 4.0 * np.exp(-np.abs(seconds[:, None] - seconds) / 3.0)
    np.testing.assert_allclose(np.cov(noise), expected, atol=0.2)


def test_a_domain_names_the_setting() -> None:
    from semgraph.errors import InputError
    from sensors.simulation.imu import SimulatedImu

    check_domain("IMU", SimulatedImu())
    with pytest.raises(InputError, match="simulated IMU: expected start_bias of at least 0, got"):
        SimulatedImu(start_bias=-0.1)
