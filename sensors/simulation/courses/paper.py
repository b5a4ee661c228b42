"""The paper's simulated test run from laser scans: a round track among trees (section 4)."""

from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from sensors.measurements import OdometryNoise
from sensors.simulation.courses.laser_scans import (
    BeamSpacing,
    ScansOnTheWay,
    laser_source,
    mounted_laser,
    standing_trees,
)
from sensors.simulation.courses.motion import true_path
from sensors.simulation.courses.track import Track, drive
from sensors.simulation.lms151 import Resolution
from sensors.simulation.world import StandSettings, Thing, kept_free, stand_of_trees
from sensors.truth import Source, Truth

_SEEN_FROM_M: Final = 15.0
_MARGIN_M: Final = 15.0
_KEPT_FREE_M: Final = 1.5


class PaperOptions(BaseModel):
    """A round track among trees, driven once and a little farther, seen by an LMS151.

    `overlap_s` is how long the start is seen again. The laser turns at 50 Hz, or at 25 Hz with
    beams 0.25 deg apart; every `scan_every`th scan is kept. `odometry` adds noisy wheels.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = Field(0, ge=0)
    track_radius_m: float = Field(20.0, ge=5.0, le=60.0)
    stems_per_ha: float = Field(400.0, ge=0.0, le=1500.0)
    lap_s: float = Field(45.0, ge=5.0, le=600.0)
    overlap_s: float = Field(5.0, ge=0.0, le=600.0)
    beam_spacing_deg: BeamSpacing = Resolution.HALF_DEGREE
    scan_every: int = Field(5, ge=1, le=100)
    odometry: bool = False


def read(name: str, options: PaperOptions) -> Source:
    """The course of these options with its truth; the same seed gives the same course."""
    rng = np.random.default_rng(options.seed)
    device = mounted_laser(options.beam_spacing_deg)
    track = Track.around(options.track_radius_m)
    way = drive(
        track,
        track.length_m / options.lap_s,
        options.lap_s + options.overlap_s,
        device.resolution.frequency_hz,
        rng=rng,
    )
    stand = StandSettings(
        stems_per_ha=options.stems_per_ha, radius_m=options.track_radius_m + _MARGIN_M
    )
    world = kept_free(stand_of_trees(rng, stand), way.poses[:, :2], _KEPT_FREE_M)
    ticks = np.arange(0, len(way.stamps_ns), options.scan_every)
    scans = ScansOnTheWay(device, way, ticks, lambda _: world, options.seed)
    in_sight = scans.in_sight(Thing.STEM, _SEEN_FROM_M)
    return laser_source(
        name,
        scans,
        rng,
        wheels=OdometryNoise() if options.odometry else None,
        detectors={"trees-2d": {}},
        truth=Truth(true_path(way), standing_trees(world), in_sight),
    )
