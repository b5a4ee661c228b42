"""Simulated worlds for a plane of laser light: round things that stand upright."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Self

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError

BARK_REFLECTIVITY = (0.25, 0.6)
RETROREFLECTIVITY = 20.0


class Thing(IntEnum):
    """What stands in a simulated world."""

    STEM = 0
    SAPLING = 1
    CLUTTER = 2
    REFLECTOR = 3
    PERSON = 4


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Upright cylinders, as a structure of arrays.

    Attributes:
        world_t_things: (n, 2) m, the centres.
        radii_m: (n,) > 0.
        things: (n,) codes of `Thing`.
        reflectivities: (n,) > 0, of the light that a white surface gives back; above 1 for
            retroreflectors.

    Raises:
        InputError: shapes disagree, or a radius or reflectivity is not above 0.
    """

    world_t_things: FloatArray
    radii_m: FloatArray
    things: IntArray
    reflectivities: FloatArray

    def __post_init__(self) -> None:
        n = len(self.radii_m)
        checked = {
            "world_t_things": frozen_floats("world positions", self.world_t_things, (n, 2)),
            "radii_m": frozen_floats("world radii", self.radii_m, (n,)),
            "things": frozen_ints("world things", self.things, (n,)),
            "reflectivities": frozen_floats("world reflectivities", self.reflectivities, (n,)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if not ((self.radii_m > 0.0).all() and (self.reflectivities > 0.0).all()):
            raise InputError("world: expected radii and reflectivities above 0")

    def __len__(self) -> int:
        return len(self.radii_m)

    @classmethod
    def of(
        cls,
        thing: Thing,
        world_t_things: FloatArray,
        diameters_m: FloatArray,
        rng: np.random.Generator,
    ) -> Self:
        """A world of one sort of thing; bark and cloth differ in how bright they are."""
        n = len(diameters_m)
        reflectivities = (
            np.full(n, RETROREFLECTIVITY)
            if thing is Thing.REFLECTOR
            else rng.uniform(*BARK_REFLECTIVITY, n)
        )
        return cls(world_t_things, diameters_m / 2.0, np.full(n, thing), reflectivities)

    def select(self, rows: IntArray | BoolArray) -> "World":
        """The things of these rows."""
        return World(*(getattr(self, f.name)[rows] for f in fields(self)))

    @classmethod
    def union(cls, parts: Sequence["World"]) -> Self:
        """All things of several worlds, in their order."""
        return cls(
            *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls))
        )


@dataclass(frozen=True, slots=True)
class StandSettings:
    """What a stand of trees is made of. Diameters are log-normal, cut off at both ends."""

    stems_per_ha: float = 600.0
    radius_m: float = 40.0
    median_diameter_m: float = 0.25
    diameter_spread: float = 0.4
    diameter_limits_m: tuple[float, float] = (0.1, 0.6)
    min_gap_m: float = 0.4
    clearing_m: float = 0.5
    saplings_per_stem: float = 0.25
    sapling_diameters_m: tuple[float, float] = (0.02, 0.07)
    clumps_per_stem: float = 0.1
    twigs_per_clump: tuple[int, int] = (4, 10)
    twig_diameters_m: tuple[float, float] = (0.005, 0.03)
    clump_radius_m: float = 0.25


FOREST = StandSettings()
PARKLAND = StandSettings(
    stems_per_ha=50.0,
    median_diameter_m=0.4,
    diameter_limits_m=(0.15, 0.7),
    saplings_per_stem=0.1,
    clumps_per_stem=0.1,
)


def stand_of_trees(rng: np.random.Generator, settings: StandSettings = FOREST) -> World:
    """A round stand about the origin: stems, saplings, and clumps of twigs as clutter."""
    hectares = np.pi * settings.radius_m**2 / 1e4
    num_stems = int(rng.poisson(settings.stems_per_ha * hectares))
    num_saplings = int(rng.poisson(settings.saplings_per_stem * num_stems))
    num_clumps = int(rng.poisson(settings.clumps_per_stem * num_stems))
    stem_diameters = np.clip(
        settings.median_diameter_m * np.exp(settings.diameter_spread * rng.normal(size=num_stems)),
        *settings.diameter_limits_m,
    )
    sapling_diameters = rng.uniform(*settings.sapling_diameters_m, num_saplings)
    radii = np.concatenate(
        [stem_diameters / 2, sapling_diameters / 2, np.full(num_clumps, settings.clump_radius_m)]
    )
    positions, placed = _spread_out(rng, radii, settings)
    stems, saplings, clumps = np.split(np.arange(len(radii)), [num_stems, num_stems + num_saplings])
    stems, saplings, clumps = (part[placed[part]] for part in (stems, saplings, clumps))
    return World.union(
        [
            World.of(Thing.STEM, positions[stems], 2 * radii[stems], rng),
            World.of(Thing.SAPLING, positions[saplings], 2 * radii[saplings], rng),
            _twigs(rng, positions[clumps], settings),
        ]
    )


def kept_free(world: World, world_t_places: FloatArray, distance_m: float) -> World:
    """The things whose surface keeps its distance to all of the places (k, 2)."""
    from scipy.spatial import KDTree

    nearest_m, _ = KDTree(world_t_places).query(world.world_t_things)
    return world.select(np.flatnonzero(nearest_m > distance_m + world.radii_m))


def _spread_out(
    rng: np.random.Generator, radii_m: FloatArray, settings: StandSettings
) -> tuple[FloatArray, IntArray]:
    """Random places (n, 2) that keep the gap, and (n,) 1 where one was found in ten tries."""
    positions = np.zeros((len(radii_m), 2))
    placed = np.zeros(len(radii_m), dtype=bool)
    for k, radius_m in enumerate(radii_m):
        tries = _in_ring(rng, 10, settings.clearing_m + radius_m, settings.radius_m)
        distances = np.linalg.norm(tries[:, None] - positions[None, placed], axis=2)
        free = (distances > radius_m + radii_m[placed] + settings.min_gap_m).all(axis=1)
        placed[k] = free.any()
        positions[k] = tries[free.argmax()]
    return positions, placed


def _in_ring(rng: np.random.Generator, n: int, inner_m: float, outer_m: float) -> FloatArray:
    """(n, 2) evenly spread points between two circles about the origin."""
    distances = np.sqrt(rng.uniform(inner_m**2, outer_m**2, n))
    angles = rng.uniform(-np.pi, np.pi, n)
    return np.column_stack([distances * np.cos(angles), distances * np.sin(angles)])


def _twigs(rng: np.random.Generator, clumps: FloatArray, settings: StandSettings) -> World:
    low, high = settings.twigs_per_clump
    centres = np.repeat(clumps, rng.integers(low, high + 1, len(clumps)), axis=0)
    diameters_m = rng.uniform(*settings.twig_diameters_m, len(centres))
    reach_m = settings.clump_radius_m
    return World.of(
        Thing.CLUTTER, centres + _in_ring(rng, len(centres), 0.0, reach_m), diameters_m, rng
    )
