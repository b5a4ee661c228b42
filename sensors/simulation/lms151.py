"""The simulated SICK LMS151.

Its beam is a wedge of light, wider than the beams are apart. Of all that a wedge lights up the
device reports the first echo that is strong enough: the average range over the lit part, mixed with
what stands close behind it.
"""

import math
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2, wrap_angle
from sensors.measurements import LaserScan, ScannerGeometry, Tilt
from sensors.simulation.ray_casting import Arcs, mean_ranges, ragged_ranges, visible_arcs
from sensors.simulation.world import World

NOTHING, GROUND = -1, -2
_SATURATED = 254.0
_INTENSITY_OF_WHITE = 160.0


class Resolution(Enum):
    """Beam spacing in degrees; the finer one turns at half the speed."""

    QUARTER_DEGREE = 0.25
    HALF_DEGREE = 0.5

    @property
    def num_beams(self) -> int:
        """Beams in the field of 270 deg."""
        return round(270.0 / self.value) + 1

    @property
    def frequency_hz(self) -> float:
        """Scans a second."""
        return 100.0 * self.value


@dataclass(frozen=True, slots=True)
class Motion:
    """How the laser moves during a scan, in its own frame: m/s, rad/s."""

    forward: float = 0.0
    left: float = 0.0
    yaw_rate: float = 0.0


STANDING = Motion()
LEVEL = Tilt()


