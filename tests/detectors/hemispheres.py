"""Depth images of half balls on flat ground, in closed form."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from semgraph.arrays import FloatArray
from sensors.measurements import CameraGeometry, DepthImage, Mounting, PointCloud, Tilt

STAMP_NS = 1_234_567_890_123_456_789
MAST = Mounting(height_m=1.3, pitch=np.radians(18.0))
CAMERA = CameraGeometry(640, 480, 457.0, (319.5, 239.5), MAST)
SIGMA_PX = 0.2 / (457.0 * 0.24)
Hemisphere = tuple[float, float, float]


def mounted(mounting: Mounting) -> CameraGeometry:
    """The same camera elsewhere."""
    return replace(CAMERA, mounting=mounting)


def depth_image(
    balls: Sequence[Hemisphere],
    camera: CameraGeometry = CAMERA,
    tilt: Tilt | None = None,
    seed: int | None = None,
) -> DepthImage:
    """Balls (x, y, diameter) in the level frame of base, whose origin is on the ground.

    With a seed there is the noise of a stereo camera of 0.24 m.
    """
    tilt = Tilt() if tilt is None else tilt
    mounting = camera.mounting
    rays = _rays(camera) @ (tilt.level_R_base() @ mounting.base_R_sensor()).T
    sensor = tilt.level_R_base() @ (mounting.x_m, mounting.y_m, mounting.height_m)
    depths_m = np.where(rays[..., 2] < 0.0, -sensor[2] / np.minimum(rays[..., 2], -1e-9), np.inf)
    for x, y, diameter in balls:
        from_ball = sensor - (x, y, 0.0)
        a = (rays**2).sum(axis=-1)
        b = rays @ from_ball
        c = from_ball @ from_ball - 0.25 * diameter**2
        root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
        hit = np.where(b**2 > a * c, (-b - root) / a, np.inf)
        depths_m = np.minimum(depths_m, np.where(hit > 0.0, hit, np.inf))
    depths_m[depths_m > 20.0] = np.nan
    if seed is not None:
        noise = np.random.default_rng(seed).standard_normal(depths_m.shape)
        depths_m = depths_m + SIGMA_PX * depths_m**2 * noise
    return DepthImage(STAMP_NS, camera, depths_m, tilt)


def cloud_of(image: DepthImage) -> PointCloud:
    """All its points, in the sensor's frame."""
    points = (image.depths_m[..., None] * _rays(image.camera)).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    rings = np.full(len(points), -1)
    return PointCloud(image.stamp_ns, image.camera.mounting, points, rings, image.tilt)


def _rays(camera: CameraGeometry) -> FloatArray:
    """(height, width, 3) in the sensor's frame, 1 along the optical axis."""
    left = (camera.centre_px[0] - np.arange(camera.width)) / camera.focal_px
    up = (camera.centre_px[1] - np.arange(camera.height)) / camera.focal_px
    return np.stack([np.ones((camera.height, camera.width)), *np.meshgrid(left, up)], axis=-1)
