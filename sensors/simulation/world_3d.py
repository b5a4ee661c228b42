"""Simulated woods in three dimensions: trunks, saplings and understorey over level ground."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from sensors.simulation.world import FOREST, StandSettings, Thing, World, stand_of_trees


@dataclass(frozen=True, slots=True, eq=False)
class World3d:
    """Cylinders, upright or leaning, as a structure of arrays; the ground is z = 0.

    Each horizontal section is a circle about `world_t_feet + leans * z`.

    Attributes:
        world_t_feet: (n, 2) m, where the axis meets the ground.
        leans: (n, 2) m per m of height.
        radii_m: (n,) > 0.
        bottoms_m, tops_m: (n,) heights, bottom below top.
        things: (n,) codes of `Thing`.

    Raises:
        InputError: shapes disagree, a radius is not above 0, or a top not above its bottom.
    """

    world_t_feet: FloatArray
    leans: FloatArray
    radii_m: FloatArray
    bottoms_m: FloatArray
    tops_m: FloatArray
    things: IntArray

    def __post_init__(self) -> None:
        n = len(self.radii_m)
        for name, shape in (
            ("world_t_feet", (n, 2)),
            ("leans", (n, 2)),
            ("radii_m", (n,)),
            ("bottoms_m", (n,)),
            ("tops_m", (n,)),
        ):
            value = frozen_floats(f"world {name}", getattr(self, name), shape)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "things", frozen_ints("world things", self.things, (n,)))
        if not ((self.radii_m > 0.0).all() and (self.tops_m > self.bottoms_m).all()):
            raise InputError("world: expected radii above 0 and tops above their bottoms")

    def __len__(self) -> int:
        return len(self.radii_m)

    def centres_at(self, height_m: float) -> FloatArray:
        """(n, 2) m, of the sections at a height."""
        return self.world_t_feet + self.leans * height_m

    def select(self, rows: BoolArray) -> "World3d":
        """The things of a mask."""
        return World3d(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def union(cls, parts: Sequence["World3d"]) -> Self:
        """All things of several worlds, in their order."""
        return cls(
            *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls))
        )


@dataclass(frozen=True, slots=True)
class UnderstoreySettings:
    """What turns a stand in the plane into one in three dimensions.

    Attributes:
        lean_sigma: of a trunk, along each axis, m per m.
        tops_m: of stems, lowest and highest; what is above matters to no ground vehicle.
        sapling_tops_m: of saplings.
        twig_lean: of the twigs of a bush, m per m, at most.
        bush_tops_m: of bushes.
    """

    lean_sigma: float = 0.03
    tops_m: tuple[float, float] = (5.0, 12.0)
    sapling_tops_m: tuple[float, float] = (1.5, 4.0)
    twig_lean: float = 0.6
    bush_tops_m: tuple[float, float] = (0.4, 1.8)


UNDERSTOREY = UnderstoreySettings()


def stand_in_3d(
    rng: np.random.Generator,
    stand: StandSettings = FOREST,
    understorey: UnderstoreySettings = UNDERSTOREY,
) -> World3d:
    """A round stand about the origin: leaning stems and saplings, and bushes of slanted twigs."""
    return raise_up(stand_of_trees(rng, stand), rng, understorey)


def raise_up(
    world: World, rng: np.random.Generator, understorey: UnderstoreySettings = UNDERSTOREY
) -> World3d:
    """The world in the plane with heights and leans; rows stay the same."""
    n = len(world)
    is_twig = world.things == Thing.CLUTTER
    is_sapling = world.things == Thing.SAPLING
    leans = understorey.lean_sigma * rng.standard_normal((n, 2))
    leans[is_twig] = rng.uniform(-1.0, 1.0, (is_twig.sum(), 2)) * understorey.twig_lean
    tops_m = rng.uniform(*understorey.tops_m, n)
    tops_m[is_sapling] = rng.uniform(*understorey.sapling_tops_m, is_sapling.sum())
    tops_m[is_twig] = rng.uniform(*understorey.bush_tops_m, is_twig.sum())
    return World3d(world.world_t_things, leans, world.radii_m, np.zeros(n), tops_m, world.things)
