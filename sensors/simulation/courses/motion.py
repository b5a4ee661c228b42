"""What IMU and wheels say of a drive, and what is true of it."""

import numpy as np

from sensors.dead_reckoning import in_order_of_time
from sensors.measurements import Measurement, OdometryNoise
from sensors.simulation.courses.track import Drive
from sensors.simulation.imu import SimulatedImu, simulate_imu
from sensors.simulation.wheels import simulate_wheels
from sensors.truth import TruePath


def motion_samples(
    way: Drive, noise: OdometryNoise | None, rng: np.random.Generator
) -> list[Measurement]:
    """What the IMU says at every tick, and the wheels where there is a noise of theirs."""
    wheels = simulate_wheels(way.stamps_ns, way.poses, noise, rng) if noise is not None else []
    imu = simulate_imu(way.stamps_ns, way.poses, SimulatedImu(), rng, tilts=way.tilts)
    return list(in_order_of_time(wheels, imu))


def true_path(way: Drive) -> TruePath:
    """Where base really is, at every tick."""
    return TruePath(way.stamps_ns, way.poses[:, :2], way.poses[:, 2])
