"""Laser scans on the way, the trees clearly in sight in them, and the filters that they need."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from pydantic import BeforeValidator

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind
from sensors.measurements import LaserScan, OdometryNoise, Recording
from sensors.recorded import Recorded
from sensors.simulation.courses.motion import motion_samples
from sensors.simulation.courses.track import Drive
from sensors.simulation.lms151 import Lms151, Motion, Resolution
from sensors.simulation.ray_casting import visible_arcs
from sensors.simulation.world import Thing, World
from sensors.truth import Source, TrueLandmarks, Truth

_LASER_AHEAD_M: Final = 0.3
_FIELD_OF_A_TURN: Final = 270.0 / 360.0
_LEAST_BEAMS: Final = 3
_LEAST_SHARE: Final = 0.6


def _number(value: object) -> object:
    """A number that a command line has as text; the rest as it is."""
    texts = {f"{resolution.value:g}": resolution.value for resolution in Resolution}
    return texts.get(value, value) if isinstance(value, str) else value


BeamSpacing = Annotated[Resolution, BeforeValidator(_number)]
"""An option in degrees: 0.5 at 50 Hz, 0.25 at 25 Hz."""


def mounted_laser(resolution: Resolution, height_m: float = 1.0) -> Lms151:
    """An LMS151 at the front of the vehicle, level; no return is 0.0, as the device says."""
    return Lms151(
        resolution,
        base_T_laser=Pose2(_LASER_AHEAD_M, 0.0, 0.0),
        height_m=height_m,
        no_return_m=0.0,
    )


def scan_filters(device: Lms151, *, leans: bool) -> list[dict[str, object]]:
    """Settings of the filters that its scans need while it moves, and where it leans."""
    sweep_s = _FIELD_OF_A_TURN / device.resolution.frequency_hz
    levelled = [{"name": "level", "height_m": device.height_m}] if leans else []
    return [
        {"name": "invalid"},
        *levelled,
        {"name": "deskew", "sweep_s": sweep_s, "stamp_position": 0.5},
    ]


@dataclass(frozen=True, slots=True, eq=False)
class ScansOnTheWay:
    """The k-th scan is that of tick `ticks[k]`, in the world of its time."""

    device: Lms151
    way: Drive
    ticks: IntArray
    world_at: Callable[[int], World]
    seed: int

    def __call__(self, k: int) -> LaserScan:
        """The same for the same k."""
        tick = int(self.ticks[k])
        way, device = self.way, self.device
        tilt = way.tilt(tick)
        ahead_m, left_m = self._base_t_laser(tick)
        yaw_rate = float(way.yaw_rates[tick])
        forward = float(way.speeds[tick]) - yaw_rate * left_m
        return device.scan(
            self.world_at(tick),
            way.pose(tick) @ Pose2(ahead_m, left_m, 0.0),
            np.random.default_rng([self.seed, k]),
            stamp_ns=int(way.stamps_ns[tick]),
            motion=Motion(forward, yaw_rate * ahead_m, yaw_rate),
            tilt=tilt,
        )

    def in_sight(self, thing: Thing, reach_m: float) -> dict[int, IntArray]:
        """Of each scan, by its stamp, the rows of such things that no detector may overlook.

        No farther than `reach_m`, wide enough for three beams, and at most 40 % hidden.
        """
        stamps = self.way.stamps_ns[self.ticks].tolist()
        return {
            stamp_ns: self._in_sight(thing, tick, reach_m)
            for stamp_ns, tick in zip(stamps, self.ticks.tolist(), strict=True)
        }

    def _base_t_laser(self, tick: int) -> tuple[float, float]:
        """Leaning moves the laser aside by its height."""
        mount = self.device.base_T_laser
        leant = self.way.tilt(tick).level_R_base() @ (mount.x, mount.y, self.device.height_m)
        return float(leant[0]), float(leant[1])

    def _in_sight(self, thing: Thing, tick: int, reach_m: float) -> IntArray:
        world = self.world_at(tick)
        world_T_laser = self.way.pose(tick) @ Pose2(*self._base_t_laser(tick), 0.0)
        laser_t_things = world_T_laser.inverse().transform(world.world_t_things)
        distances_m = np.hypot(*laser_t_things.T)
        rows = np.flatnonzero((distances_m < reach_m) & (distances_m > world.radii_m))
        shares = _visible_shares(laser_t_things[rows], distances_m[rows], world.radii_m[rows])
        geometry = self.device.geometry
        bearings = np.arctan2(*laser_t_things[rows].T[::-1])
        spots = 2.0 * self.device.half_widths(distances_m[rows])
        beams = (2.0 * world.radii_m[rows] / distances_m[rows] + spots) / geometry.angle_increment
        clear = (shares >= _LEAST_SHARE) & (shares * beams >= _LEAST_BEAMS)
        clear &= np.abs(bearings) < -geometry.angle_min
        in_sight: IntArray = rows[clear & (world.things[rows] == thing)]
        return in_sight


def _visible_shares(
    laser_t_things: FloatArray, distances_m: FloatArray, radii_m: FloatArray
) -> FloatArray:
    """(n,) of each thing's width that nothing nearer hides."""
    bearings = np.arctan2(laser_t_things[:, 1], laser_t_things[:, 0])
    arcs = visible_arcs(distances_m, bearings, radii_m)
    widths = np.bincount(arcs.owners, arcs.ends - arcs.starts, len(radii_m))
    return np.asarray(widths / (2.0 * np.arcsin(radii_m / distances_m)))


def laser_source(
    name: str,
    scans: ScansOnTheWay,
    rng: np.random.Generator,
    *,
    wheels: OdometryNoise | None,
    detectors: dict[str, dict[str, float]],
    truth: Truth,
) -> Source:
    """What the vehicle of these scans records, with its IMU and perhaps its wheels."""
    way = scans.way
    recording = Recording(
        name=name,
        measurements=Recorded(motion_samples(way, wheels, rng), way.stamps_ns[scans.ticks], scans),
        num_scans=len(scans.ticks),
        odometry_noise=wheels,
        detectors=detectors,
        filters=scan_filters(scans.device, leans=bool(way.tilts.any())),
        map_T_start=way.pose(0),
    )
    return Source(recording, truth)


def standing_trees(world: World) -> TrueLandmarks:
    """The stems and saplings of a world in which they come first: row k is thing k."""
    rows = np.flatnonzero((world.things == Thing.STEM) | (world.things == Thing.SAPLING))
    return TrueLandmarks(
        world.world_t_things[rows],
        np.full(len(rows), Kind.TREE, dtype=np.int64),
        2.0 * world.radii_m[rows],
    )
