"""What the particle filter believes: one place and how surely, and where else it may be."""

from dataclasses import dataclass

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.geometry import UncertainPose2


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What the filter believes after a scan.

    Attributes:
        stamp_ns: of the scan.
        map_T_base: the likeliest place, with the covariance of the particles there.
        quality: the probability that the robot is within 1 m of it.
        is_one: whether all particles are at one place.
        num_particles: how many there are.
    """

    stamp_ns: int
    map_T_base: UncertainPose2
    quality: float
    is_one: bool
    num_particles: int


@dataclass(frozen=True, slots=True)
class Region:
    """Where the rest is: within a radius of a point by a share, else all over the map."""

    map_t_point: tuple[float, float] = (0.0, 0.0)
    radius_m: float = 1.0
    share: float = 0.0

    def log_densities(self, map_T_bases: FloatArray, area_m2: float) -> FloatArray:
        """(n,) of poses (n, 3), by m2 and rad."""
        offsets = map_T_bases[:, :2] - self.map_t_point
        is_inside = np.hypot(offsets[:, 0], offsets[:, 1]) <= self.radius_m
        within = self.share * is_inside / (np.pi * self.radius_m**2)
        densities: FloatArray = np.log((within + (1.0 - self.share) / area_m2) / (2.0 * np.pi))
        return densities
