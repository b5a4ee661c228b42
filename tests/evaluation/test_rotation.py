"""Yaw rates are compared over the same time, with simulated devices whose errors are known."""

import numpy as np
import pytest

from evaluation.rotation import turn_rates
from semgraph.arrays import FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.files.yaw_rates import YawRates
from sensors.simulation.imu import SimulatedImu, simulate_imu

PERFECT = SimulatedImu(0.0, 0.0, 0.0, 0.0, 0.0)


def path(seconds: FloatArray) -> tuple[IntArray, FloatArray]:
    """Winds about, through the whole circle and over its seam."""
    headings = 2.0 * np.sin(0.7 * seconds) + 0.4 * seconds
    poses = np.column_stack([seconds, 0.0 * seconds, (headings + np.pi) % (2.0 * np.pi) - np.pi])
    return 10**18 + np.round(1e9 * seconds).astype(np.int64), poses


def measured(device: SimulatedImu, seconds: FloatArray, seed: int = 0) -> YawRates:
    stamps_ns, poses = path(seconds)
    samples = simulate_imu(stamps_ns, poses, device, np.random.default_rng(seed))
    return YawRates(stamps_ns, np.array([each.yaw_rate for each in samples]))


def estimate(seconds: FloatArray) -> Trajectory:
    return Trajectory(*path(seconds))


def test_a_perfect_estimate_differs_from_a_perfect_sensor_by_nothing() -> None:
    rates = turn_rates(
        estimate(np.arange(0.0, 40.0, 0.1)), measured(PERFECT, np.arange(0.0, 40.0, 0.02))
    )
    assert rates is not None
    assert len(rates.stamps_ns) == 399
    assert rates.rms < 1e-6
    assert np.ptp(rates.estimated) > 2.0
    assert rates.stamps_ns[0] == 10**18 + 50_000_000


def test_stamps_of_their_own_cost_little() -> None:
    imu = measured(PERFECT, np.arange(0.003, 40.0, 0.01))
    rates = turn_rates(estimate(np.arange(0.0, 39.0, 0.13)), imu)
    assert rates is not None
    assert len(rates.stamps_ns) == 298
    assert rates.rms < 2e-4


def test_a_bias_is_the_difference() -> None:
    device = SimulatedImu(0.0, 0.02, 0.0, 0.0, 0.0)
    imu = measured(device, np.arange(0.0, 20.0, 0.02))
    rates = turn_rates(estimate(np.arange(0.0, 20.0, 0.1)), imu)
    assert rates is not None
    assert np.ptp(rates.differences) < 1e-6
    assert rates.rms == pytest.approx(abs(rates.differences[0]), rel=1e-6)
    assert rates.rms > 1e-3


def test_white_noise_shrinks_with_the_time_it_is_averaged_over() -> None:
    density = 0.01
    imu = measured(SimulatedImu(density, 0.0, 0.0, 0.0, 0.0), np.arange(0.0, 200.0, 0.02))
    for span_s in (0.1, 1.0):
        rates = turn_rates(estimate(np.arange(0.0, 200.0, span_s)), imu)
        assert rates is not None
        assert rates.rms == pytest.approx(density / np.sqrt(span_s), rel=0.15)


def test_nothing_is_compared_across_gaps_or_outside() -> None:
    every = np.arange(0.0, 30.0, 0.02)
    imu = measured(PERFECT, every[(every < 10.0) | (every > 15.0)])
    seconds = np.arange(-5.0, 40.0, 0.1)
    seconds = seconds[(seconds < 20.0) | (seconds > 24.0)]
    rates = turn_rates(estimate(seconds), imu)
    assert rates is not None
    middles = (rates.stamps_ns - 10**18) * 1e-9
    assert middles.min() > 0.0
    assert middles.max() < 30.0
    assert not ((middles > 10.0) & (middles < 15.0)).any()
    assert not ((middles > 20.0) & (middles < 24.0)).any()
    assert ((middles > 15.1) & (middles < 20.0)).sum() >= 48
    assert rates.rms < 1e-6


def test_where_there_is_nothing_there_is_none() -> None:
    whole = estimate(np.arange(0.0, 5.0, 0.1))
    imu = measured(PERFECT, np.arange(0.0, 5.0, 0.02))
    later = measured(PERFECT, np.arange(50.0, 55.0, 0.02))
    one = Trajectory(whole.stamps_ns[:1], whole.map_T_bases[:1])
    assert turn_rates(whole, YawRates()) is None
    assert turn_rates(one, imu) is None
    assert turn_rates(whole, later) is None
