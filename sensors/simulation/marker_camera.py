"""A simulated camera that sees square optical markers, AprilTag 36h11, in grey images."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.measurements import CameraGeometry, CameraImage, Tilt

FAMILY = cv2.aruco.DICT_APRILTAG_36h11
NUM_IDS = 587
CELLS = 8
"""Cells along the edge of a marker, its black frame included."""
QUIET_CELLS = 1
"""White cells around it."""
_CELL_TEXELS = 32
_SUPERSAMPLING = 8
_NEAREST_M = 0.05
_BLACK, _WHITE = 25.0, 205.0


@dataclass(frozen=True, slots=True, eq=False)
class OpticalMarkers:
    """Upright square markers.

    Attributes:
        ids: (n,) of the family, 0 to 586.
        world_t_markers: (n, 3) m, the centres.
        yaws: (n,) rad, where each one faces.
        edge_m: of the black square.

    Raises:
        InputError: shapes disagree, an unknown id, or an edge that is not above 0.
    """

    ids: IntArray
    world_t_markers: FloatArray
    yaws: FloatArray
    edge_m: float

    def __post_init__(self) -> None:
        n = len(self.yaws)
        positions = frozen_floats("marker positions", self.world_t_markers, (n, 3))
        object.__setattr__(self, "ids", frozen_ints("marker ids", self.ids, (n,)))
        object.__setattr__(self, "world_t_markers", positions)
        object.__setattr__(self, "yaws", frozen_floats("marker yaws", self.yaws, (n,)))
        if not ((self.ids >= 0) & (self.ids < NUM_IDS)).all():
            raise InputError(f"optical markers: expected ids of 0 to {NUM_IDS - 1}, got {self.ids}")
        if not 0.0 < self.edge_m < np.inf:
            raise InputError(f"optical markers: expected an edge above 0 m, got {self.edge_m}")

    def __len__(self) -> int:
        return len(self.yaws)

    def world_t_corners(self, reach: float = 1.0) -> FloatArray:
        """(n, 4, 3) m as one sees them: upper left, upper right, lower right, lower left.

        `reach` 1 gives the black square's, more gives those of a larger square about it.
        """
        right = np.column_stack([-np.sin(self.yaws), np.cos(self.yaws), np.zeros(len(self))])
        signs = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
        half_m = 0.5 * self.edge_m * reach
        offsets = signs[:, :1] * right[:, None] + signs[:, 1:] * np.array([0.0, 0.0, 1.0])
        return np.asarray(self.world_t_markers[:, None] + half_m * offsets)


@dataclass(frozen=True, slots=True)
class MarkerCamera:
    """The device: a pinhole, blur of its lens (sigma), light that changes, noise of its pixels."""

    camera: CameraGeometry
    blur_px: float = 0.6
    noise: float = 3.0
    exposures: tuple[float, float] = (0.5, 1.2)

    def image(
        self,
        markers: OpticalMarkers,
        world_T_base: Pose2,
        rng: np.random.Generator,
        *,
        stamp_ns: int = 0,
        tilt: Tilt | None = None,
    ) -> CameraImage:
        """One image. Base leans about its origin on the ground."""
        tilt = tilt or Tilt()
        canvas = _background(self.camera.height, self.camera.width, rng)
        corners_px, depths_m = self.project(
            markers.world_t_corners((CELLS + 2.0 * QUIET_CELLS) / CELLS), world_T_base, tilt
        )
        for k in np.argsort(-depths_m.mean(axis=1)):
            if (depths_m[k] > _NEAREST_M).all() and _is_front(corners_px[k]):
                _paint(canvas, _texture(int(markers.ids[k])), corners_px[k])
        blurred = cv2.GaussianBlur(canvas, (0, 0), self.blur_px) if self.blur_px > 0.0 else canvas
        pixels = rng.standard_normal(canvas.shape, dtype=np.float32)
        seen = rng.uniform(*self.exposures) * blurred + self.noise * pixels
        grey = np.clip(np.rint(seen), 0, 255).astype(np.uint8)
        return CameraImage(stamp_ns, self.camera, grey, tilt)

    def project(
        self, world_t_points: FloatArray, world_T_base: Pose2, tilt: Tilt
    ) -> tuple[FloatArray, FloatArray]:
        """Columns and rows (..., 2) of points (..., 3), and their depths (...) m.

        Pixels count from the middle of the first.
        """
        mounting, base_T_world = self.camera.mounting, world_T_base.inverse()
        flat = world_t_points.reshape(-1, 3)
        level_t_points = np.column_stack([base_T_world.transform(flat[:, :2]), flat[:, 2]])
        base_t_points = level_t_points @ tilt.level_R_base()
        base_t_camera = (mounting.x_m, mounting.y_m, mounting.height_m)
        x, y, z = ((base_t_points - base_t_camera) @ mounting.base_R_sensor()).T
        depths_m = np.where(np.abs(x) < 1e-9, 1e-9, x)
        centre, focal_px = self.camera.centre_px, self.camera.focal_px
        pixels = np.column_stack(
            [centre[0] - focal_px * y / depths_m, centre[1] - focal_px * z / depths_m]
        )
        shape = world_t_points.shape[:-1]
        return pixels.reshape(*shape, 2), depths_m.reshape(shape)


def _is_front(corners_px: FloatArray) -> bool:
    """From behind, the corners (4, 2) go round the other way."""
    x, y = corners_px.T
    return bool(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0.0)


def _texture(marker_id: int) -> FloatArray:
    """A marker with its quiet zone; square."""
    family = cv2.aruco.getPredefinedDictionary(FAMILY)
    cells = np.pad(
        cv2.aruco.generateImageMarker(family, marker_id, CELLS), QUIET_CELLS, constant_values=255
    )
    levels = np.where(cells > 0, _WHITE, _BLACK)
    return np.kron(levels, np.ones((_CELL_TEXELS, _CELL_TEXELS)))


def _paint(canvas: NDArray[np.float32], texture: FloatArray, corners_px: FloatArray) -> None:
    """Lays the texture between the corners; each pixel is the mean of 8 x 8 points in it."""
    height, width = canvas.shape
    low = np.maximum(np.floor(corners_px.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(corners_px.max(axis=0)).astype(int) + 2, (width, height))
    if (high <= low).any():
        return
    size = len(texture)
    texels = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32) - 0.5
    points = (corners_px - low + 0.5) * _SUPERSAMPLING - 0.5
    homography = cv2.getPerspectiveTransform(
        texels.astype(np.float32), points.astype(np.float32), cv2.DECOMP_LU
    )
    columns, rows = (int(n) for n in high - low)
    fine = (columns * _SUPERSAMPLING, rows * _SUPERSAMPLING)
    levels = cv2.warpPerspective(
        texture.astype(np.float32), homography, fine, borderMode=cv2.BORDER_REPLICATE
    )
    inside = cv2.warpPerspective(
        np.ones((size, size), np.float32), homography, fine, flags=cv2.INTER_NEAREST
    )
    cover = cv2.resize(inside, (columns, rows), interpolation=cv2.INTER_AREA)
    paint = cv2.resize(levels * inside, (columns, rows), interpolation=cv2.INTER_AREA)
    patch = canvas[low[1] : high[1], low[0] : high[0]]
    patch *= 1.0 - cover
    patch += paint


def _background(height: int, width: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """A slope of light with blotches of several sizes."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height))
    slope = rng.uniform(-30.0, 30.0, 2)
    light = rng.uniform(70.0, 150.0) + slope[0] * x + slope[1] * y
    canvas = np.asarray(light, dtype=np.float32)
    for blotch_px in (64, 16, 4):
        shape = (height // blotch_px + 2, width // blotch_px + 2)
        blotches = rng.normal(0.0, 12.0, shape).astype(np.float32)
        canvas += np.asarray(cv2.resize(blotches, (width, height), interpolation=cv2.INTER_CUBIC))
    return canvas
