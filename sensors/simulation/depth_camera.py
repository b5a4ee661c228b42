"""A simulated depth camera over terrain, stereo or time of flight, by ray casting (Open3D)."""

import math
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.measurements import CameraGeometry, DepthImage, Mounting, Tilt
from sensors.simulation.rock_shapes import FACES
from sensors.simulation.terrain import Terrain

NO_ROCK: Final = -1
MAST: Final = Mounting(height_m=1.3, pitch=math.radians(18.0))
VGA: Final = CameraGeometry(640, 480, 457.0, (319.5, 239.5), MAST)


class DepthNoise(Protocol):
    """How a depth errs."""

    def sigmas_m(self, depths_m: FloatArray, focal_px: float) -> FloatArray:
        """Standard deviations of depths, of the same shape."""
        ...


@dataclass(frozen=True, slots=True)
class Stereo:
    """sigma_z = z^2 sigma_d / (f b)."""

    baseline_m: float = 0.24
    disparity_sigma_px: float = 0.2

    def __post_init__(self) -> None:
        if not (self.baseline_m > 0.0 and self.disparity_sigma_px >= 0.0):
            raise InputError(
                f"stereo: expected baseline_m above 0 and no negative noise, got {self}"
            )

    def sigmas_m(self, depths_m: FloatArray, focal_px: float) -> FloatArray:
        """As the protocol says."""
        return depths_m**2 * (self.disparity_sigma_px / (focal_px * self.baseline_m))


@dataclass(frozen=True, slots=True)
class TimeOfFlight:
    """A constant and a share of the depth."""

    sigma_m: float = 0.005
    sigma_per_m: float = 0.003

    def __post_init__(self) -> None:
        if not (self.sigma_m >= 0.0 and self.sigma_per_m >= 0.0):
            raise InputError(f"time of flight: expected no negative noise, got {self}")

    def sigmas_m(self, depths_m: FloatArray, focal_px: float) -> FloatArray:  # noqa: ARG002 - protocol
        """As the protocol says."""
        return self.sigma_m + self.sigma_per_m * depths_m


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What a camera without noise sees: (height, width) m, NaN for nothing; rocks or `NO_ROCK`."""

    depths_m: FloatArray
    rocks: IntArray
    tilt: Tilt


class Scene:
    """A terrain that rays can be cast at."""

    def __init__(self, terrain: Terrain) -> None:
        self.terrain: Final = terrain
        self._tensor: Final = _open3d().core.Tensor
        self._caster: Final = _open3d().t.geometry.RaycastingScene(nthreads=1)
        for vertices, triangles in (terrain.ground_mesh(), terrain.rock_mesh()):
            self._caster.add_triangles(
                self._tensor(vertices.astype(np.float32)),
                self._tensor(triangles.astype(np.uint32)),
            )

    def view(self, camera: CameraGeometry, world_T_base: Pose2) -> View:
        """What `camera` sees from a vehicle that rests there."""
        rays, tilt = self._rays(camera, world_T_base)
        hits = self._caster.cast_rays(self._tensor(rays))
        depths_m = hits["t_hit"].numpy().astype(np.float64)
        depths_m[~np.isfinite(depths_m)] = np.nan
        rocks = hits["primitive_ids"].numpy().astype(np.int64) // len(FACES)
        rocks[hits["geometry_ids"].numpy() != 1] = NO_ROCK
        return View(depths_m, rocks, tilt)

    def bare_pixels(self, camera: CameraGeometry, world_T_base: Pose2) -> IntArray:
        """(m,) pixels each rock would fill if nothing stood before it; it is cut at the ground."""
        rays, _ = self._rays(camera, world_T_base)
        rays = rays.reshape(-1, 6)
        hits = self._caster.list_intersections(self._tensor(rays))
        of_rocks = hits["geometry_ids"].numpy() == 1
        owners = hits["ray_ids"].numpy().astype(np.int64)[of_rocks]
        points = rays[owners, :3] + hits["t_hit"].numpy()[of_rocks, None] * rays[owners, 3:]
        above = points[:, 2] > self.terrain.heights_at(points[:, :2].astype(np.float64))
        rocks = hits["primitive_ids"].numpy().astype(np.int64)[of_rocks] // len(FACES)
        seen = np.unique(np.column_stack([rocks, owners])[above], axis=0)
        return np.bincount(seen[:, 0], minlength=len(self.terrain.diameters_m))

    def _rays(self, camera: CameraGeometry, world_T_base: Pose2) -> tuple[FloatArray, Tilt]:
        """(height, width, 6) of float32, scaled such that a ray's length is its depth."""
        height_m, tilt = self.terrain.rest(world_T_base)
        mounting = camera.mounting
        world_R_base = Mounting(yaw=world_T_base.theta).base_R_sensor() @ tilt.level_R_base()
        base_t_sensor = np.array([mounting.x_m, mounting.y_m, mounting.height_m])
        world_t_sensor = (world_T_base.x, world_T_base.y, height_m) + world_R_base @ base_t_sensor
        left = (camera.centre_px[0] - np.arange(camera.width)) / camera.focal_px
        up = (camera.centre_px[1] - np.arange(camera.height)) / camera.focal_px
        directions = np.stack([np.ones((camera.height, camera.width)), *np.meshgrid(left, up)], -1)
        directions = directions @ (world_R_base @ mounting.base_R_sensor()).T
        origins = np.broadcast_to(world_t_sensor, directions.shape)
        return np.concatenate([origins, directions], axis=-1).astype(np.float32), tilt


