"""A simulated spinning laser with many rings.

Each beam is a small fan of rays: of what they hit, the nearest group that catches enough of the
beam is the echo, at its mean range.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2, wrap_angle
from sensors.measurements import Mounting, PointCloud, Tilt
from sensors.simulation.ray_casting import ragged_ranges
from sensors.simulation.world_3d import World3d

NOTHING, GROUND = -1, -2
_LEVEL: Final = Tilt()


@dataclass(frozen=True, slots=True)
class Lidar3d:
    """The device: `num_rings` evenly from `elevation_min` to `elevation_max` rad.

    Attributes:
        num_columns: beams of a ring in a turn.
        stagger: share of a column by which the highest ring fires after the lowest.
        beam_divergence: width of the beam, rad.
        num_rays: of a beam, side by side.
        min_share: of its rays must be hit for an echo.
        ground_roughness_m: standard deviation of the ground's height.
    """

    num_rings: int = 64
    elevation_min: float = math.radians(-16.6)
    elevation_max: float = math.radians(16.6)
    num_columns: int = 1024
    stagger: float = 0.0
    mounting: Mounting = field(default_factory=lambda: Mounting(height_m=1.2))
    range_min_m: float = 0.5
    range_max_m: float = 60.0
    range_sigma_m: float = 0.015
    beam_divergence: float = 0.003
    num_rays: int = 5
    min_share: float = 0.3
    echo_separation_m: float = 0.3
    dropout: float = 0.002
    ground_roughness_m: float = 0.03

    def __post_init__(self) -> None:
        if not (
            self.num_rings >= 1
            and self.num_columns >= 8
            and self.num_rays >= 1
            and -1.5 < self.elevation_min <= self.elevation_max < 1.5
            and 0.0 < self.range_min_m < self.range_max_m < math.inf
        ):
            raise InputError(
                "3D laser: expected a ring, 8 columns and a ray or more, elevations within 1.5 rad "
                f"in their order, and 0 < range_min_m < range_max_m, got {self}"
            )

    @property
    def elevations(self) -> FloatArray:
        """(num_rings,) rad, from below."""
        return np.linspace(self.elevation_min, self.elevation_max, self.num_rings)

    @property
    def increment(self) -> float:
        """Rad between two columns."""
        return 2.0 * math.pi / self.num_columns

    def azimuths(self) -> FloatArray:
        """(num_rings, num_columns) rad in [-pi, pi] of the beams' middles."""
        lags = self.stagger * np.linspace(0.0, 1.0, self.num_rings)
        columns = np.arange(self.num_columns) + lags[:, None]
        return -math.pi + (columns + 0.5) * self.increment

    def scan(
        self,
        world: World3d,
        world_T_base: Pose2,
        rng: np.random.Generator,
        *,
        stamp_ns: int = 0,
        tilt: Tilt = _LEVEL,
    ) -> PointCloud:
        """One turn while standing; the tilt of base goes into the cloud as an IMU tells it."""
        ranges_m, _ = self.echoes(world, world_T_base, rng, tilt=tilt)
        ranges_m = ranges_m + self.range_sigma_m * rng.standard_normal(ranges_m.shape)
        seen = (ranges_m > self.range_min_m) & (ranges_m < self.range_max_m)
        seen &= rng.random(seen.shape) >= self.dropout
        rings, columns = np.nonzero(seen)
        directions = _directions(self.azimuths()[rings, columns], self.elevations[rings])
        points = directions * ranges_m[seen][:, None]
        return PointCloud(stamp_ns, self.mounting, points, rings, tilt)

    def echoes(
        self,
        world: World3d,
        world_T_base: Pose2,
        rng: np.random.Generator,
        *,
        tilt: Tilt = _LEVEL,
    ) -> tuple[FloatArray, IntArray]:
        """Ranges and sources (num_rings, num_columns): +inf, and the row of the thing or a code."""
        world_R_sensor, world_t_sensor = _placed(world_T_base, tilt, self.mounting)
        ray_azimuths = self._ray_azimuths()
        directions = _directions(ray_azimuths, self.elevations[:, None]) @ world_R_sensor.T
        ranges_m = self._ground_ranges(directions, world_t_sensor[2], rng)
        sources = np.where(np.isfinite(ranges_m), GROUND, NOTHING)
        owners, columns = self._pairs(world, world_R_sensor, world_t_sensor)
        rays = directions[:, columns]
        hits_m = _cylinder_ranges(world, owners, rays, world_t_sensor)
        # Written far to near: the nearest is written last.
        ring, pair = np.nonzero(hits_m < ranges_m[:, columns])
        order = np.argsort(-hits_m[ring, pair])
        ring, pair = ring[order], pair[order]
        ranges_m[ring, columns[pair]] = hits_m[ring, pair]
        sources[ring, columns[pair]] = owners[pair]
        shape = (self.num_rings, self.num_columns, self.num_rays)
        return self._first_echoes(ranges_m.reshape(shape), sources.reshape(shape))

    def _ray_azimuths(self) -> FloatArray:
        """(num_rings, num_columns * num_rays) rad."""
        half = 0.5 * self.beam_divergence
        fan = half * (2.0 * (np.arange(self.num_rays) + 0.5) / self.num_rays - 1.0)
        rays = self.azimuths()[:, :, None] + fan
        return rays.reshape(self.num_rings, -1)

    def _ground_ranges(
        self, directions: FloatArray, height_m: float, rng: np.random.Generator
    ) -> FloatArray:
        """(num_rings, num_columns * num_rays) m; one height of the ground for each beam."""
        rough_m = self.ground_roughness_m * rng.standard_normal((self.num_rings, self.num_columns))
        heights_m = height_m - np.repeat(rough_m, self.num_rays, axis=1)
        down = -directions[:, :, 2]
        ranges_m = heights_m / np.maximum(down, 1e-9)
        return np.where((down > 1e-6) & (ranges_m < self.range_max_m), ranges_m, np.inf)

    def _pairs(
        self, world: World3d, world_R_sensor: FloatArray, world_t_sensor: FloatArray
    ) -> tuple[IntArray, IntArray]:
        """Rows of things and columns of rays that may meet, by azimuth."""
        ends = []
        for heights_m in (world.bottoms_m, world.tops_m):
            level = world.world_t_feet + world.leans * heights_m[:, None]
            points = np.column_stack([level, heights_m]) - world_t_sensor
            ends.append(points @ world_R_sensor)
        azimuths = np.stack([np.arctan2(end[:, 1], end[:, 0]) for end in ends])
        nearest_m = np.maximum(_segment_distances(ends[0][:, :2], ends[1][:, :2]), 1e-9)
        half = np.arcsin(np.minimum(1.1 * world.radii_m / nearest_m, 1.0))
        half += self.increment * (1.0 + self.stagger)
        turn = wrap_angle(azimuths[1] - azimuths[0])
        first = azimuths[0] + np.minimum(turn, 0.0) - half
        last = azimuths[0] + np.maximum(turn, 0.0) + half
        # What surrounds the sensor may be met by every ray, and by none twice.
        last = np.where(nearest_m <= 1.1 * world.radii_m, first + 2.0 * math.pi, last)
        per_ray = self.increment / self.num_rays
        low = np.floor((first + math.pi) / per_ray).astype(np.int64)
        high = np.ceil((last + math.pi) / per_ray).astype(np.int64)
        num_rays = self.num_columns * self.num_rays
        owners, columns = ragged_ranges(low, np.minimum(high - low + 1, num_rays))
        return owners, columns % num_rays

    def _first_echoes(self, ranges_m: FloatArray, sources: IntArray) -> tuple[FloatArray, IntArray]:
        """Of each beam the nearest group of its rays (last axis) that is a large enough share."""
        order = np.argsort(ranges_m, axis=2, kind="stable")
        ranges_m = np.take_along_axis(ranges_m, order, axis=2)
        sources = np.take_along_axis(sources, order, axis=2)
        found_m = np.full(ranges_m.shape[:2], np.inf)
        found = np.full(ranges_m.shape[:2], NOTHING)
        open_: BoolArray = np.ones(ranges_m.shape[:2], dtype=bool)
        for k in range(self.num_rays):
            front_m = np.where(np.isfinite(ranges_m[:, :, k]), ranges_m[:, :, k], -np.inf)
            group = ranges_m <= front_m[:, :, None] + self.echo_separation_m
            group[:, :, :k] = False
            num = group.sum(axis=2)
            enough = open_ & (num >= self.min_share * self.num_rays) & (num > 0)
            total_m = np.where(group, ranges_m, 0.0).sum(axis=2)
            found_m[enough] = total_m[enough] / num[enough]
            found[enough] = sources[:, :, k][enough]
            open_ &= ~enough
        return found_m, found


