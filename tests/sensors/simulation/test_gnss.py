"""The simulated GNSS receiver: coverage, correlation, outliers, outages."""

import numpy as np
import pytest

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import transform_points
from sensors.measurements import GnssFix
from sensors.simulation.gnss import SimulatedGnss, simulate_gnss
from tests.sensors.simulation.paths import circling, standing

PLAIN = SimulatedGnss(outlier_share=0.0, outages_per_hour=0.0)


def _positions(fixes: list[GnssFix]) -> FloatArray:
    return np.array([(fix.x_m, fix.y_m) for fix in fixes])


def _standing_errors(gnss: SimulatedGnss, seconds: float, seed: int) -> FloatArray:
    return _positions(simulate_gnss(*standing(seconds, 1.0), gnss, np.random.default_rng(seed)))


def test_errors_are_covered_as_the_fixes_say() -> None:
    errors = np.vstack([_standing_errors(PLAIN, 600.0, seed) for seed in range(101, 125)])
    inside = np.abs(errors) < PLAIN.sigma_m
    assert inside.mean() == pytest.approx(0.683, abs=0.05)
    assert (np.abs(errors) < 2.0 * PLAIN.sigma_m).mean() == pytest.approx(0.954, abs=0.03)
    assert errors.mean() == pytest.approx(0.0, abs=0.25)


def test_averaging_helps_against_white_noise_alone() -> None:
    """Variance over T: white^2 / n + 2 correlated^2 (tau/T - (tau/T)^2 (1 - e^(-T/tau)))."""
    runs = np.array([_standing_errors(PLAIN, 300.0, seed)[:300] for seed in range(101, 401)])
    for num in (1, 30, 300):
        ratio = PLAIN.correlation_s / num
        share = 2.0 * (ratio - ratio**2 * (1.0 - np.exp(-1.0 / ratio)))
        expected = PLAIN.white_sigma_m**2 / num + PLAIN.correlated_sigma_m**2 * share
        assert runs[:, :num].mean(axis=1).var() == pytest.approx(expected, rel=0.25)


def test_outliers_are_as_many_as_asked_for_and_not_announced() -> None:
    gnss = SimulatedGnss(outlier_share=0.1, outlier_sigma_m=200.0, outages_per_hour=0.0)
    fixes = simulate_gnss(*standing(5000.0, 1.0), gnss, np.random.default_rng(101))
    far = (np.abs(_positions(fixes)) > 8.0 * gnss.sigma_m).any(axis=1)
    # Of displacements by N(0, 200) on two axes nearly all are beyond 8 sigma.
    assert far.mean() == pytest.approx(0.1, abs=0.02)
    assert {fix.sigma_m for fix in fixes} == {gnss.sigma_m}


def test_outages_come_as_often_and_last_as_long_as_told() -> None:
    gnss = SimulatedGnss(outages_per_hour=60.0, outage_s=12.0)
    stamps: IntArray = np.concatenate(
        [
            [fix.stamp_ns for fix in simulate_gnss(*standing(7200.0, 5.0), gnss, rng)]
            for rng in map(np.random.default_rng, range(101, 105))
        ]
    )
    # Arrivals at random, none counted twice: hidden for 1 - e^(-rate length) of the time.
    hidden = 1.0 - len(stamps) / (4 * 7200 * 5)
    assert hidden == pytest.approx(1.0 - np.exp(-60.0 * 12.0 / 3600.0), abs=0.03)
    gaps_s = np.diff(stamps) * 1e-9
    assert (gaps_s > 0.3).sum() == pytest.approx(4 * 2 * 60 * (1.0 - hidden), rel=0.15)


def test_it_tells_where_the_antenna_is() -> None:
    gnss = SimulatedGnss(1e-6, 0.0, 60.0, 0.0, 0.0, 0.0)
    stamps_ns, poses = circling(60.0, 1.0)
    fixes = simulate_gnss(
        stamps_ns, poses, gnss, np.random.default_rng(0), base_t_antenna=(0.7, -0.2)
    )
    expected = transform_points(poses, np.array([0.7, -0.2]))
    np.testing.assert_allclose(_positions(fixes), expected, atol=1e-4)


def test_a_fix_of_a_moment_and_a_bad_path() -> None:
    assert len(simulate_gnss(*standing(1.0, 1.0), PLAIN, np.random.default_rng(0))) == 1
    with pytest.raises(InputError, match="simulated GNSS: expected increasing stamps"):
        simulate_gnss(np.array([5, 4]), np.zeros((2, 3)), PLAIN, np.random.default_rng(0))


@pytest.mark.parametrize("slot", SimulatedGnss.__slots__)
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_settings_out_of_their_domain_are_refused(slot: str, value: float) -> None:
    with pytest.raises(InputError, match=f"simulated GNSS: expected {slot} "):
        SimulatedGnss(**{slot: value})


def test_a_share_above_one_is_refused() -> None:
    with pytest.raises(InputError, match=r"expected a share up to 1, got 1\.5"):
        SimulatedGnss(outlier_share=1.5)
