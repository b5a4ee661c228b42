"""Ways that touch nothing."""

import numpy as np
import pytest

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from sensors.simulation.courses.free_way import Obstacles, free_way
from sensors.simulation.world import StandSettings, stand_of_trees


def gaps_m(obstacles: Obstacles, points: FloatArray) -> FloatArray:
    """By every pair."""
    distances_m = np.linalg.norm(points[:, None] - obstacles.world_t_obstacles[None], axis=2)
    return np.asarray((distances_m - obstacles.radii_m).min(axis=1))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("stems_per_ha", [400.0, 1000.0])
def test_a_way_keeps_its_width_and_goes_round_once(seed: int, stems_per_ha: float) -> None:
    rng = np.random.default_rng(seed)
    stand = stand_of_trees(rng, StandSettings(stems_per_ha=stems_per_ha, radius_m=25.0))
    obstacles = Obstacles(stand.world_t_things, stand.radii_m)
    track = free_way(obstacles, 12.0, 0.5, rng)
    points = track.poses(np.arange(0.0, track.length_m, 0.05))[:, :2]
    assert gaps_m(obstacles, points).min() > 0.49
    angles = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
    assert angles[-1] - angles[0] == pytest.approx(2.0 * np.pi, abs=0.02)
    assert (np.diff(angles) > 0.0).all()


def test_without_obstacles_it_winds_about_the_circle() -> None:
    nothing = Obstacles(np.zeros((0, 2)), np.zeros(0))
    track = free_way(nothing, 10.0, 0.5, np.random.default_rng(0))
    radii_m = np.hypot(*track.poses(np.arange(0.0, track.length_m, 0.1))[:, :2].T)
    assert radii_m.mean() == pytest.approx(10.0, abs=0.5)
    assert 0.5 < radii_m.std() < 3.0


def test_a_closed_wall_is_refused() -> None:
    along = np.arange(2.0, 20.0, 0.5)
    wall = Obstacles(np.column_stack([along, np.zeros(len(along))]), np.full(len(along), 0.2))
    with pytest.raises(InputError, match="found no way 1 m wide") as refusal:
        free_way(wall, 10.0, 0.5, np.random.default_rng(0))
    assert "\n" not in str(refusal.value)
