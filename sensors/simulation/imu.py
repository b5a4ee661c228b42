"""A simulated inertial measurement unit: yaw rate, roll and pitch."""

from dataclasses import dataclass
from math import radians

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray, frozen_floats
from semgraph.geometry import wrap_angle
from sensors.measurements import ImuSample, Tilt
from sensors.simulation.noise import check_domain, check_path, gauss_markov, random_walk

_MOVING_M_S, _MOVING_RAD_S = 0.05, 0.02


@dataclass(frozen=True, slots=True)
class SimulatedImu:
    """An attitude and heading reference of the class of the IG-500A; SI units, 1 sigma.

    Attributes:
        noise_density: white noise of the yaw rate, rad/s per sqrt(Hz).
        start_bias: of the yaw rate, when switched on.
        bias_walk: how the bias wanders, rad/s per sqrt(s).
        static_tilt: roll's and pitch's error while standing; it lasts a run.
        dynamic_tilt: their whole error while moving.
        tilt_correlation_s: how long what moving adds is remembered.
    """

    noise_density: float = radians(0.05)
    start_bias: float = radians(0.1)
    bias_walk: float = radians(0.003)
    static_tilt: float = radians(0.5)
    dynamic_tilt: float = radians(1.0)
    tilt_correlation_s: float = 2.0

    def __post_init__(self) -> None:
        check_domain("IMU", self, positive=("tilt_correlation_s",))


def simulate_imu(
    stamps_ns: IntArray,
    world_T_bases: FloatArray,
    imu: SimulatedImu,
    rng: np.random.Generator,
    *,
    tilts: FloatArray | None = None,
) -> list[ImuSample]:
    """What it measures at each stamp (n,) of a true path (n, 3).

    The yaw rate of a sample is the mean since the sample before; the first repeats the next one's.

    Args:
        stamps_ns: increasing.
        world_T_bases: x, y, theta.
        imu: the device.
        rng: all of its noise.
        tilts: (n, 2) true roll and pitch; level without.

    Raises:
        InputError: shapes disagree, no stamp, or stamps that do not increase.
    """
    check_path("IMU", stamps_ns, world_T_bases)
    n = len(stamps_ns)
    true_tilts = frozen_floats("tilts", np.zeros((n, 2)) if tilts is None else tilts, (n, 2))
    seconds = 1e-9 * (stamps_ns - stamps_ns[0])
    spans_s = np.diff(seconds)
    speeds, yaw_rates = np.zeros(n), np.zeros(n)
    yaw_rates[1:] = wrap_angle(np.diff(world_T_bases[:, 2])) / spans_s
    speeds[1:] = np.hypot(*np.diff(world_T_bases[:, :2], axis=0).T) / spans_s
    yaw_rates[0], speeds[0] = yaw_rates[min(1, n - 1)], speeds[min(1, n - 1)]

    bias = random_walk(seconds, imu.start_bias, imu.bias_walk, rng)
    white = imu.noise_density * rng.standard_normal(n)
    white /= np.sqrt(np.append(spans_s[:1], spans_s)) if n > 1 else 1.0
    moving = (speeds > _MOVING_M_S) | (np.abs(yaw_rates) > _MOVING_RAD_S)
    measured = yaw_rates + bias + white
    leaning = true_tilts + _tilt_errors(seconds, moving, imu, rng)
    return [
        ImuSample(stamp_ns, yaw_rate, Tilt(roll, pitch))
        for stamp_ns, yaw_rate, (roll, pitch) in zip(
            stamps_ns.tolist(), measured.tolist(), leaning.tolist(), strict=True
        )
    ]


def _tilt_errors(
    seconds: FloatArray, moving: BoolArray, imu: SimulatedImu, rng: np.random.Generator
) -> FloatArray:
    """(n, 2) of roll and pitch: what stays, and what moving adds to it."""
    added = np.sqrt(max(imu.dynamic_tilt**2 - imu.static_tilt**2, 0.0))
    wander = gauss_markov(seconds, float(added), imu.tilt_correlation_s, 2, rng)
    return imu.static_tilt * rng.standard_normal(2) + moving[:, None] * wander