@dataclass(frozen=True, slots=True)
class Lms151:
    """The device; defaults after its manual.

    A return needs a signal (reflectivity times lit share of the footprint) above `min_signal` and
    above 0.1 (r / range_at_ten_percent_m)^2: a target of 10 % that fills the beam is seen that far.
    `no_return_m` is what a beam says that nothing answers: the device itself sends 0.0.
    """

    resolution: Resolution = Resolution.HALF_DEGREE
    base_T_laser: Pose2 = field(default_factory=Pose2)
    range_min_m: float = 0.1
    range_max_m: float = 50.0
    range_sigma_m: float = 0.012
    range_bias_m: float = 0.0
    beam_divergence: float = 0.015
    beam_exit_m: float = 0.008
    echo_separation_m: float = 0.3
    min_signal: float = 0.02
    range_at_ten_percent_m: float = 18.0
    dropout: float = 0.001
    no_return_m: float = math.inf
    height_m: float = 1.0
    ground_reflectivity: float = 0.3
    ground_roughness: float = 0.03

    def __post_init__(self) -> None:
        if not (self.beam_exit_m > 0.0 and self.beam_divergence >= 0.0 and self.height_m > 0.0):
            raise InputError("LMS151: expected a beam with a width and a height above 0")

    @property
    def geometry(self) -> ScannerGeometry:
        """Where the beams point."""
        return ScannerGeometry(
            -0.75 * math.pi,
            math.radians(self.resolution.value),
            self.range_min_m,
            self.range_max_m,
            self.base_T_laser,
        )

    def beam_angles(self) -> FloatArray:
        """(m,) rad, -135 to 135 deg."""
        return np.linspace(-0.75 * math.pi, 0.75 * math.pi, self.resolution.num_beams)

    def half_widths(self, ranges_m: FloatArray) -> FloatArray:
        """Half the angle that the footprint covers at a range."""
        return 0.5 * (self.beam_divergence + self.beam_exit_m / ranges_m)

    def scan(
        self,
        world: World,
        world_T_laser: Pose2,
        rng: np.random.Generator,
        *,
        stamp_ns: int = 0,
        motion: Motion = STANDING,
        tilt: Tilt = LEVEL,
    ) -> LaserScan:
        """One scan; `stamp_ns` and `world_T_laser` are those of its middle beam."""
        echoes = self.echoes(world, world_T_laser, rng, motion=motion, tilt=tilt)
        m = self.resolution.num_beams
        ranges_m = echoes.ranges_m + rng.normal(self.range_bias_m, self.range_sigma_m, m)
        ranges_m[rng.random(m) < self.dropout] = np.inf
        ranges_m[ranges_m > self.range_max_m] = np.inf
        ranges_m[ranges_m < self.range_min_m] = -np.inf
        intensities = np.minimum(_INTENSITY_OF_WHITE * echoes.signals, _SATURATED)
        intensities[~np.isfinite(ranges_m)] = 0.0
        ranges_m[np.isposinf(ranges_m)] = self.no_return_m
        return LaserScan(stamp_ns, self.geometry, ranges_m, np.rint(intensities, dtype=np.float64))

    def echoes(
        self,
        world: World,
        world_T_laser: Pose2,
        rng: np.random.Generator,
        *,
        motion: Motion = STANDING,
        tilt: Tilt = LEVEL,
    ) -> "Echoes":
        """The first strong echo of each beam, before noise, and what it came from."""
        rows, distances_m, bearings = self._apparent_places(world, world_T_laser, motion)
        if tilt != LEVEL:
            bearings = _bearings_in_beam_plane(bearings, tilt)
        radii_m = world.radii_m[rows]
        arcs = visible_arcs(distances_m, bearings, radii_m)
        lit = self._light_up(arcs, distances_m, bearings, radii_m)
        reflected = _Lit(lit.beams, lit.ranges_m, lit.shares, rows[lit.sources])
        if tilt != LEVEL:
            reflected = self._with_ground(reflected, tilt, rng)
        return self._first_echoes(reflected, world.reflectivities)

    def _apparent_places(
        self, world: World, world_T_laser: Pose2, motion: Motion
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Rows of the things in reach, their distances and bearings when the beam passes them."""
        laser_t_things = world_T_laser.inverse().transform(world.world_t_things)
        distances_m = np.hypot(laser_t_things[:, 0], laser_t_things[:, 1])
        fronts_m = distances_m - world.radii_m
        rows = np.flatnonzero((fronts_m > 1e-3) & (fronts_m < self.range_max_m))
        x, y = laser_t_things[rows].T
        bearings = np.arctan2(y, x)
        if motion == STANDING:
            return rows, distances_m[rows], bearings
        for _ in range(3):
            seconds = bearings / (2.0 * math.pi * self.resolution.frequency_hz)
            moved_x, moved_y = x - motion.forward * seconds, y - motion.left * seconds
            turned = np.arctan2(moved_y, moved_x) - motion.yaw_rate * seconds
            bearings = wrap_angle(turned)
        return rows, np.hypot(moved_x, moved_y), bearings

    def _light_up(
        self, arcs: Arcs, distances_m: FloatArray, bearings: FloatArray, radii_m: FloatArray
    ) -> "_Lit":
        """Each beam with each visible arc in its footprint."""
        halves = self.half_widths(distances_m - radii_m)[arcs.owners]
        geometry = self.geometry
        last = self.resolution.num_beams - 1
        lowest = (arcs.starts - halves - geometry.angle_min) / geometry.angle_increment
        highest = (arcs.ends + halves - geometry.angle_min) / geometry.angle_increment
        first = np.clip(np.ceil(lowest), 0, last + 1).astype(np.int64)
        counts = np.clip(np.floor(highest), -1, last).astype(np.int64) + 1 - first
        pieces, beams = ragged_ranges(first, np.maximum(counts, 0))
        angles = geometry.angle_min + beams * geometry.angle_increment
        starts = np.maximum(arcs.starts[pieces], angles - halves[pieces])
        ends = np.minimum(arcs.ends[pieces], angles + halves[pieces])
        owners = arcs.owners[pieces]
        ranges_m = mean_ranges(
            distances_m[owners], radii_m[owners], starts - bearings[owners], ends - bearings[owners]
        )
        shares = np.maximum((ends - starts) / (2.0 * halves[pieces]), 1e-12)
        return _Lit(beams, ranges_m, shares, owners)

    def _with_ground(self, lit: "_Lit", tilt: Tilt, rng: np.random.Generator) -> "_Lit":
        """Beams that dip meet flat, rough ground; what stands behind that point is hidden."""
        angles = self.beam_angles()
        beams = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
        dips = -tilt.level_R_base()[2] @ beams
        rough = 1.0 + self.ground_roughness * rng.normal(size=len(angles))
        ground_m = np.where(dips > 1e-6, self.height_m / np.maximum(dips, 1e-6) * rough, np.inf)
        # A tilted beam meets an upright trunk farther along than a level one.
        lit = replace(lit, ranges_m=lit.ranges_m / np.sqrt(1.0 - dips**2)[lit.beams])
        before = lit.ranges_m < ground_m[lit.beams]
        covered = np.bincount(lit.beams[before], lit.shares[before], len(angles))
        strikes = np.flatnonzero((ground_m < self.range_max_m) & (covered < 1.0))
        return _Lit(
            np.concatenate([lit.beams[before], strikes]),
            np.concatenate([lit.ranges_m[before], ground_m[strikes]]),
            np.concatenate([lit.shares[before], 1.0 - covered[strikes]]),
            np.concatenate([lit.sources[before], np.full(len(strikes), GROUND)]),
        )

    def _first_echoes(self, lit: "_Lit", reflectivities: FloatArray) -> "Echoes":
        """Of each beam the nearest group of surfaces that gives enough light back."""
        order = np.lexsort([lit.ranges_m, lit.beams])
        lit = _Lit(lit.beams[order], lit.ranges_m[order], lit.shares[order], lit.sources[order])
        signals = (
            lit.shares * np.append(reflectivities, [self.ground_reflectivity, 0.0])[lit.sources]
        )
        m = self.resolution.num_beams
        echoes = Echoes(np.full(m, np.inf), np.zeros(m), np.full(m, NOTHING))
        while len(lit.beams):
            is_first = np.diff(lit.beams, prepend=-1) > 0
            firsts = np.flatnonzero(is_first)
            groups = np.cumsum(is_first) - 1
            near = lit.ranges_m <= lit.ranges_m[firsts][groups] + self.echo_separation_m
            near_signals = np.where(near, signals, 0.0)
            total = np.add.reduceat(near_signals, firsts)
            ranges_m = np.add.reduceat(near_signals * lit.ranges_m, firsts) / total
            seen = total >= self._signal_needed(ranges_m)
            beams = lit.beams[firsts[seen]]
            echoes.ranges_m[beams] = ranges_m[seen]
            echoes.signals[beams] = total[seen]
            echoes.sources[beams] = lit.sources[firsts[seen]]
            rest = ~seen[groups] & ~near
            lit = _Lit(*(column[rest] for column in lit.columns()))
            signals = signals[rest]
        return echoes

    def _signal_needed(self, ranges_m: FloatArray) -> FloatArray:
        return np.asarray(
            np.maximum(self.min_signal, 0.1 * (ranges_m / self.range_at_ten_percent_m) ** 2)
        )


def _bearings_in_beam_plane(bearings: FloatArray, tilt: Tilt) -> FloatArray:
    """(n,) rad that the tilted laser's beam has where it passes over a level bearing."""
    level_R_laser = tilt.level_R_base()
    normal = level_R_laser[:, 2]
    c, s = np.cos(bearings), np.sin(bearings)
    above = np.stack([c, s, -(normal[0] * c + normal[1] * s) / normal[2]])
    ahead, left, _ = level_R_laser.T @ above
    return np.asarray(np.arctan2(left, ahead))


@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """Of each beam (m,): range, +inf for none; signal; row of the thing, `NOTHING` or `GROUND`."""

    ranges_m: FloatArray
    signals: FloatArray
    sources: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Lit:
    """Pairs (k,) of a beam and a surface in its footprint; share of the footprint in [0, 1]."""

    beams: IntArray
    ranges_m: FloatArray
    shares: FloatArray
    sources: IntArray

    def columns(self) -> tuple[IntArray, FloatArray, FloatArray, IntArray]:
        return self.beams, self.ranges_m, self.shares, self.sources
