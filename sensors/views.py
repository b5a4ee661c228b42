"""How far a laser saw in each direction, so that not seeing a thing means something."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import Pose2, wrap_angle
from sensors.measurements import LaserScan

# So many beams must fall on a thing before its absence means something.
_LEAST_BEAMS: Final = 3
# What stands this much before a thing's front hides it.
_BEFORE_M: Final = 0.3
# What is met this much behind a thing's back is something else.
_BEHIND_M: Final = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """`clear_m` (m,): up to where each beam met nothing; beam k points to first + k increment.

    Angles in rad, relative to base_T_sensor, counter-clockwise.
    """

    base_T_sensor: Pose2
    first: float
    increment: float
    clear_m: FloatArray

    @classmethod
    def of_scan(cls, scan: LaserScan) -> "View":
        """A beam without return was clear up to the device's reach; one not valid says nothing."""
        geometry, ranges_m = scan.geometry, scan.ranges_m
        clear_m = np.clip(np.where(np.isnan(ranges_m), 0.0, ranges_m), 0.0, geometry.range_max_m)
        first, increment = geometry.angle_min, geometry.angle_increment
        if increment < 0.0:
            first, increment = first + (len(clear_m) - 1) * increment, -increment
            clear_m = clear_m[::-1]
        return cls(geometry.base_T_laser, first, increment, clear_m)

    @property
    def reach_m(self) -> float:
        """How far from base any beam met nothing."""
        offset_m = float(np.hypot(self.base_T_sensor.x, self.base_T_sensor.y))
        return offset_m + float(self.clear_m.max(initial=0.0))

    def sees(
        self, map_T_base: Pose2, map_t_things: FloatArray, diameters_m: FloatArray
    ) -> BoolArray:
        """(n,) whether a round thing at each place (n, 2) would show in front of all else.

        In the field of view with three beams or more, and nothing nearer on any of them or on the
        neighbours.
        """
        fronts_m, lower, upper = self._beams_on(map_T_base, map_t_things, diameters_m)
        lower, upper = lower - 1, upper + 1
        seen: BoolArray = (lower >= 0) & (upper < len(self.clear_m))
        seen &= upper - lower + 1 >= _LEAST_BEAMS + 2
        for k in np.flatnonzero(seen):
            seen[k] = self.clear_m[lower[k] : upper[k] + 1].min() >= fronts_m[k] - _BEFORE_M
        return seen

    def passes(
        self, map_T_base: Pose2, map_t_things: FloatArray, diameters_m: FloatArray
    ) -> BoolArray:
        """(n,) whether beams went right through the places (n, 2) of round things.

        Of those that `sees` looks at, all that point to the middle half of the thing met nothing
        until behind it.
        """
        fronts_m, lower, upper = self._beams_on(map_T_base, map_t_things, 0.5 * diameters_m)
        passed = self.sees(map_T_base, map_t_things, diameters_m)
        behind_m = fronts_m + 0.75 * diameters_m + _BEHIND_M
        for k in np.flatnonzero(passed):
            beams = self.clear_m[lower[k] : upper[k] + 1]
            passed[k] = len(beams) > 0 and beams.min() >= behind_m[k]
        return passed

    def _beams_on(
        self, map_T_base: Pose2, map_t_things: FloatArray, diameters_m: FloatArray
    ) -> tuple[FloatArray, IntArray, IntArray]:
        """(n,) how far the fronts of round things are, and the first and last beam on each."""
        sensor_t_things = (map_T_base @ self.base_T_sensor).inverse().transform(map_t_things)
        distances_m = np.hypot(sensor_t_things[:, 0], sensor_t_things[:, 1])
        halves = np.arcsin(np.clip(0.5 * diameters_m / np.maximum(distances_m, 1e-9), 0.0, 1.0))
        last = len(self.clear_m) - 1
        middle = self.first + 0.5 * last * self.increment
        from_middle = wrap_angle(np.arctan2(sensor_t_things[:, 1], sensor_t_things[:, 0]) - middle)
        beams = 0.5 * last + from_middle / self.increment
        lower = np.ceil(beams - halves / self.increment).astype(np.int64)
        upper = np.floor(beams + halves / self.increment).astype(np.int64)
        return distances_m - 0.5 * diameters_m, lower, upper
