"""Terrain: as rough as asked, rocks in Golombek's numbers and where the truth says."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.simulation.rock_shapes import FACES, golombek_diameters, rock_vertices
from sensors.simulation.terrain import (
    MEDIUM,
    ROUGH,
    SMOOTH,
    Terrain,
    TerrainSettings,
    rough_terrain,
)

SLOPE = (0.1, -0.2)


def _inclined() -> Terrain:
    """A plane z = 0.1 x - 0.2 y without rocks."""
    along = 0.1 * (np.arange(101) - 50)
    heights_m = SLOPE[0] * along[None, :] + SLOPE[1] * along[:, None]
    return Terrain(0.1, heights_m, np.zeros((0, 2)), np.zeros(0), np.zeros((0, 1, 3)))


@pytest.mark.parametrize("settings", [SMOOTH, MEDIUM, ROUGH])
def test_the_same_seed_gives_the_same_terrain(settings: TerrainSettings) -> None:
    small = replace(settings, size_m=12.0)
    first, again, other = (rough_terrain(small, np.random.default_rng(k)) for k in (5, 5, 6))
    for name in ("heights_m", "world_t_rocks", "diameters_m", "rock_meshes"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.heights_m, other.heights_m)


@pytest.mark.parametrize("settings", [SMOOTH, MEDIUM, ROUGH])
@pytest.mark.parametrize("lag_m", [0.5, 1.0, 2.0])
def test_the_ground_is_self_affine(settings: TerrainSettings, lag_m: float) -> None:
    bare = replace(settings, rock_share=0.0)
    lag = round(lag_m / bare.cell_m)
    squares = []
    for seed in range(5):
        heights_m = rough_terrain(bare, np.random.default_rng(seed)).heights_m
        squares.append(np.mean((heights_m[lag:] - heights_m[:-lag]) ** 2))
    expected = bare.deviation_m * lag_m**bare.hurst
    assert np.sqrt(np.mean(squares)) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("share", [0.02, 0.05, 0.1])
def test_rocks_come_in_golombeks_numbers(share: float) -> None:
    """The covered share between two sizes is F(D) = k exp(-q D) at one less that at the other."""
    area_m2, (low, high) = 20_000.0, (0.1, 2.0)
    diameters_m = golombek_diameters(share, area_m2, (low, high), np.random.default_rng(1))
    q = 1.79 + 0.152 / share
    covered = 0.25 * np.pi * np.sum(diameters_m**2) / area_m2
    assert covered == pytest.approx(share * (np.exp(-q * low) - np.exp(-q * high)), rel=0.1)
    assert (np.diff(diameters_m) <= 0.0).all()
    assert diameters_m.min() >= low
    assert diameters_m.max() <= high


def test_the_truth_is_the_outline_seen_from_above() -> None:
    from scipy.spatial import ConvexHull

    diameters_m = np.array([0.2, 0.5, 1.5])
    vertices = rock_vertices(diameters_m, np.random.default_rng(2))
    for rock, diameter_m in zip(vertices, diameters_m, strict=True):
        assert ConvexHull(rock[:, :2]).volume == pytest.approx(
            0.25 * np.pi * diameter_m**2, rel=0.005
        )
        assert np.abs(rock[:, :2].mean(axis=0)).max() < 0.1 * diameter_m
        assert 0.35 * diameter_m - 1e-9 <= rock[:, 2].max() <= 0.75 * diameter_m + 1e-9
        assert rock[:, 2].min() < 0.0
    assert FACES.max() < vertices.shape[1]


def test_no_rock_overlaps_another_or_the_middle() -> None:
    terrain = rough_terrain(replace(ROUGH, size_m=16.0, clearing_m=2.0), np.random.default_rng(3))
    places, radii_m = terrain.world_t_rocks, 0.5 * terrain.diameters_m
    assert len(places) > 100
    gaps_m = np.linalg.norm(places[:, None] - places[None], axis=2) - radii_m[:, None] - radii_m
    np.fill_diagonal(gaps_m, 1.0)
    assert gaps_m.min() > 0.0
    assert (np.linalg.norm(places, axis=1) - radii_m).min() > 2.0


@pytest.mark.parametrize("theta", [0.0, 0.7, np.pi / 2, -2.5])
def test_a_vehicle_rests_on_a_slope(theta: float) -> None:
    """Its axes, turned by the tilt, lie in the plane."""
    height_m, tilt = _inclined().rest(Pose2(1.0, 0.5, theta))
    assert height_m == pytest.approx(SLOPE[0] * 1.0 + SLOPE[1] * 0.5, abs=1e-9)
    c, s = np.cos(theta), np.sin(theta)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ tilt.level_R_base()
    normal = np.array([-SLOPE[0], -SLOPE[1], 1.0])
    np.testing.assert_allclose(axes[:, 2], normal / np.linalg.norm(normal), atol=1e-9)


def test_heights_between_and_beyond_the_grid() -> None:
    terrain = _inclined()
    points = np.array([[0.0, 0.0], [1.23, -0.77], [100.0, 0.0]])
    np.testing.assert_allclose(terrain.heights_at(points), [0.0, 0.277, 0.5], atol=1e-9)


def test_the_meshes_are_the_terrain() -> None:
    terrain = rough_terrain(replace(SMOOTH, size_m=8.0), np.random.default_rng(4))
    vertices, triangles = terrain.ground_mesh()
    np.testing.assert_allclose(terrain.heights_at(vertices[:, :2]), vertices[:, 2], atol=1e-9)
    assert len(triangles) == 2 * (len(terrain.heights_m) - 1) ** 2
    vertices, triangles = terrain.rock_mesh()
    last = vertices[triangles[-len(FACES) :].ravel()]
    assert np.linalg.norm(last[:, :2] - terrain.world_t_rocks[-1], axis=1).max() < 0.2


@pytest.mark.parametrize(
    "wrong",
    [
        {"size_m": 2.0},
        {"cell_m": 0.2},
        {"rock_share": 0.7},
        {"rock_diameters_m": (0.5, 0.2)},
        {"deviation_m": -1.0},
        {"cell_m": float("nan")},
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="terrain: expected"):
        replace(MEDIUM, **wrong)


def test_too_many_rocks_are_refused() -> None:
    crowded = replace(MEDIUM, size_m=8.0, rock_share=0.45, rock_diameters_m=(1.0, 3.0))
    with pytest.raises(InputError, match="take a smaller rock_share"):
        rough_terrain(replace(crowded, clearing_m=4.0), np.random.default_rng(0))
