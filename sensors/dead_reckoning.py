"""Integrates speed and yaw rate to wheel odometry, and puts measurements in the order of time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2
from sensors.measurements import Measurement, WheelOdometry


@dataclass(frozen=True, slots=True, eq=False)
class Twists:
    """Speeds (n,) m/s ahead and yaw rates (n,) rad/s at stamps (n,), increasing."""

    stamps_ns: IntArray
    speeds: FloatArray
    yaw_rates: FloatArray


def integrate(twists: Twists, scan_stamps_ns: IntArray) -> list[WheelOdometry]:
    """The odometry at every twist and at every scan, starting at the identity.

    Twists between records are interpolated; before the first and after the last they are held.
    Each step is an arc of constant curvature.
    """
    stamps_ns = np.union1d(twists.stamps_ns, scan_stamps_ns)
    since_start = (stamps_ns - stamps_ns[0]) * 1e-9
    record = (twists.stamps_ns - stamps_ns[0]) * 1e-9
    distances = _steps(since_start, np.interp(since_start, record, twists.speeds))
    turns = _steps(since_start, np.interp(since_start, record, twists.yaw_rates))
    thetas = np.concatenate([[0.0], np.cumsum(turns)])
    chords = distances * np.sinc(turns / (2.0 * np.pi))
    directions = thetas[:-1] + 0.5 * turns
    x = np.concatenate([[0.0], np.cumsum(chords * np.cos(directions))])
    y = np.concatenate([[0.0], np.cumsum(chords * np.sin(directions))])
    return odometry(stamps_ns, np.column_stack([x, y, thetas]))


def chain(a_T_b: FloatArray) -> FloatArray:
    """(n + 1, 3) poses that start at the identity and move by each of the motions (n, 3)."""
    poses = [Pose2()]
    for motion in a_T_b:
        poses.append(poses[-1] @ Pose2.from_array(motion))
    return np.array([pose.as_array() for pose in poses])


def odometry(stamps_ns: IntArray, odom_T_bases: FloatArray) -> list[WheelOdometry]:
    """Wheel odometry of stamps (n,) and poses (n, 3)."""
    return [
        WheelOdometry(stamp_ns, Pose2(x, y, theta))
        for stamp_ns, (x, y, theta) in zip(stamps_ns.tolist(), odom_T_bases.tolist(), strict=True)
    ]


def with_odometry_at(stamps_ns: IntArray, samples: Sequence[WheelOdometry]) -> list[WheelOdometry]:
    """The samples, and interpolated ones at the times between them that have none.

    Times before the first sample and after the last get none: that would be a guess.
    """
    if not samples:
        return []
    known = Trajectory(
        np.array([sample.stamp_ns for sample in samples]),
        np.array([sample.odom_T_base.as_array() for sample in samples]),
    )
    inside = (stamps_ns > known.stamps_ns[0]) & (stamps_ns < known.stamps_ns[-1])
    missing = np.setdiff1d(stamps_ns[inside], known.stamps_ns)
    between = odometry(missing, known.interpolate(missing))
    return sorted([*samples, *between], key=lambda sample: sample.stamp_ns)


def in_order_of_time(*streams: Sequence[Measurement]) -> tuple[Measurement, ...]:
    """All measurements by stamp; at the same stamp the earlier stream comes first."""
    return tuple(sorted((m for stream in streams for m in stream), key=lambda m: m.stamp_ns))


def _steps(at: FloatArray, rates: FloatArray) -> FloatArray:
    """What a rate, linear in between, adds up to from each time to the next."""
    return 0.5 * (rates[1:] + rates[:-1]) * np.diff(at)
