"""Visible arcs and mean ranges against dense rays."""

import numpy as np
import pytest

from semgraph.arrays import FloatArray, IntArray
from sensors.simulation.ray_casting import chord_ranges, mean_ranges, ragged_ranges, visible_arcs


def _circles(seed: int, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distances, bearings, radii of circles that do not overlap."""
    rng = np.random.default_rng(seed)
    kept: list[tuple[float, float, float]] = []
    while len(kept) < n:
        x, y = rng.uniform(-12.0, 12.0, 2)
        radius = rng.uniform(0.02, 0.6)
        free = all(np.hypot(x - a, y - b) > radius + r + 0.01 for a, b, r in kept)
        if free and np.hypot(x, y) > radius + 0.3 and x > -2.0 * abs(y):
            kept.append((x, y, radius))
    x, y, radii_m = np.array(kept).T
    return np.hypot(x, y), np.arctan2(y, x), radii_m


def _nearest_by_brute_force(
    rays: FloatArray, distances_m: FloatArray, bearings: FloatArray, radii_m: FloatArray
) -> IntArray:
    offsets = rays[:, None] - bearings
    hit = np.abs(offsets) < np.arcsin(radii_m / distances_m)
    ranges_m = np.where(hit, chord_ranges(distances_m, radii_m, offsets), np.inf)
    return np.where(hit.any(axis=1), ranges_m.argmin(axis=1), -1)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("n", [1, 2, 40, 150])
def test_arcs_agree_with_dense_rays(seed: int, n: int) -> None:
    distances_m, bearings, radii_m = _circles(seed, n)
    arcs = visible_arcs(distances_m, bearings, radii_m)
    rays = np.linspace(-3.0, 3.0, 4001)
    expected = _nearest_by_brute_force(rays, distances_m, bearings, radii_m)
    at = np.searchsorted(arcs.starts, rays) - 1
    inside = (at >= 0) & (rays < arcs.ends[at])
    np.testing.assert_array_equal(np.where(inside, arcs.owners[at], -1), expected)


def test_nothing_to_see() -> None:
    assert len(visible_arcs(*np.zeros((3, 0))).owners) == 0


@pytest.mark.parametrize("distance_m", [0.8, 3.0, 20.0])
@pytest.mark.parametrize("radius_m", [0.02, 0.3])
@pytest.mark.parametrize("piece", [(-1.0, 1.0), (-1.0, -0.8), (0.3, 0.5), (0.99, 1.0)])
def test_mean_ranges_agree_with_dense_rays(
    distance_m: float, radius_m: float, piece: tuple[float, float]
) -> None:
    """`piece` in half angles of the circle; a beam is never wider than 40 mrad."""
    half = np.arcsin(radius_m / distance_m)
    start, end = (share * half for share in piece)
    middle, width = 0.5 * (start + end), min(end - start, 0.04)
    offsets = np.linspace(middle - width / 2, middle + width / 2, 20001)
    dense = chord_ranges(np.full(1, distance_m), np.full(1, radius_m), offsets).mean()
    one = mean_ranges(np.full(1, distance_m), np.full(1, radius_m), offsets[[0]], offsets[[-1]])
    np.testing.assert_allclose(one, dense, atol=1e-3)


def test_ragged_ranges() -> None:
    rows, values = ragged_ranges(np.array([5, 0, 9]), np.array([2, 0, 3]))
    assert rows.tolist() == [0, 0, 2, 2, 2]
    assert values.tolist() == [5, 6, 9, 10, 11]
