"""Simulated rough ground with rocks on it."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.measurements import Tilt
from sensors.simulation.rock_shapes import FACES, golombek_diameters, rock_vertices

_AXLE_M: Final = 0.6
_TRIES: Final = 12


@dataclass(frozen=True, slots=True)
class TerrainSettings:
    """Self-affine ground (two places L apart differ by `deviation_m` L^`hurst`, rms) and rocks.

    `rock_share` is Golombek's k, the share of the ground that rocks of any size cover; none lies
    within `clearing_m` of the middle. Source of the law: Shepard et al. 2001, The roughness of
    natural terrain.
    """

    size_m: float = 32.0
    cell_m: float = 0.1
    deviation_m: float = 0.04
    hurst: float = 0.7
    longest_wave_m: float = 20.0
    rock_share: float = 0.05
    rock_diameters_m: tuple[float, float] = (0.1, 2.0)
    clearing_m: float = 1.5

    def __post_init__(self) -> None:
        if not (0.0 < 10.0 * self.cell_m <= 1.0 <= self.size_m / 4.0 <= 250.0):
            raise InputError(
                "terrain: expected size_m from 4 to 1000 and cell_m up to 0.1, "
                f"got {self.size_m} and {self.cell_m}"
            )
        low, high = self.rock_diameters_m
        if not (0.0 < low < high and 0.0 <= self.rock_share < 0.5 and self.deviation_m >= 0.0):
            raise InputError(f"terrain: expected shares and sizes of rocks in order, got {self}")


SMOOTH: Final = TerrainSettings(deviation_m=0.015)
MEDIUM: Final = TerrainSettings(deviation_m=0.04)
ROUGH: Final = TerrainSettings(deviation_m=0.08)


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """A square height field around the origin, and m rocks.

    Attributes:
        cell_m: between neighbouring heights.
        heights_m: (n, n), rows along y, columns along x.
        world_t_rocks: (m, 2) m, the centre of each rock's outline seen from above.
        diameters_m: (m,) of the circle of that outline's area.
        rock_meshes: (m, v, 3) m, vertices; all have the triangles `rock_shapes.FACES`.
    """

    cell_m: float
    heights_m: FloatArray
    world_t_rocks: FloatArray
    diameters_m: FloatArray
    rock_meshes: FloatArray

    def __post_init__(self) -> None:
        m = len(self.diameters_m)
        checked = {
            "heights_m": frozen_floats("terrain heights", self.heights_m, (None, None)),
            "world_t_rocks": frozen_floats("rock positions", self.world_t_rocks, (m, 2)),
            "diameters_m": frozen_floats("rock diameters", self.diameters_m, (m,)),
            "rock_meshes": frozen_floats("rock vertices", self.rock_meshes, (m, None, 3)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def heights_at(self, world_t_points: FloatArray) -> FloatArray:
        """(k,) m, the ground below points (k, 2); beyond the edge, that of the edge."""
        from scipy.ndimage import map_coordinates

        middle = 0.5 * (len(self.heights_m) - 1)
        coordinates = world_t_points.T[::-1] / self.cell_m + middle
        heights: FloatArray = map_coordinates(self.heights_m, coordinates, order=1, mode="nearest")
        return heights

    def rest(self, world_T_base: Pose2) -> tuple[float, Tilt]:
        """Height of base, and its tilt, of a vehicle on four wheels `_AXLE_M` apart."""
        corners = 0.5 * _AXLE_M * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
        heights = self.heights_at(world_T_base.transform(corners))
        ahead, left = heights @ corners / (4.0 * (0.5 * _AXLE_M) ** 2)
        tilt = Tilt(roll=math.atan2(left, math.hypot(1.0, ahead)), pitch=-math.atan(ahead))
        return float(heights.mean()), tilt

    def ground_mesh(self) -> tuple[FloatArray, IntArray]:
        """Vertices (n * n, 3) and triangles (k, 3) of the height field."""
        n = len(self.heights_m)
        along = (np.arange(n) - 0.5 * (n - 1)) * self.cell_m
        x, y = np.meshgrid(along, along)
        corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
        lower = np.column_stack([corner, corner + 1, corner + n])
        upper = np.column_stack([corner + 1, corner + n + 1, corner + n])
        vertices = np.stack([x, y, self.heights_m], axis=-1).reshape(-1, 3)
        return vertices, np.concatenate([lower, upper])

    def rock_mesh(self) -> tuple[FloatArray, IntArray]:
        """Vertices and triangles of all rocks; triangle t is of rock t // len(FACES)."""
        m, v, _ = self.rock_meshes.shape
        return self.rock_meshes.reshape(-1, 3), (
            np.arange(m)[:, None, None] * v + FACES[None]
        ).reshape(-1, 3)


def rough_terrain(settings: TerrainSettings, rng: np.random.Generator) -> Terrain:
    """A terrain of these settings; the same generator gives the same one."""
    heights_m = _self_affine(settings, rng)
    diameters_m = golombek_diameters(
        settings.rock_share, settings.size_m**2, settings.rock_diameters_m, rng
    )
    world_t_rocks = _scatter(diameters_m, settings, rng)
    diameters_m = diameters_m[: len(world_t_rocks)]
    bare = Terrain(settings.cell_m, heights_m, np.zeros((0, 2)), np.zeros(0), np.zeros((0, 1, 3)))
    meshes = rock_vertices(diameters_m, rng)
    meshes[:, :, :2] += world_t_rocks[:, None]
    meshes[:, :, 2] += bare.heights_at(world_t_rocks)[:, None]
    return Terrain(settings.cell_m, heights_m, world_t_rocks, diameters_m, meshes)


def _self_affine(settings: TerrainSettings, rng: np.random.Generator) -> FloatArray:
    """(n, n) m: white noise whose power falls as f^-(2 hurst + 2) below the longest wave."""
    n = round(settings.size_m / settings.cell_m) + 1
    rows, columns = np.fft.fftfreq(n, settings.cell_m), np.fft.rfftfreq(n, settings.cell_m)
    power = rows[:, None] ** 2 + columns**2 + settings.longest_wave_m**-2
    noise = np.fft.rfft2(rng.standard_normal((n, n)))
    heights: FloatArray = np.fft.irfft2(noise * power ** (-0.5 * (settings.hurst + 1.0)), (n, n))
    metre = round(1.0 / settings.cell_m)
    steps = np.concatenate([np.roll(heights, metre, axis) - heights for axis in (0, 1)])
    return heights * (settings.deviation_m / float(np.sqrt(np.mean(steps**2))))


def _scatter(
    diameters_m: FloatArray, settings: TerrainSettings, rng: np.random.Generator
) -> FloatArray:
    """(m, 2) m, places that overlap with no larger rock and keep the middle free.

    Raises:
        InputError: they do not fit.
    """
    places = np.empty((len(diameters_m), 2))
    half = 0.5 * settings.size_m
    for k, diameter_m in enumerate(diameters_m):
        tries = rng.uniform(-half, half, (_TRIES, 2))
        gaps_m = np.linalg.norm(tries[:, None] - places[None, :k], axis=2) - 0.5 * (
            diameters_m[:k] + diameter_m
        )
        free = (gaps_m > 0.0).all(axis=1) & (
            np.linalg.norm(tries, axis=1) > settings.clearing_m + 0.5 * diameter_m
        )
        if not free.any():
            raise InputError("terrain: the rocks do not fit; take a smaller rock_share")
        places[k] = tries[np.argmax(free)]
    return places
