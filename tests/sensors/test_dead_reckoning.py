"""Odometry from speeds and yaw rates."""

import math

import numpy as np
import pytest

from semgraph.geometry import Pose2
from sensors.dead_reckoning import Twists, chain, in_order_of_time, integrate, with_odometry_at
from sensors.measurements import ImuSample, WheelOdometry

SECOND = 1_000_000_000


def constant(speed: float, yaw_rate: float, num_records: int = 3) -> Twists:
    stamps = np.arange(num_records) * SECOND
    return Twists(stamps, np.full(num_records, speed), np.full(num_records, yaw_rate))


@pytest.mark.parametrize("yaw_rate", [0.0, 0.3, -1.1, 3.0])
def test_a_constant_twist_drives_an_exact_arc(yaw_rate: float) -> None:
    last = integrate(constant(2.0, yaw_rate), np.array([], dtype=np.int64))[-1].odom_T_base
    chord = 4.0 * np.sinc(yaw_rate / np.pi)
    assert (last.x, last.y) == pytest.approx(
        (chord * math.cos(yaw_rate), chord * math.sin(yaw_rate)), abs=1e-12
    )
    assert math.isclose(math.remainder(last.theta - 2.0 * yaw_rate, math.tau), 0.0, abs_tol=1e-12)


def test_a_scan_between_or_beyond_records_gets_its_own_sample() -> None:
    scans = np.array([-SECOND // 2, SECOND // 4, 3 * SECOND])
    samples = integrate(constant(2.0, 0.0), scans)
    along = {sample.stamp_ns: sample.odom_T_base.x for sample in samples}
    assert along == pytest.approx(
        {-SECOND // 2: 0.0, 0: 1.0, SECOND // 4: 1.5, SECOND: 3.0, 2 * SECOND: 5.0, 3 * SECOND: 7.0}
    )


def test_more_scans_change_nothing_about_the_path() -> None:
    rng = np.random.default_rng(0)
    stamps = np.arange(20) * SECOND
    twists = Twists(stamps, rng.uniform(0, 2, 20), rng.uniform(-1e-3, 1e-3, 20))
    sparse = integrate(twists, np.array([0]))[-1].odom_T_base
    dense = integrate(twists, np.arange(0, 19 * SECOND, SECOND // 7))[-1].odom_T_base
    assert np.allclose(sparse.as_array(), dense.as_array(), atol=1e-4)


def test_missing_odometry_is_interpolated_only_inside() -> None:
    samples = [WheelOdometry(0, Pose2()), WheelOdometry(2 * SECOND, Pose2(2.0, 0.0, 1.0))]
    filled = with_odometry_at(np.array([-SECOND, SECOND, 3 * SECOND]), samples)
    assert filled == [samples[0], WheelOdometry(SECOND, Pose2(1.0, 0.0, 0.5)), samples[1]]
    assert with_odometry_at(np.array([SECOND]), []) == []


def test_a_chain_of_motions_ends_where_their_product_does() -> None:
    motions = np.array([[1.0, 0.0, math.pi / 2], [2.0, 1.0, 0.0]])
    assert np.allclose(chain(motions)[-1], [0.0, 2.0, math.pi / 2])


def test_at_one_time_the_earlier_stream_comes_first() -> None:
    wheel, rate = WheelOdometry(5, Pose2()), ImuSample(5, 0.1)
    early = ImuSample(4, 0.2)
    assert in_order_of_time([wheel], [early, rate]) == (early, wheel, rate)
