"""Simulated worlds: seeded, no overlaps, refused when they make no sense."""

import numpy as np
import pytest

from semgraph.errors import InputError
from sensors.simulation.world import (
    FOREST,
    PARKLAND,
    StandSettings,
    Thing,
    World,
    stand_of_trees,
)


def test_the_same_seed_gives_the_same_stand() -> None:
    one, two = (stand_of_trees(np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one.world_t_things, two.world_t_things)
    np.testing.assert_array_equal(one.radii_m, two.radii_m)


@pytest.mark.parametrize("settings", [FOREST, PARKLAND, StandSettings(stems_per_ha=1000.0)])
@pytest.mark.parametrize("seed", range(5))
def test_a_stand_is_as_asked_for(settings: StandSettings, seed: int) -> None:
    world = stand_of_trees(np.random.default_rng(seed), settings)
    stems = world.things == Thing.STEM
    hectares = np.pi * settings.radius_m**2 / 1e4
    expected = settings.stems_per_ha * hectares
    assert abs(stems.sum() - expected) < 5.0 * np.sqrt(expected) + 0.05 * expected
    low, high = settings.diameter_limits_m
    assert ((2 * world.radii_m[stems] >= low) & (2 * world.radii_m[stems] <= high)).all()
    distances = np.linalg.norm(world.world_t_things, axis=1)
    assert (distances <= settings.radius_m + settings.clump_radius_m).all()


@pytest.mark.parametrize("seed", range(5))
def test_trunks_keep_their_distance(seed: int) -> None:
    world = stand_of_trees(np.random.default_rng(seed), StandSettings(stems_per_ha=1000.0))
    trunks = world.things != Thing.CLUTTER
    centres, radii_m = world.world_t_things[trunks], world.radii_m[trunks]
    gaps_m = np.linalg.norm(centres[:, None] - centres, axis=2) - radii_m[:, None] - radii_m
    np.fill_diagonal(gaps_m, np.inf)
    assert gaps_m.min() >= FOREST.min_gap_m


def test_reflectors_are_brighter_than_white() -> None:
    rng = np.random.default_rng(0)
    assert (World.of(Thing.REFLECTOR, np.ones((3, 2)), np.ones(3), rng).reflectivities > 1.0).all()
    assert (World.of(Thing.STEM, np.ones((3, 2)), np.ones(3), rng).reflectivities < 1.0).all()


@pytest.mark.parametrize("radius_m", [0.0, -0.1, np.nan])
def test_a_radius_that_is_none_is_refused(radius_m: float) -> None:
    with pytest.raises(InputError, match="world"):
        World(np.zeros((1, 2)), np.array([radius_m]), np.zeros(1, int), np.ones(1))
