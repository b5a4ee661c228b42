"""A loop between optical markers, seen by a camera."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import IntArray
from semgraph.landmarks import Kind
from sensors.measurements import CameraGeometry, CameraImage, Mounting, OdometryNoise, Recording
from sensors.recorded import Recorded
from sensors.simulation.courses.motion import motion_samples, true_path
from sensors.simulation.courses.track import Drive, Track, beside, drive
from sensors.simulation.marker_camera import NUM_IDS, MarkerCamera, OpticalMarkers
from sensors.truth import Source, TrueLandmarks, Truth

_CLOCK_HZ: Final = 50.0
_CAMERA: Final = CameraGeometry(
    640, 480, 457.0, (319.5, 239.5), Mounting(x_m=0.3, height_m=1.2, pitch=0.05)
)
_EDGE_M: Final = 0.3
_BESIDE_M: Final = (0.8, 2.5)
_HEIGHTS_M: Final = (0.8, 1.6)
_TURNS: Final = (0.3, 0.9)
_TILT_SIGMA: Final = 0.004
_SEEN_PX: Final = 25.0
_SEEN_TURN: Final = math.radians(50.0)


class MarkersOptions(BaseModel):
    """A round loop between AprilTags of 0.3 m, driven once and a little farther.

    The camera looks ahead, as often as `image_rate_hz`. `odometry` is that of noisy wheels.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = Field(0, ge=0)
    track_radius_m: float = Field(10.0, ge=4.0, le=40.0)
    num_markers: int = Field(30, ge=0, le=200)
    speed: float = Field(1.0, ge=0.1, le=5.0)
    overlap_s: float = Field(10.0, ge=0.0, le=600.0)
    image_rate_hz: float = Field(5.0, ge=0.5, le=25.0)
    odometry: bool = True


def read(name: str, options: MarkersOptions) -> Source:
    """The course of these options with its truth; the same seed gives the same course."""
    rng = np.random.default_rng(options.seed)
    track = Track.around(options.track_radius_m)
    seconds = track.length_m / options.speed + options.overlap_s
    way = drive(track, options.speed, seconds, _CLOCK_HZ, tilt_sigma=_TILT_SIGMA, rng=rng)
    markers = _markers(track, options.num_markers, rng)
    ticks = np.arange(0, len(way.stamps_ns), round(_CLOCK_HZ / options.image_rate_hz))
    images = _ImagesOnTheWay(MarkerCamera(_CAMERA), markers, way, ticks, options.seed)
    wheels = OdometryNoise() if options.odometry else None
    recording = Recording(
        name=name,
        measurements=Recorded(motion_samples(way, wheels, rng), way.stamps_ns[ticks], images),
        num_scans=len(ticks),
        odometry_noise=wheels,
        detectors={"optical-markers": {"edge_m": _EDGE_M}},
        map_T_start=way.pose(0),
    )
    landmarks = TrueLandmarks(
        markers.world_t_markers[:, :2],
        np.full(len(markers), Kind.MARKER),
        np.full(len(markers), np.nan),
    )
    return Source(recording, Truth(true_path(way), landmarks, images.in_sight()))


def _markers(track: Track, count: int, rng: np.random.Generator) -> OpticalMarkers:
    """On the outer side, where one looks in a bend; facing those who come, turned to the track."""
    places, poses = beside(track, count, _BESIDE_M, rng, sides=(-1.0,))
    yaws = poses[:, 2] + math.pi - rng.uniform(*_TURNS, count)
    heights_m = rng.uniform(*_HEIGHTS_M, count)
    ids = rng.choice(NUM_IDS, count, replace=False)
    return OpticalMarkers(ids, np.column_stack([places, heights_m]), yaws, _EDGE_M)


@dataclass(frozen=True, slots=True, eq=False)
class _ImagesOnTheWay:
    """The k-th image is that of tick `ticks[k]`."""

    device: MarkerCamera
    markers: OpticalMarkers
    way: Drive
    ticks: IntArray
    seed: int

    def __call__(self, k: int) -> CameraImage:
        """The same for the same k."""
        tick = int(self.ticks[k])
        rng = np.random.default_rng([self.seed, k])
        stamp_ns = int(self.way.stamps_ns[tick])
        pose, tilt = self.way.pose(tick), self.way.tilt(tick)
        return self.device.image(self.markers, pose, rng, stamp_ns=stamp_ns, tilt=tilt)

    def in_sight(self) -> dict[int, IntArray]:
        """Of each image, by its stamp, the rows of the markers that are easy to read in it."""
        stamps = self.way.stamps_ns[self.ticks].tolist()
        return {
            stamp_ns: self._in_sight(tick)
            for stamp_ns, tick in zip(stamps, self.ticks.tolist(), strict=True)
        }

    def _in_sight(self, tick: int) -> IntArray:
        """Whole in the image, wide enough, turned by at most 50 deg."""
        camera = self.device.camera
        pose = self.way.pose(tick)
        corners_px, depths_m = self.device.project(
            self.markers.world_t_corners(1.3), pose, self.way.tilt(tick)
        )
        last_px = (camera.width - 1, camera.height - 1)
        inside = ((corners_px >= 0.0) & (corners_px <= last_px)).all(axis=(1, 2))
        nearest_m = np.maximum(depths_m.max(axis=1), 1e-3)
        wide = camera.focal_px * self.markers.edge_m / nearest_m >= _SEEN_PX
        to_camera = np.array([pose.x, pose.y]) - self.markers.world_t_markers[:, :2]
        turns = np.arctan2(to_camera[:, 1], to_camera[:, 0]) - self.markers.yaws
        ahead = (depths_m > 0.1).all(axis=1)
        in_sight: IntArray = np.flatnonzero(
            inside & wide & ahead & (np.cos(turns) >= math.cos(_SEEN_TURN))
        )
        return in_sight