@dataclass(frozen=True, slots=True)
class DepthCamera:
    """The device: noise alike over `correlation_px` (a matching window), depths between limits.

    A pixel whose neighbour is farther or nearer by more than `edge_step` of its depth is lost with
    the probability `edge_dropout`, any other with `dropout`. `tilt_sigma` is the IMU's, in rad.
    """

    camera: CameraGeometry = VGA
    noise: DepthNoise = field(default_factory=Stereo)
    correlation_px: float = 1.0
    depth_min_m: float = 0.4
    depth_max_m: float = 20.0
    edge_step: float = 0.1
    edge_dropout: float = 0.5
    dropout: float = 0.01
    tilt_sigma: float = 0.003

    def __post_init__(self) -> None:
        if not 0.0 <= self.depth_min_m < self.depth_max_m:
            raise InputError(
                "depth camera: expected 0 <= depth_min_m < depth_max_m, "
                f"got {self.depth_min_m} and {self.depth_max_m}"
            )
        if not (0.0 <= self.edge_dropout <= 1.0 and 0.0 <= self.dropout <= 1.0):
            raise InputError(
                "depth camera: expected dropouts from 0 to 1, "
                f"got {self.edge_dropout} and {self.dropout}"
            )
        if not (self.correlation_px >= 0.0 and self.edge_step > 0.0 and self.tilt_sigma >= 0.0):
            raise InputError(
                "depth camera: expected correlation_px and tilt_sigma of at least 0 and edge_step "
                f"above, got {self.correlation_px}, {self.tilt_sigma} and {self.edge_step}"
            )

    def look(
        self, scene: Scene, world_T_base: Pose2, stamp_ns: int, rng: np.random.Generator
    ) -> DepthImage:
        """What the device says from a vehicle that rests there."""
        return self.measure(scene.view(self.camera, world_T_base), stamp_ns, rng)

    def measure(self, view: View, stamp_ns: int, rng: np.random.Generator) -> DepthImage:
        """What the device says of a view."""
        depths_m = view.depths_m + self.noise.sigmas_m(
            view.depths_m, self.camera.focal_px
        ) * _correlated(view.depths_m.shape, self.correlation_px, rng)
        kept = (depths_m >= self.depth_min_m) & (depths_m <= self.depth_max_m)
        lost = np.where(self._edges(view.depths_m), self.edge_dropout, self.dropout)
        kept &= rng.uniform(size=depths_m.shape) >= lost
        roll, pitch = (self.tilt_sigma * rng.standard_normal(2)).tolist()
        tilt = Tilt(view.tilt.roll + roll, view.tilt.pitch + pitch)
        return DepthImage(stamp_ns, self.camera, np.where(kept, depths_m, np.nan), tilt)

    def _edges(self, depths_m: FloatArray) -> BoolArray:
        from scipy.ndimage import maximum_filter, minimum_filter

        far = np.nan_to_num(depths_m, nan=1e6)
        steps_m = maximum_filter(far, 3) - minimum_filter(far, 3)
        # Ground seen at a glance has steps from row to row that are no edges.
        glancing_m = np.abs(np.gradient(far, axis=0))
        return np.asarray(steps_m > self.edge_step * far + 3.0 * glancing_m)


def _correlated(
    shape: tuple[int, ...], correlation_px: float, rng: np.random.Generator
) -> FloatArray:
    """Normal noise of variance 1, alike over some pixels."""
    from scipy.ndimage import gaussian_filter

    white = rng.standard_normal(shape)
    if correlation_px == 0.0:
        return white
    smooth: FloatArray = gaussian_filter(white, correlation_px)
    return smooth / float(smooth.std())


def _open3d() -> Any:
    """The module, loaded when the first scene is built.

    Raises:
        InputError: it, or a library of the system that it needs, is missing.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise InputError(
            f"depth camera: expected Open3D to load, got {str(error).splitlines()[0]!r}; "
            "on Debian: apt-get install libusb-1.0-0 libgl1 libgomp1 libx11-6"
        ) from error
    return open3d
