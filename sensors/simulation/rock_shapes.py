"""Sizes and shapes of simulated rocks."""

from typing import Final

import numpy as np
from scipy.spatial import ConvexHull

from semgraph.arrays import FloatArray, IntArray

_NUM_VERTICES: Final = 150
_NUM_WAVES: Final = 6
_HEIGHTS: Final = (0.35, 0.75)
_BURIED: Final = (0.1, 0.5)
_ELONGATION: Final = (1.0, 1.5)
_BUMPS: Final = 0.05


def _even_directions(count: int) -> FloatArray:
    """(count, 3) unit vectors, evenly over the sphere (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angles = np.pi * (1.0 + np.sqrt(5.0)) * k
    level = np.sqrt(1.0 - z**2)
    return np.column_stack([level * np.cos(angles), level * np.sin(angles), z])


_DIRECTIONS: Final = _even_directions(_NUM_VERTICES)
FACES: Final[IntArray] = ConvexHull(_DIRECTIONS).simplices.astype(np.int64)


def golombek_diameters(
    share: float, area_m2: float, between_m: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """(m,) m, diameters of the rocks of an area, largest first.

    The share of the ground under rocks of diameter D and more is k exp(-q D), q = 1.79 + 0.152/k.
    Source: Golombek and Rapp 1997, Size-frequency distributions of rocks on Mars.
    """
    if share == 0.0:
        return np.zeros(0)
    q = 1.79 + 0.152 / share
    d = np.geomspace(*between_m, 500)
    density = 4.0 * share * q * np.exp(-q * d) / (np.pi * d**2)
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(d)
    per_m2 = np.concatenate([[0.0], np.cumsum(steps)])
    drawn = rng.uniform(0.0, per_m2[-1], rng.poisson(per_m2[-1] * area_m2))
    diameters_m: FloatArray = np.sort(np.interp(drawn, per_m2, d))[::-1]
    return diameters_m


def rock_vertices(diameters_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(m, v, 3) m, irregular ellipsoids of 0.35 to 0.75 D above the ground, partly below z = 0.

    The outline seen from above has its centroid at the origin and the area of a circle of D.
    """
    m = len(diameters_m)
    waves = rng.normal(0.0, 2.0, (m, _NUM_WAVES, 3))
    phases = rng.uniform(0.0, 2.0 * np.pi, (m, 1, _NUM_WAVES))
    bumps = _BUMPS * np.cos(_DIRECTIONS @ waves.transpose(0, 2, 1) + phases).sum(axis=2)
    vertices: FloatArray = (1.0 + bumps)[:, :, None] * _DIRECTIONS
    _place_outlines(vertices, diameters_m, rng)
    buried = rng.uniform(*_BURIED, (m, 1))
    heights = rng.uniform(*_HEIGHTS, (m, 1)) * diameters_m[:, None] / (1.0 - buried)
    z = vertices[:, :, 2]
    lowest, highest = z.min(axis=1, keepdims=True), z.max(axis=1, keepdims=True)
    vertices[:, :, 2] = heights * ((z - lowest) / (highest - lowest) - buried)
    return vertices


def _place_outlines(
    vertices: FloatArray, diameters_m: FloatArray, rng: np.random.Generator
) -> None:
    """Stretch, turn, centre and scale the outlines of (m, v, 3) seen from above, in place."""
    m = len(vertices)
    vertices[:, :, 0] *= np.sqrt(rng.uniform(*_ELONGATION, (m, 1)))
    vertices[:, :, 1] /= np.sqrt(rng.uniform(*_ELONGATION, (m, 1)))
    angles = rng.uniform(0.0, np.pi, m)
    c, s = np.cos(angles), np.sin(angles)
    turns = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)
    vertices[:, :, :2] = vertices[:, :, :2] @ turns
    centroids, areas = _centroids_and_areas(vertices[:, :, :2])
    scales = diameters_m / (2.0 * np.sqrt(areas / np.pi))
    vertices[:, :, :2] = scales[:, None, None] * (vertices[:, :, :2] - centroids[:, None])


def _centroids_and_areas(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m, 2) and (m,) of the convex hulls of (m, v, 2), from the outmost points every 4 deg."""
    angles = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    outmost = np.argmax(points @ np.stack([np.cos(angles), np.sin(angles)]), axis=1)
    a = np.take_along_axis(points, outmost[:, :, None], axis=1)
    b = np.roll(a, -1, axis=1)
    cross = a[:, :, 0] * b[:, :, 1] - a[:, :, 1] * b[:, :, 0]
    areas = 0.5 * cross.sum(axis=1)
    return ((a + b) * cross[:, :, None]).sum(axis=1) / (6.0 * areas[:, None]), areas
