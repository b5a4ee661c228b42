"""Simulated wheel odometry."""

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2, relative_poses
from semgraph.motion_model import odometry_covariance
from sensors.measurements import OdometryNoise, WheelOdometry
from sensors.simulation.noise import check_path


def simulate_wheels(
    stamps_ns: IntArray, world_T_bases: FloatArray, noise: OdometryNoise, rng: np.random.Generator
) -> list[WheelOdometry]:
    """What the wheels say at each stamp (n,) of a true path (n, 3), integrated from its start.

    Each step errs in its own frame with the covariance of the motion model.

    Raises:
        InputError: shapes disagree, no stamp, or stamps that do not increase.
    """
    check_path("wheels", stamps_ns, world_T_bases)
    motions = relative_poses(world_T_bases[:-1], world_T_bases[1:])
    variances = np.array(
        [np.diag(odometry_covariance(Pose2.from_array(motion), noise)) for motion in motions]
    ).reshape(-1, 3)
    steps = motions + np.sqrt(variances) * rng.standard_normal(motions.shape)
    odom_T_base = Pose2()
    samples = [WheelOdometry(int(stamps_ns[0]), odom_T_base)]
    for stamp_ns, step in zip(stamps_ns[1:].tolist(), steps, strict=True):
        odom_T_base = odom_T_base @ Pose2.from_array(step)
        samples.append(WheelOdometry(stamp_ns, odom_T_base))
    return samples
