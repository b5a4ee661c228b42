"""Stands of real trees, from tables x,y,mark of positions and diameters."""

from enum import Enum
from pathlib import Path
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from sensors.simulation.world import Thing, World
from sensors.text_table import TextTable

_MAX_STEMS: Final = 20_000
_LARGEST_M: Final = 1e4
_DIAMETERS_M: Final = (0.01, 3.0)


class MarkUnit(Enum):
    """In what a stem map gives diameters."""

    CM = "cm"
    M = "m"

    @property
    def metres(self) -> float:
        """One of it in m."""
        return 0.01 if self is MarkUnit.CM else 1.0


def stand_from_stem_map(file: Path, unit: MarkUnit, rng: np.random.Generator) -> World:
    """Stems about the middle of the map; of two that overlap the smaller is left out.

    Raises:
        InputError: unreadable, a number out of its domain, diameters that are none of a tree in
            this unit, or more than 20,000 stems.
    """
    table = TextTable.of_csv(file, ("x", "y", "mark"))
    if not 0 < len(table) <= _MAX_STEMS:
        raise InputError(f"{file}: expected 1 to {_MAX_STEMS} stems, got {len(table)}")
    positions = np.column_stack(
        [table.numbers(name, above=-_LARGEST_M, at_most=_LARGEST_M) for name in ("x", "y")]
    )
    diameters_m = unit.metres * table.numbers("mark")
    low, high = _DIAMETERS_M
    table.refuse(
        ~((diameters_m >= low) & (diameters_m <= high)),
        "mark",
        f"a diameter of {low:g} to {high:g} m in {unit.value} (choose mark_unit)",
    )
    middle = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    stems = World.of(Thing.STEM, positions - middle, diameters_m, rng)
    return _without_overlaps(stems)


def _without_overlaps(stems: World) -> World:
    from scipy.spatial import KDTree

    largest_first = stems.select(np.argsort(-stems.radii_m, kind="stable"))
    positions, radii_m = largest_first.world_t_things, largest_first.radii_m
    pairs = KDTree(positions).query_pairs(2.0 * float(radii_m.max()), output_type="ndarray")
    gaps_m: FloatArray = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
    overlap = gaps_m <= radii_m[pairs[:, 0]] + radii_m[pairs[:, 1]]
    kept = np.ones(len(radii_m), dtype=np.bool_)
    kept[pairs[overlap].max(axis=1)] = False
    return largest_first.select(kept)
