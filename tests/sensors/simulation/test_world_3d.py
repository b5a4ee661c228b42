"""Simulated woods in three dimensions."""

import numpy as np
import pytest

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from sensors.simulation.world import Thing, stand_of_trees
from sensors.simulation.world_3d import World3d, raise_up, stand_in_3d


def _trunk() -> World3d:
    return World3d(
        np.array([[1.0, 2.0]]),
        np.array([[0.1, -0.2]]),
        np.array([0.2]),
        np.zeros(1),
        np.full(1, 6.0),
        np.full(1, Thing.STEM),
    )


def test_a_leaning_trunk_stands_elsewhere_higher_up() -> None:
    np.testing.assert_allclose(_trunk().centres_at(0.0), [[1.0, 2.0]])
    np.testing.assert_allclose(_trunk().centres_at(2.0), [[1.2, 1.6]])


def test_raising_a_world_keeps_its_rows() -> None:
    flat = stand_of_trees(np.random.default_rng(4))
    world = raise_up(flat, np.random.default_rng(5))
    np.testing.assert_array_equal(world.world_t_feet, flat.world_t_things)
    np.testing.assert_array_equal(world.radii_m, flat.radii_m)
    np.testing.assert_array_equal(world.things, flat.things)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("radii_m", np.zeros(1), "radii above 0"),
        ("tops_m", np.zeros(1), "tops above their bottoms"),
        ("leans", np.zeros((2, 2)), "world leans: expected shape"),
        ("world_t_feet", np.full((1, 2), np.nan), "finite"),
    ],
)
def test_a_world_that_cannot_be_is_refused(field: str, value: FloatArray, said: str) -> None:
    good = {name: getattr(_trunk(), name) for name in World3d.__slots__}
    with pytest.raises(InputError, match=said):
        World3d(**(good | {field: value}))


def test_a_stand_has_leaning_stems_and_low_bushes() -> None:
    world = stand_in_3d(np.random.default_rng(5))
    stems, twigs = world.things == Thing.STEM, world.things == Thing.CLUTTER
    assert world.leans[stems].std() == pytest.approx(0.03, rel=0.15)
    assert world.tops_m[stems].min() >= 5.0
    assert world.tops_m[twigs].max() <= 1.8
    assert len(World3d.union([world, world])) == 2 * len(world)
