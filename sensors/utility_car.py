"""The utility car of the ACFR that drove the car park and Victoria Park."""

from pathlib import Path

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.dead_reckoning import Twists
from sensors.measurements import OdometryNoise

WHEEL_BASE_M = 2.83
ENCODER_OFFSET_M = 0.76
BASE_T_LASER = Pose2(3.78, 0.5, 0.0)
"""The laser, seen from the middle of the rear axle (base)."""

ODOMETRY_NOISE = OdometryNoise(
    along_per_sqrt_m=0.05,
    across_per_sqrt_m=0.02,
    heading_per_sqrt_m=0.01,
    heading_per_sqrt_rad=0.05,
)
"""From the turn between neighbouring chords of 10 to 40 m, driven against GPS.

A least-squares fit of the squared differences gives 0.011 rad per sqrt(m) and 0.049 per sqrt(rad)
in the car park (647 pairs), and 0.03 m per sqrt(m) for the lengths of the chords. The GPS of
Victoria Park, which itself jumps, gives 0.02, 0.11 and 0.16: upper bounds. Most of it is no noise:
at full lock to the left the formula below loses 4 to 5 % of speed and turn, which a random walk can
only cover. Across is stated: chords cannot tell it from heading.
"""


def twists(file: Path, stamps_ns: IntArray, speeds: FloatArray, steering: FloatArray) -> Twists:
    """How the middle of the rear axle moves.

    Args:
        file: where the drive data come from, for the error.
        stamps_ns: (n,).
        speeds: (n,) m/s of the left rear wheel, where the encoder sits.
        steering: (n,) rad.

    Raises:
        InputError: no or unequal numbers of records, or angles or speeds that no car has.
    Source: Guivant and Nebot 2001, eq. 20 and 21.
    """
    if not 0 < len(stamps_ns) == len(speeds) == len(steering):
        raise InputError(f"{file}: expected as many times as speeds and steering angles")
    bad = np.flatnonzero((np.abs(steering) > 1.2) | (np.abs(speeds) > 100.0))
    if len(bad):
        raise InputError(
            f"{file}: expected steering within 1.2 rad and speeds within 100 m/s, "
            f"record {bad[0] + 1} has {steering[bad[0]]:g} and {speeds[bad[0]]:g}"
        )
    speed = speeds / (1.0 - np.tan(steering) * ENCODER_OFFSET_M / WHEEL_BASE_M)
    return Twists(stamps_ns, speed, speed * np.tan(steering) / WHEEL_BASE_M)
