"""Where the points of a measurement lie about the vehicle, and where points lie in an image."""

import numpy as np

from semgraph.arrays import FloatArray
from sensors.measurements import (
    CameraGeometry,
    CameraImage,
    DepthImage,
    LaserScan,
    Mounting,
    PointCloud,
    Raw,
    Tilt,
)


def base_t_points(measurement: Raw, stride: int = 1) -> FloatArray:
    """(n, 3) m, level, about the ground point of base: what came back, nothing of a camera image.

    A scan lies in the plane. `stride` takes every such row and column of an image.
    """
    match measurement:
        case LaserScan():
            return _of_scan(measurement)
        case PointCloud():
            return _levelled(measurement.sensor_t_points, measurement.mounting, measurement.tilt)
        case DepthImage():
            return _of_image(measurement, stride)
        case CameraImage():
            return np.zeros((0, 3))


def pixels(camera: CameraGeometry, tilt: Tilt, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns and rows (n, 2), and depths (n,) m, of points (n, 3) as `base_t_points` has them.

    What is not ahead of the camera has NaN.
    """
    level_R_sensor = tilt.level_R_base() @ camera.mounting.base_R_sensor()
    offset = tilt.level_R_base() @ _translation(camera.mounting)
    ahead, left, up = ((points - offset) @ level_R_sensor).T
    ahead = np.where(ahead > 1e-3, ahead, np.nan)
    slopes = np.column_stack([left, up]) / ahead[:, None]
    return np.array(camera.centre_px) - camera.focal_px * slopes, ahead


def _of_scan(scan: LaserScan) -> FloatArray:
    hit = np.isfinite(scan.ranges_m)
    beams = np.flatnonzero(hit)
    bearings = scan.geometry.angle_min + scan.geometry.angle_increment * beams
    ranges_m = scan.ranges_m[hit]
    laser_t_points = ranges_m[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
    flat = scan.geometry.base_T_laser.transform(laser_t_points)
    return np.column_stack([flat, np.zeros(len(flat))])


def _of_image(image: DepthImage, stride: int) -> FloatArray:
    camera = image.camera
    depths_m = image.depths_m[::stride, ::stride]
    rows, columns = np.nonzero(np.isfinite(depths_m))
    ahead = depths_m[rows, columns]
    left = (camera.centre_px[0] - stride * columns) / camera.focal_px
    up = (camera.centre_px[1] - stride * rows) / camera.focal_px
    sensor_t_points = ahead[:, None] * np.column_stack([np.ones(len(ahead)), left, up])
    return _levelled(sensor_t_points, camera.mounting, image.tilt)


def _levelled(sensor_t_points: FloatArray, mounting: Mounting, tilt: Tilt) -> FloatArray:
    base_t = sensor_t_points @ mounting.base_R_sensor().T + _translation(mounting)
    return np.asarray(base_t @ tilt.level_R_base().T)


def _translation(mounting: Mounting) -> FloatArray:
    return np.array([mounting.x_m, mounting.y_m, mounting.height_m])
