"""The loop's by-products: what the inertial sensor said, and the trace of what was shown."""

import numpy as np

from semgraph import results
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.settings import Settings
from semgraph.trace import Trace
from sensors.measurements import (
    ImuSample,
    LaserScan,
    Measurement,
    OdometryNoise,
    Recording,
    ScannerGeometry,
    WheelOdometry,
)

GEOMETRY = ScannerGeometry(-1.0, 0.01, 0.1, 50.0)
THINGS = np.array([[6.0, 3.0], [9.0, -4.0], [13.0, 3.5], [16.0, -3.0]])


def seen(stamp_ns: int, x: float) -> Perceptions:
    base_t_x, base_t_y = (THINGS - (x, 0.0)).T
    sigmas = np.full(4, 0.03)
    return Perceptions.from_arrays(
        stamp_ns,
        Kind.TREE,
        np.hypot(base_t_x, base_t_y),
        np.arctan2(base_t_y, base_t_x),
        polar_covariances(sigmas, 0.1 * sigmas),
    )


def measurements() -> list[Measurement]:
    """Twenty moments: rates, wheels that start elsewhere, a blank scan and ready perceptions."""
    every: list[Measurement] = []
    for k in range(20):
        stamp_ns = 100_000_000 * k
        scan = LaserScan(stamp_ns, GEOMETRY, np.full(201, 20.0), np.zeros(201))
        every += [
            ImuSample(stamp_ns, 0.01 * k),
            WheelOdometry(stamp_ns, Pose2(5.0 + 0.1 * k, 1.0, 0.0)),
            seen(stamp_ns, 0.1 * k),
            scan,
        ]
    return every


def test_a_run_keeps_rates_and_what_each_moment_showed() -> None:
    recording = Recording(
        "twenty", measurements(), 40, OdometryNoise(), detectors={"reflectors": {}}
    )
    trace = Trace()
    settings = Settings()
    result = run(recording, settings, Perceiver(recording, settings), Silence(), {}, trace)
    np.testing.assert_array_equal(result.imu.rates, 0.01 * np.arange(20))
    assert result.imu.stamps_ns.tolist() == [100_000_000 * k for k in range(20)]
    assert [each.stamp_ns for each in trace.instants] == result.imu.stamps_ns.tolist()
    for k, instant in enumerate(trace.instants):
        assert instant.odom_T_base == Pose2(5.0 + 0.1 * k, 1.0, 0.0)
        assert [shot.sensor for shot in instant.shots] == ["laser"]
        assert len(instant.perceptions) == 4
    assert (trace.instants[-1].landmark_ids >= 0).all()
    assert not any("Rerun" in event for event in result.events)


def test_without_a_trace_the_run_is_the_same() -> None:
    recording = Recording(
        "twenty", measurements(), 40, OdometryNoise(), detectors={"reflectors": {}}
    )
    settings = Settings()
    outcomes = [
        run(recording, settings, Perceiver(recording, settings), Silence(), {}, trace)
        for trace in (None, Trace(capacity=5))
    ]
    for name in ("smoothed", "fast"):
        one, two = (getattr(outcome, name).map_T_bases for outcome in outcomes)
        np.testing.assert_array_equal(one, two)
    assert [event for event in outcomes[1].events if "Rerun" in event] == [
        "shown in Rerun: one of 4 moments of laser, 5 of 20"
    ]
    assert results.LOOP_CLOSED not in str(outcomes[1].events[-1])
