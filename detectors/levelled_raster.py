"""Depths as points in a level frame, still in the order of the image."""

from dataclasses import dataclass

import numpy as np

from semgraph.arrays import FloatArray
from sensors.measurements import DepthImage, Mounting


@dataclass(frozen=True, slots=True, eq=False)
class LevelledRaster:
    """Points (rows, columns) about the sensor's point and heading in the plane; NaN for none.

    Attributes:
        x, y: m, ahead and to the left of the sensor.
        z: m above the ground point of base.
        ranges_m: in the plane.
        depths_m: along the optical axis.
        height_m: of the sensor above the ground point of base.
        focal_px: of the image.
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    ranges_m: FloatArray
    depths_m: FloatArray
    height_m: float
    focal_px: float


def levelled_raster(image: DepthImage, stride: int) -> LevelledRaster:
    """Every `stride`th row and column of an image."""
    camera, mounting = image.camera, image.camera.mounting
    turn = Mounting(yaw=-mounting.yaw).base_R_sensor()
    level_R_base = turn @ image.tilt.level_R_base()
    rotation = level_R_base @ mounting.base_R_sensor()
    offset = level_R_base @ (mounting.x_m, mounting.y_m, mounting.height_m)
    offset -= turn @ (mounting.x_m, mounting.y_m, 0.0)
    left = (camera.centre_px[0] - np.arange(0, camera.width, stride)) / camera.focal_px
    up = (camera.centre_px[1] - np.arange(0, camera.height, stride)) / camera.focal_px
    sampled = image.depths_m[::stride, ::stride]
    depths_m = np.where(np.isfinite(sampled) & (sampled > 0.0), sampled, np.nan)
    x, y, z = (
        depths_m * ((ahead + up * rise)[:, None] + left * across) + start
        for (ahead, across, rise), start in zip(rotation, offset, strict=True)
    )
    return LevelledRaster(x, y, z, np.hypot(x, y), depths_m, float(offset[2]), camera.focal_px)
