"""A loop between rocks on rough ground, seen by a depth camera."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import IntArray
from semgraph.landmarks import Kind
from sensors.measurements import DepthImage, OdometryNoise, Recording
from sensors.recorded import Recorded
from sensors.simulation.courses.free_way import Obstacles, free_way
from sensors.simulation.courses.motion import motion_samples, true_path
from sensors.simulation.courses.track import Drive, drive
from sensors.simulation.depth_camera import DepthCamera, Scene
from sensors.simulation.terrain import Terrain, TerrainSettings, rough_terrain
from sensors.truth import Source, TrueLandmarks, Truth

_CLOCK_HZ: Final = 50.0
_MARGIN_M: Final = 8.0
_HALF_WIDTH_M: Final = 0.4
_AVOIDED_M: Final = 0.25
_LARGE_M: Final = 0.3
_SEEN_M: Final = (1.5, 7.0)
_SEEN_BEARING: Final = np.radians(25.0)


class RocksOptions(BaseModel):
    """A loop between rocks (Golombek's sizes), driven once and a little farther.

    `rock_share` is of the ground that rocks cover, `deviation_m` how rough it is over a metre: 0.04
    is medium. `odometry` is that of noisy wheels.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = Field(0, ge=0)
    track_radius_m: float = Field(8.0, ge=4.0, le=20.0)
    rock_share: float = Field(0.03, ge=0.0, le=0.15)
    deviation_m: float = Field(0.04, ge=0.0, le=0.15)
    speed: float = Field(0.8, ge=0.1, le=3.0)
    overlap_s: float = Field(15.0, ge=0.0, le=600.0)
    image_rate_hz: float = Field(2.0, ge=0.5, le=10.0)
    odometry: bool = True


def read(name: str, options: RocksOptions) -> Source:
    """The course of these options with its truth; the same seed gives the same course.

    Raises:
        InputError: no way between the rocks, or Open3D does not load.
    """
    rng = np.random.default_rng(options.seed)
    settings = TerrainSettings(
        size_m=2.0 * (1.45 * options.track_radius_m + _MARGIN_M),
        rock_share=options.rock_share,
        deviation_m=options.deviation_m,
    )
    terrain = rough_terrain(settings, rng)
    avoided = terrain.diameters_m >= _AVOIDED_M
    obstacles = Obstacles(terrain.world_t_rocks[avoided], 0.5 * terrain.diameters_m[avoided])
    track = free_way(obstacles, options.track_radius_m, _HALF_WIDTH_M, rng)
    seconds = track.length_m / options.speed + options.overlap_s
    way = _resting(drive(track, options.speed, seconds, _CLOCK_HZ, rng=rng), terrain)
    ticks = np.arange(0, len(way.stamps_ns), round(_CLOCK_HZ / options.image_rate_hz))
    images = _ImagesOnTheWay(DepthCamera(), Scene(terrain), way, ticks, options.seed)
    wheels = OdometryNoise() if options.odometry else None
    recording = Recording(
        name=name,
        measurements=Recorded(motion_samples(way, wheels, rng), way.stamps_ns[ticks], images),
        num_scans=len(ticks),
        odometry_noise=wheels,
        detectors={"rocks": {}},
        map_T_start=way.pose(0),
    )
    landmarks = TrueLandmarks(
        terrain.world_t_rocks,
        np.full(len(terrain.diameters_m), Kind.ROCK),
        terrain.diameters_m,
    )
    return Source(recording, Truth(true_path(way), landmarks, images.in_sight()))


def _resting(way: Drive, terrain: Terrain) -> Drive:
    """The same drive, leaning as the ground does."""
    tilts = [terrain.rest(way.pose(tick))[1] for tick in range(len(way.stamps_ns))]
    leaning = np.array([(tilt.roll, tilt.pitch) for tilt in tilts])
    return Drive(way.stamps_ns, way.poses, way.speeds, way.yaw_rates, leaning)


@dataclass(frozen=True, slots=True, eq=False)
class _ImagesOnTheWay:
    """The k-th image is that of tick `ticks[k]`."""

    device: DepthCamera
    scene: Scene
    way: Drive
    ticks: IntArray
    seed: int

    def __call__(self, k: int) -> DepthImage:
        """The same for the same k."""
        tick = int(self.ticks[k])
        rng = np.random.default_rng([self.seed, k])
        stamp_ns = int(self.way.stamps_ns[tick])
        return self.device.look(self.scene, self.way.pose(tick), stamp_ns, rng)

    def in_sight(self) -> dict[int, IntArray]:
        """Of each image, by its stamp, the rows of large rocks near and well within its field."""
        stamps = self.way.stamps_ns[self.ticks].tolist()
        return {
            stamp_ns: self._in_sight(tick)
            for stamp_ns, tick in zip(stamps, self.ticks.tolist(), strict=True)
        }

    def _in_sight(self, tick: int) -> IntArray:
        terrain = self.scene.terrain
        x, y = self.way.pose(tick).inverse().transform(terrain.world_t_rocks).T
        ranges_m, bearings = np.hypot(x, y), np.arctan2(y, x)
        low_m, high_m = _SEEN_M
        near = (ranges_m >= low_m) & (ranges_m <= high_m) & (np.abs(bearings) <= _SEEN_BEARING)
        in_sight: IntArray = np.flatnonzero(near & (terrain.diameters_m >= _LARGE_M))
        return in_sight
