"""A winding way through a dense stand, uneven ground, a person who walks about, trees felled."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.errors import InputError
from sensors.measurements import OdometryNoise
from sensors.simulation.courses.free_way import Obstacles, free_way
from sensors.simulation.courses.laser_scans import (
    BeamSpacing,
    ScansOnTheWay,
    laser_source,
    mounted_laser,
    standing_trees,
)
from sensors.simulation.courses.motion import true_path
from sensors.simulation.courses.stem_maps import MarkUnit, stand_from_stem_map
from sensors.simulation.courses.track import Drive, drive
from sensors.simulation.lms151 import Resolution
from sensors.simulation.world import StandSettings, Thing, World, stand_of_trees
from sensors.truth import Source, Truth

_SEEN_FROM_M: Final = 15.0
_MARGIN_M: Final = 18.0
_HALF_WIDTH_M: Final = 0.5
_PERSON_SHARE: Final = 0.6
_PERSON_DIAMETERS_M: Final = (0.35, 0.5)
_PERSON_SPEED: Final = 1.2
_PERSON_HALF_WIDTH_M: Final = 0.35
_FELLED_NEAR_M: Final = 8.0
_FELLED_SIGHTINGS: Final = 20
_UNSEEN_S: Final = 3.0


class ForestOptions(BaseModel):
    """A winding way through a stand of trees, seen by an LMS151 one metre above the ground.

    `stem_map` is a CSV file x,y,mark of a real stand in m; `mark_unit` says in what its diameters
    are. `person` walks through the stand within the way. `felled` drives two laps, with a few
    trees missing in the second. `tilt_sigma_rad` is how far roll and pitch wander.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = Field(0, ge=0)
    stems_per_ha: float = Field(600.0, ge=50.0, le=1500.0)
    stem_map: Path | None = None
    mark_unit: MarkUnit = MarkUnit.CM
    track_radius_m: float = Field(14.0, ge=5.0, le=60.0)
    speed: float = Field(1.2, ge=0.1, le=5.0)
    overlap_s: float = Field(8.0, ge=0.0, le=600.0)
    beam_spacing_deg: BeamSpacing = Resolution.HALF_DEGREE
    scan_every: int = Field(10, ge=1, le=100)
    tilt_sigma_rad: float = Field(0.02, ge=0.0, le=0.2)
    odometry: bool = False
    person: bool = False
    felled: bool = False
    num_felled: int = Field(3, ge=1, le=20)


def read(name: str, options: ForestOptions) -> Source:
    """The course of these options with its truth, which holds what stands at the end.

    Raises:
        InputError: no way through the stand, no tree to fell, or what is wrong with the stem map.
    """
    rng = np.random.default_rng(options.seed)
    device = mounted_laser(options.beam_spacing_deg)
    stand = _stand(options, rng)
    obstacles = Obstacles(stand.world_t_things, stand.radii_m)
    track = free_way(obstacles, options.track_radius_m, _HALF_WIDTH_M, rng)
    lap_s = track.length_m / options.speed
    way = drive(
        track,
        options.speed,
        lap_s * (2.0 if options.felled else 1.0) + options.overlap_s,
        device.resolution.frequency_hz,
        tilt_sigma=options.tilt_sigma_rad,
        rng=rng,
    )
    ticks = np.arange(0, len(way.stamps_ns), options.scan_every)
    wood = _Wood(stand, stand, 0, None)
    if options.felled:
        lap = ScansOnTheWay(device, way, ticks, lambda _: stand, options.seed)
        wood = _felled(lap, lap_s, options.num_felled, rng)
    if options.person:
        wood = replace(wood, person=_walk(obstacles, options.track_radius_m, way, rng))
    scans = ScansOnTheWay(device, way, ticks, wood.at, options.seed)
    return laser_source(
        name,
        scans,
        rng,
        wheels=OdometryNoise() if options.odometry else None,
        detectors={"trees-2d": {}},
        truth=_truth(scans, wood),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Wood:
    """What stands at each tick; what is felled at `change_tick` comes last in `before`.

    `person` is the same one at each tick, or None.
    """

    before: World
    after: World
    change_tick: int
    person: World | None

    def at(self, tick: int) -> World:
        """All that a scan of this tick meets; a person comes last."""
        world = self.before if tick < self.change_tick else self.after
        if self.person is None:
            return world
        return World.union([world, self.person.select(np.array([tick]))])


def _stand(options: ForestOptions, rng: np.random.Generator) -> World:
    if options.stem_map is not None:
        return stand_from_stem_map(options.stem_map, options.mark_unit, rng)
    radius_m = options.track_radius_m + _MARGIN_M
    return stand_of_trees(rng, StandSettings(stems_per_ha=options.stems_per_ha, radius_m=radius_m))


def _felled(scans: ScansOnTheWay, lap_s: float, count: int, rng: np.random.Generator) -> _Wood:
    """A wood that loses some trees after a lap: often seen from near, but not at that moment.

    Raises:
        InputError: there are not as many.
    """
    stand, lap_ns = scans.world_at(0), int(lap_s * 1e9)
    sightings = np.zeros(len(stand), dtype=np.int64)
    for stamp_ns, rows in scans.in_sight(Thing.STEM, _FELLED_NEAR_M).items():
        sightings[rows] += stamp_ns < lap_ns
    for stamp_ns, rows in scans.in_sight(Thing.STEM, _SEEN_FROM_M).items():
        if abs(stamp_ns - lap_ns) < _UNSEEN_S * 1e9:
            sightings[rows] = 0
    candidates = np.flatnonzero(sightings >= _FELLED_SIGHTINGS)
    if len(candidates) < count:
        raise InputError(
            f"course: expected {count} trees to fell that were often seen, got {len(candidates)}; "
            "take fewer (num_felled), more stems, or more scans (scan_every)"
        )
    rows = np.sort(rng.choice(candidates, count, replace=False))
    after = stand.select(np.setdiff1d(np.arange(len(stand)), rows))
    change_tick = int(np.searchsorted(scans.way.stamps_ns, lap_ns))
    return _Wood(World.union([after, stand.select(rows)]), after, change_tick, None)


def _walk(
    obstacles: Obstacles, track_radius_m: float, way: Drive, rng: np.random.Generator
) -> World:
    """(ticks) the same person at each tick, walking against the vehicle within its way."""
    radius_m = _PERSON_SHARE * track_radius_m
    walked = free_way(obstacles, radius_m, _PERSON_HALF_WIDTH_M, rng)
    along_m = -_PERSON_SPEED * 1e-9 * way.stamps_ns
    places = walked.poses(along_m)[:, :2]
    diameters_m = np.full(len(places), rng.uniform(*_PERSON_DIAMETERS_M))
    return World.of(Thing.PERSON, places, diameters_m, rng)


def _truth(scans: ScansOnTheWay, wood: _Wood) -> Truth:
    standing = standing_trees(wood.after)
    in_sight = {
        stamp_ns: rows[rows < len(wood.after)]
        for stamp_ns, rows in scans.in_sight(Thing.STEM, _SEEN_FROM_M).items()
    }
    gone = wood.before.select(np.arange(len(wood.after), len(wood.before)))
    felled = standing_trees(gone) if len(gone) else None
    walked = wood.person.world_t_things if wood.person is not None else None
    return Truth(true_path(scans.way), standing, in_sight, felled, walked)
