"""A loop through a car park with reflecting posts, seen by the intensities of a laser."""

from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.landmarks import Kind
from sensors.measurements import OdometryNoise
from sensors.simulation.courses.laser_scans import (
    BeamSpacing,
    ScansOnTheWay,
    laser_source,
    mounted_laser,
)
from sensors.simulation.courses.motion import true_path
from sensors.simulation.courses.track import Track, beside, drive
from sensors.simulation.lms151 import Resolution
from sensors.simulation.world import Thing, World
from sensors.truth import Source, TrueLandmarks, Truth

_SEEN_FROM_M: Final = 15.0
_POST_M: Final = 0.06
_BESIDE_M: Final = (2.5, 6.0)
_LAMP_DIAMETERS_M: Final = (0.1, 0.3)
_NUM_LAMPS: Final = 20
_WAVES: Final = np.array([[0.0, 0.0], [0.15, 0.5], [0.05, 1.0]])


class CarParkOptions(BaseModel):
    """A loop between reflecting posts and dull lamp posts, driven once and a little farther.

    Every `scan_every`th scan is kept. `odometry` is that of noisy wheels.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = Field(0, ge=0)
    track_radius_m: float = Field(18.0, ge=8.0, le=60.0)
    num_posts: int = Field(24, ge=0, le=200)
    speed: float = Field(2.0, ge=0.1, le=10.0)
    overlap_s: float = Field(8.0, ge=0.0, le=600.0)
    beam_spacing_deg: BeamSpacing = Resolution.HALF_DEGREE
    scan_every: int = Field(10, ge=1, le=100)
    odometry: bool = True


def read(name: str, options: CarParkOptions) -> Source:
    """The course of these options with its truth; the same seed gives the same course."""
    rng = np.random.default_rng(options.seed)
    device = mounted_laser(options.beam_spacing_deg)
    track = Track.around(options.track_radius_m, _WAVES)
    seconds = track.length_m / options.speed + options.overlap_s
    way = drive(track, options.speed, seconds, device.resolution.frequency_hz, rng=rng)
    posts = World.of(
        Thing.REFLECTOR,
        beside(track, options.num_posts, _BESIDE_M, rng)[0],
        np.full(options.num_posts, _POST_M),
        rng,
    )
    lamps = World.of(
        Thing.CLUTTER,
        beside(track, _NUM_LAMPS, (_BESIDE_M[1] + 1.0, 2.0 * _BESIDE_M[1]), rng)[0],
        rng.uniform(*_LAMP_DIAMETERS_M, _NUM_LAMPS),
        rng,
    )
    world = World.union([posts, lamps])
    ticks = np.arange(0, len(way.stamps_ns), options.scan_every)
    scans = ScansOnTheWay(device, way, ticks, lambda _: world, options.seed)
    landmarks = TrueLandmarks(
        posts.world_t_things, np.full(len(posts), Kind.MARKER), np.full(len(posts), np.nan)
    )
    return laser_source(
        name,
        scans,
        rng,
        wheels=OdometryNoise() if options.odometry else None,
        detectors={
            "reflectors": {"post_width_m": _POST_M, "centre_offset_m": np.pi / 8.0 * _POST_M}
        },
        truth=Truth(true_path(way), landmarks, scans.in_sight(Thing.REFLECTOR, _SEEN_FROM_M)),
    )
