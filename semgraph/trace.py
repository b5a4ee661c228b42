"""What a run showed, moment by moment, in little memory, for those who look at it afterwards."""

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray
from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2
from semgraph.landmarks import Perceptions
from semgraph.navigation_map import NavigationMap
from semgraph.thinning import Thinned
from sensors.measurements import CameraImage, DepthImage, LaserScan, Mounting, PointCloud, Raw, Tilt
from sensors.points import base_t_points

CAPACITY: Final = 300
_MAX_POINTS: Final = 20_000
_STRIDE: Final = 2
_MM: Final = 1e3
_NAMES: Final = {
    LaserScan: "laser",
    PointCloud: "lidar",
    DepthImage: "depth_camera",
    CameraImage: "camera",
}


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """An image: grey, or depths in mm along the optical axis with 0 for none.

    `focal_px` and `centre_px` (column, row) are of these pixels.
    """

    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    focal_px: float
    centre_px: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """What one sensor showed.

    Attributes:
        sensor: its name; each mounting has one of its own.
        base_R_sensor, base_t_sensor: (3, 3) and (3,), from level ground below base.
        base_t_points: (n, 3), of scans and clouds.
        picture: of cameras.
    """

    sensor: str
    base_R_sensor: FloatArray
    base_t_sensor: FloatArray
    base_t_points: NDArray[np.float32]
    picture: Picture | None


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """What all sensors showed at one time, and what the fast estimator made of it.

    Attributes:
        odom_T_base: by the wheels; None without them.
        perceptions: relative to base.
        landmark_ids: (n,) of the fast estimator's map; -1 where it was left open.
        base_t_matched: (n, 2) where those landmarks lay from the fast pose; NaN where open.
    """

    stamp_ns: int
    odom_T_base: Pose2 | None
    perceptions: Perceptions
    landmark_ids: IntArray
    base_t_matched: FloatArray
    shots: tuple[Shot, ...]


@final
class Trace:
    """Keeps at most `capacity` instants of each set of sensors, spread evenly over the run.

    An instant takes up to 0.25 MB a sensor. Sensors that take turns are thinned apart: of every
    second instant of all, one of two would not be seen.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._thinned: dict[tuple[str, ...], Thinned[Instant | None]] = {}
        self._sensors: dict[tuple[type[Raw], Mounting], str] = {}

    def add(
        self,
        measurements: tuple[Raw, ...],
        perceptions: Perceptions,
        odom_T_base: Pose2 | None,
        step: FastStep,
        fast_map: NavigationMap,
    ) -> None:
        """The next moment, after the fast estimator's step."""
        names = tuple(self._name(each) for each in measurements)
        thinned = self._thinned.setdefault(names, Thinned(self._capacity))
        if not thinned.takes_next():
            thinned.add(None)
            return
        instant = Instant(
            perceptions.stamp_ns,
            odom_T_base,
            perceptions,
            step.landmark_ids,
            _matched(step, fast_map),
            tuple(_shot(each, name) for each, name in zip(measurements, names, strict=True)),
        )
        thinned.add(instant)

    @property
    def instants(self) -> tuple[Instant, ...]:
        """Those kept, in the order of time."""
        kept = [each for thinned in self._thinned.values() for each in thinned.kept if each]
        return tuple(sorted(kept, key=lambda instant: instant.stamp_ns))

    @property
    def events(self) -> tuple[str, ...]:
        """What a reader has to know of what was left out."""
        return tuple(
            f"shown in Rerun: one of {thinned.stride} moments of {'+'.join(names) or 'no sensor'}, "
            f"{len(thinned.kept)} of {thinned.count}"
            for names, thinned in self._thinned.items()
            if thinned.stride > 1
        )

    def _name(self, measurement: Raw) -> str:
        """`laser`, and of one mounted elsewhere `laser_2`."""
        kind = type(measurement)
        key = (kind, _mounting(measurement))
        if key not in self._sensors:
            number = sum(each is kind for each, _ in self._sensors) + 1
            self._sensors[key] = _NAMES[kind] if number == 1 else f"{_NAMES[kind]}_{number}"
        return self._sensors[key]


def _matched(step: FastStep, fast_map: NavigationMap) -> FloatArray:
    places = np.full((len(step.landmark_ids), 2), np.nan)
    matched = np.flatnonzero(step.landmark_ids >= 0)
    if len(matched):
        map_t = [fast_map.landmark(k).map_t_landmark for k in step.landmark_ids[matched].tolist()]
        places[matched] = step.map_T_base.pose.inverse().transform(np.array(map_t))
    return places


def _shot(measurement: Raw, name: str) -> Shot:
    points: FloatArray = np.zeros((0, 3))
    if isinstance(measurement, LaserScan | PointCloud):
        points = base_t_points(measurement)
        points = points[:: max(1, math.ceil(len(points) / _MAX_POINTS))]
    R, t = _place(measurement)
    return Shot(name, R, t, points.astype(np.float32), _picture(measurement))


def _mounting(measurement: Raw) -> Mounting:
    match measurement:
        case LaserScan():
            x, y, theta = measurement.geometry.base_T_laser.as_array().tolist()
            return Mounting(x, y, yaw=theta)
        case PointCloud():
            return measurement.mounting
        case DepthImage() | CameraImage():
            return measurement.camera.mounting


def _place(measurement: Raw) -> tuple[FloatArray, FloatArray]:
    mounting = _mounting(measurement)
    tilt = Tilt() if isinstance(measurement, LaserScan) else measurement.tilt
    level_R_base = tilt.level_R_base()
    base_t_sensor = np.array([mounting.x_m, mounting.y_m, mounting.height_m])
    return level_R_base @ mounting.base_R_sensor(), level_R_base @ base_t_sensor


def _picture(measurement: Raw) -> Picture | None:
    """Every second pixel each way."""
    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    match measurement:
        case CameraImage():
            pixels = measurement.grey[::_STRIDE, ::_STRIDE].copy()
        case DepthImage():
            sampled = _MM * measurement.depths_m[::_STRIDE, ::_STRIDE]
            depths_mm = np.where(np.isfinite(sampled), np.rint(sampled), 0.0)
            pixels = np.clip(depths_mm, 0.0, np.iinfo(np.uint16).max).astype(np.uint16)
        case _:
            return None
    u, v = measurement.camera.centre_px
    return Picture(pixels, measurement.camera.focal_px / _STRIDE, (u / _STRIDE, v / _STRIDE))