def _segment_distances(starts: FloatArray, ends: FloatArray) -> FloatArray:
    """(n,) from the origin to segments in the plane."""
    along = ends - starts
    lengths_sq = np.maximum((along**2).sum(axis=1), 1e-12)
    shares = np.clip(-(starts * along).sum(axis=1) / lengths_sq, 0.0, 1.0)
    distances: FloatArray = np.linalg.norm(starts + shares[:, None] * along, axis=1)
    return distances


def _placed(world_T_base: Pose2, tilt: Tilt, mounting: Mounting) -> tuple[FloatArray, FloatArray]:
    """world_R_sensor (3, 3) and world_t_sensor (3,); base leans about its origin on the ground."""
    c, s = math.cos(world_T_base.theta), math.sin(world_T_base.theta)
    world_R_base = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ tilt.level_R_base()
    base_t_sensor = np.array([mounting.x_m, mounting.y_m, mounting.height_m])
    world_t_base = np.array([world_T_base.x, world_T_base.y, 0.0])
    return world_R_base @ mounting.base_R_sensor(), world_t_base + world_R_base @ base_t_sensor


def _directions(azimuths: FloatArray, elevations: FloatArray) -> FloatArray:
    """(..., 3) unit vectors in the frame of the sensor."""
    level = np.cos(elevations)
    height = np.broadcast_to(np.sin(elevations), azimuths.shape)
    return np.stack([level * np.cos(azimuths), level * np.sin(azimuths), height], axis=-1)


