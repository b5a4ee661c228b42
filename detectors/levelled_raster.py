"""Depths as points in a level frame, still in the order of an image."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from sensors.measurements import DepthImage, Mounting, PointCloud, Tilt

_CLOUD_PIXEL: Final = 0.0044
_FARTHEST_M: Final = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class LevelledRaster:
    """Points (rows, columns) about the sensor's point and heading in the plane; NaN for none.

    Attributes:
        x, y: m, ahead and to the left of the sensor.
        z: m above the ground point of base.
        ranges_m: in the plane.
        depths_m: along the optical axis; of a cloud, along the ray.
        height_m: of the sensor above the ground point of base.
        focal_px: of the image; of a cloud, that of an image as fine.
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    ranges_m: FloatArray
    depths_m: FloatArray
    height_m: float
    focal_px: float


def raster_of_image(image: DepthImage, stride: int) -> LevelledRaster:
    """Every `stride`th row and column of an image."""
    camera = image.camera
    rotation, offset = _level_T_sensor(camera.mounting, image.tilt)
    left = (camera.centre_px[0] - np.arange(0, camera.width, stride)) / camera.focal_px
    up = (camera.centre_px[1] - np.arange(0, camera.height, stride)) / camera.focal_px
    sampled = image.depths_m[::stride, ::stride]
    depths_m = np.where((sampled > 0.0) & (sampled < _FARTHEST_M), sampled, np.nan)
    x, y, z = (
        depths_m * ((ahead + up * rise)[:, None] + left * across) + start
        for (ahead, across, rise), start in zip(rotation, offset, strict=True)
    )
    return LevelledRaster(x, y, z, np.hypot(x, y), depths_m, float(offset[2]), camera.focal_px)


def raster_of_cloud(cloud: PointCloud, stride: int) -> LevelledRaster:
    """A cloud by bearing and elevation from the sensor, the nearest point of each pixel.

    A pixel is 0.25 deg wide, so that a cloud must be as dense to hang together. `stride` says how
    many pixels of the device it is, as in an image.
    """
    rotation, offset = _level_T_sensor(cloud.mounting, cloud.tilt)
    near = (np.abs(cloud.sensor_t_points) < _FARTHEST_M).all(axis=1)
    level_t_points = cloud.sensor_t_points[near] @ rotation.T
    depths_m = np.linalg.norm(level_t_points, axis=1)
    order = np.argsort(-depths_m)
    order = order[depths_m[order] > 0.0]
    level_t_points, depths_m = level_t_points[order], depths_m[order]
    azimuths = np.arctan2(level_t_points[:, 1], level_t_points[:, 0])
    elevations = np.arcsin(np.clip(level_t_points[:, 2] / depths_m, -1.0, 1.0))
    columns = _pixels(azimuths.max(initial=-np.pi) - azimuths)
    rows = _pixels(elevations.max(initial=-np.pi) - elevations)
    shape = (int(rows.max(initial=0)) + 1, int(columns.max(initial=0)) + 1)
    image = np.full((4, *shape), np.nan)
    image[:, rows, columns] = np.vstack([(level_t_points + offset).T, depths_m])
    x, y, z, depths_m = image
    focal_px = stride / _CLOUD_PIXEL
    return LevelledRaster(x, y, z, np.hypot(x, y), depths_m, float(offset[2]), focal_px)


def _pixels(angles: FloatArray) -> IntArray:
    return np.asarray(np.floor(angles / _CLOUD_PIXEL), dtype=np.int64)


def _level_T_sensor(mounting: Mounting, tilt: Tilt) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and offset (3,) into a level frame of the sensor's place and heading."""
    turn = Mounting(yaw=-mounting.yaw).base_R_sensor()
    level_R_base = turn @ tilt.level_R_base()
    offset = level_R_base @ (mounting.x_m, mounting.y_m, mounting.height_m)
    offset -= turn @ (mounting.x_m, mounting.y_m, 0.0)
    return level_R_base @ mounting.base_R_sensor(), offset
