"""The simulated IMU: Allan variance, bias, tilt accuracy, refusals."""

from math import radians

import numpy as np
import pytest

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from sensors.measurements import ImuSample
from sensors.simulation.imu import SimulatedImu, simulate_imu
from tests.sensors.simulation.paths import circling, standing

QUIET = SimulatedImu(0.0, 0.0, 0.0, 0.0, 0.0)


def _rates(samples: list[ImuSample]) -> FloatArray:
    return np.array([sample.yaw_rate for sample in samples])


def _tilts(samples: list[ImuSample]) -> FloatArray:
    return np.array([(s.tilt.roll, s.tilt.pitch) for s in samples if s.tilt is not None])


def _allan_variance(rates: FloatArray, num: int) -> float:
    """Half the mean squared step between means of `num` samples, one after the other."""
    means = rates[: len(rates) // num * num].reshape(-1, num).mean(axis=1)
    return float(0.5 * np.mean(np.diff(means) ** 2))


def test_without_noise_it_tells_the_truth() -> None:
    stamps_ns, poses = circling(100.0, 20.0, speed=1.5)
    samples = simulate_imu(stamps_ns, poses, QUIET, np.random.default_rng(0))
    np.testing.assert_allclose(_rates(samples), 0.15, atol=1e-7)
    assert [sample.stamp_ns for sample in samples] == stamps_ns.tolist()
    tilts = np.random.default_rng(1).uniform(-0.1, 0.1, (len(stamps_ns), 2))
    leaning = simulate_imu(stamps_ns, poses, QUIET, np.random.default_rng(0), tilts=tilts)
    np.testing.assert_allclose(_tilts(leaning), tilts)


@pytest.mark.parametrize("rate_hz", [10.0, 100.0])
def test_white_noise_averages_out_as_its_density_says(rate_hz: float) -> None:
    """Allan variance of white noise: density^2 / averaging time, whatever the sampling."""
    imu = SimulatedImu(bias_walk=0.0)
    stamps_ns, poses = standing(1000.0, rate_hz)
    rates = _rates(simulate_imu(stamps_ns, poses, imu, np.random.default_rng(101)))
    for averaging_s in (0.1, 1.0, 5.0):
        expected = imu.noise_density**2 / averaging_s
        variance = _allan_variance(rates, round(averaging_s * rate_hz))
        assert variance == pytest.approx(expected, rel=0.25)


def test_a_wandering_bias_does_not_average_out() -> None:
    """Allan variance of a rate random walk: walk^2 averaging time / 3."""
    imu = SimulatedImu(noise_density=0.0, bias_walk=radians(0.01))
    stamps_ns, poses = standing(20_000.0, 5.0)
    rates = _rates(simulate_imu(stamps_ns, poses, imu, np.random.default_rng(102)))
    for averaging_s in (10.0, 40.0):
        expected = imu.bias_walk**2 * averaging_s / 3.0
        assert _allan_variance(rates, round(averaging_s * 5)) == pytest.approx(expected, rel=0.3)


def test_the_bias_at_the_start_is_drawn_anew_each_run() -> None:
    imu = SimulatedImu(noise_density=0.0, bias_walk=0.0)
    stamps_ns, poses = standing(1.0, 10.0)
    rng = np.random.default_rng(103)
    runs = np.array([_rates(simulate_imu(stamps_ns, poses, imu, rng)) for _ in range(800)])
    assert (np.ptp(runs, axis=1) == 0.0).all()
    assert runs[:, 0].std() == pytest.approx(imu.start_bias, rel=0.1)
    assert runs[:, 0].mean() == pytest.approx(0.0, abs=4.0 * imu.start_bias / np.sqrt(800))


@pytest.mark.parametrize(("speed", "expected"), [(0.0, 0.5), (1.0, 1.0)])
def test_tilt_is_as_accurate_as_the_device_standing_and_moving(
    speed: float, expected: float
) -> None:
    rng = np.random.default_rng(104)
    stamps_ns, poses = circling(20.0, 2.0, speed)
    runs = np.array(
        [_tilts(simulate_imu(stamps_ns, poses, SimulatedImu(), rng)) for _ in range(600)]
    )
    np.testing.assert_allclose(np.degrees(runs.std(axis=0)), expected, rtol=0.15)
    if speed == 0.0:
        assert (np.ptp(runs, axis=1) == 0.0).all()


def test_the_same_seed_gives_the_same_samples() -> None:
    stamps_ns, poses = circling(5.0, 10.0)
    one, other = (
        simulate_imu(stamps_ns, poses, SimulatedImu(), np.random.default_rng(7)) for _ in range(2)
    )
    assert one == other


def test_one_pose_is_a_sample_of_standing() -> None:
    samples = simulate_imu(*standing(1.0, 1.0), QUIET, np.random.default_rng(0))
    assert [sample.yaw_rate for sample in samples] == [0.0]


@pytest.mark.parametrize(
    ("stamps", "poses", "said"),
    [
        ([], np.zeros((0, 3)), "1 stamp or more"),
        ([1, 2], np.zeros((3, 3)), "got 2 stamps and poses of shape"),
        ([1, 2], np.zeros((2, 2)), "got 2 stamps and poses of shape"),
        ([1, 2], np.full((2, 3), np.nan), "expected a finite pose"),
        ([2, 2], np.zeros((2, 3)), "expected increasing stamps; sort"),
    ],
)
def test_a_path_that_is_none_is_refused(stamps: list[int], poses: FloatArray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        simulate_imu(np.array(stamps, np.int64), poses, QUIET, np.random.default_rng(0))


@pytest.mark.parametrize("slot", SimulatedImu.__slots__)
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_settings_out_of_their_domain_are_refused(slot: str, value: float) -> None:
    with pytest.raises(InputError, match=f"simulated IMU: expected {slot} "):
        SimulatedImu(**{slot: value})