def _cylinder_ranges(
    world: World3d, owners: IntArray, rays: FloatArray, world_t_sensor: FloatArray
) -> FloatArray:
    """(num_rings, k) m to the cylinders `owners` (k,) along rays (num_rings, k, 3), +inf if missed.

    With q and w the ray's slope and start relative to the axis, at its own height, the surface is
    |w + t q| = radius: a quadratic in t.
    """
    leans = world.leans[owners]
    w = world_t_sensor[:2] - world.world_t_feet[owners] - leans * world_t_sensor[2]
    qx = rays[:, :, 0] - leans[:, 0] * rays[:, :, 2]
    qy = rays[:, :, 1] - leans[:, 1] * rays[:, :, 2]
    a = qx**2 + qy**2
    b = qx * w[:, 0] + qy * w[:, 1]
    c = (w**2).sum(axis=1) - world.radii_m[owners] ** 2
    inside = b**2 - a * c
    ranges_m = (-b - np.sqrt(np.maximum(inside, 0.0))) / np.maximum(a, 1e-12)
    heights_m = world_t_sensor[2] + ranges_m * rays[:, :, 2]
    met = (
        (inside > 0.0)
        & (ranges_m > 1e-3)
        & (heights_m > world.bottoms_m[owners])
        & (heights_m < world.tops_m[owners])
    )
    return np.where(met, ranges_m, np.inf)
