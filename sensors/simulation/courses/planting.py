"""How trees that were planted at random stand apart, and how thick they are."""

from typing import Final

import numpy as np

from semgraph.arrays import FloatArray

_TRUNK_MEDIAN_M: Final = 0.28
_TRUNK_LOG_SIGMA: Final = 0.35
_TRUNKS_M: Final = (0.08, 0.75)
_LEAST_SPACING_M: Final = 0.8
BORDER_M: Final = 0.5 * _LEAST_SPACING_M


def apart(trees: FloatArray) -> FloatArray:
    """Of trees (m, 2) those that keep their distance to every earlier one."""
    from scipy.spatial import KDTree

    pairs = KDTree(trees).query_pairs(_LEAST_SPACING_M, output_type="ndarray")
    kept = np.ones(len(trees), dtype=np.bool_)
    kept[pairs.max(axis=1)] = False
    return trees[kept]


def most_that_fit(area_m2: float) -> int:
    """How many trees no area can hold more of: each has a circle of half the least spacing alone.

    Args:
        area_m2: of the area with `BORDER_M` around it.
    """
    return int(area_m2 / (np.pi * BORDER_M**2))


def trunk_diameters_m(count: int, rng: np.random.Generator) -> FloatArray:
    """(count,) of a mixed stand."""
    diameters_m = _TRUNK_MEDIAN_M * np.exp(_TRUNK_LOG_SIGMA * rng.standard_normal(count))
    return np.clip(diameters_m, *_TRUNKS_M)
