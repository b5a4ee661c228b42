"""Sections of trunks linked to trunks, and an axis through each."""

from dataclasses import dataclass

import numpy as np

from detectors.tree_3d_settings import Tree3dSettings
from semgraph.arrays import FloatArray, IntArray

NUM_ITERATIONS = 4
_CAUCHY = 2.5
_FLOOR_M = 0.003
# The variance of a median is that of a mean times pi / 2.
_OF_MEDIAN = 0.5 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Sections:
    """Circles that rings cut out of trunks (n of them), in the level frame of base.

    Attributes:
        level_t_centres: (n, 3) m.
        covariances: (n, 2, 2) m2 of x and y.
        diameters_m, diameter_sigmas_m, reliabilities: (n,).
        rings: (n,).
    """

    level_t_centres: FloatArray
    covariances: FloatArray
    diameters_m: FloatArray
    diameter_sigmas_m: FloatArray
    reliabilities: FloatArray
    rings: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Axes:
    """Trunks (k of them), in the level frame of base.

    Attributes:
        base_t_centres: (k, 2) m at the reference height.
        covariances: (k, 2, 2) m2.
        diameters_m, diameter_sigmas_m, reliabilities: (k,).
    """

    base_t_centres: FloatArray
    covariances: FloatArray
    diameters_m: FloatArray
    diameter_sigmas_m: FloatArray
    reliabilities: FloatArray


def fit_axes(sections: Sections, settings: Tree3dSettings) -> Axes | None:
    """A straight axis through the linked sections of each trunk; None where there is no trunk.

    Weighted least squares for the centre at the reference height and the lean, which is small
    beforehand; sections far off the axis lose their weight. Neighbouring sections err alike (the
    same columns meet the same edges), so n of them count as n / (1 + correlation (n - 1)).
    """
    labels, counts = _linked(sections, settings)
    k = len(counts)
    if not k:
        return None
    kept = labels >= 0
    labels = labels[kept]
    heights_m = sections.level_t_centres[kept, 2] - settings.reference_height_m
    xy_m = sections.level_t_centres[kept, :2]
    shared = 1.0 + settings.row_correlation * (counts - 1.0)
    information = np.linalg.inv(sections.covariances[kept]) / shared[labels, None, None]
    prior = np.diag([0.0, 0.0, settings.lean_sigma**-2, settings.lean_sigma**-2])
    weights = np.ones(len(labels))
    for _ in range(NUM_ITERATIONS):
        normal, right = _normal_equations(
            labels, k, heights_m, xy_m, weights[:, None, None] * information
        )
        state = np.linalg.solve(normal + prior, right[:, :, None])[:, :, 0]
        residuals = xy_m - state[labels, :2] - heights_m[:, None] * state[labels, 2:]
        squares = np.einsum("ni,nij,nj->n", residuals, information, residuals) * shared[labels]
        weights = 1.0 / (1.0 + squares / _CAUCHY**2)
    covariances = np.linalg.inv(normal + prior)[:, :2, :2] + _FLOOR_M**2 * np.eye(2)
    diameters_m = _medians(labels, sections.diameters_m[kept], counts)
    variances = np.bincount(labels, sections.diameter_sigmas_m[kept] ** 2) / counts
    return Axes(
        state[:, :2],
        covariances,
        diameters_m,
        np.sqrt(variances * shared / counts * np.minimum(_OF_MEDIAN, counts) + _FLOOR_M**2),
        _reliabilities(labels, counts, sections.reliabilities[kept], squares),
    )


def _linked(sections: Sections, settings: Tree3dSettings) -> tuple[IntArray, FloatArray]:
    """(n,) trunk of each section, -1 for none, and how many sections each trunk has."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    n = len(sections.rings)
    places = sections.level_t_centres * (1.0, 1.0, 0.25)
    pairs = KDTree(places).query_pairs(settings.link_m, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n))
    num, labels = connected_components(graph, directed=False)
    # Rows are rings: two sections of one ring are one row.
    rows = np.unique(np.column_stack([labels, sections.rings]), axis=0)
    num_rows = np.bincount(rows[:, 0], minlength=num)
    lowest, highest = np.full(num, np.inf), np.full(num, -np.inf)
    np.minimum.at(lowest, labels, sections.level_t_centres[:, 2])
    np.maximum.at(highest, labels, sections.level_t_centres[:, 2])
    is_trunk = (num_rows >= settings.min_rows) & (highest - lowest >= settings.min_height_m)
    new = np.where(is_trunk, np.cumsum(is_trunk) - 1, -1)
    counts = np.bincount(labels, minlength=num)[is_trunk].astype(np.float64)
    return new[labels], counts


def _normal_equations(
    labels: IntArray, k: int, heights_m: FloatArray, xy_m: FloatArray, information: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(k, 4, 4) and (k, 4) of (x, y, lean x, lean y) for each trunk."""
    design = np.stack([np.ones_like(heights_m), heights_m], axis=1)
    blocks = np.einsum("na,nb,nij->naibj", design, design, information).reshape(-1, 4, 4)
    normal = np.zeros((k, 4, 4))
    np.add.at(normal, labels, blocks)
    weighted = np.einsum("nij,nj->ni", information, xy_m)
    right = np.zeros((k, 4))
    np.add.at(right, labels, np.einsum("na,ni->nai", design, weighted).reshape(-1, 4))
    return normal, right


def _medians(labels: IntArray, values: FloatArray, counts: FloatArray) -> FloatArray:
    """(k,) of each trunk."""
    ordered = values[np.lexsort([values, labels])]
    starts = (np.cumsum(counts) - counts).astype(np.int64)
    low, high = ((counts - 1) // 2).astype(np.int64), (counts // 2).astype(np.int64)
    return np.asarray(0.5 * (ordered[starts + low] + ordered[starts + high]))


def _reliabilities(
    labels: IntArray, counts: FloatArray, reliabilities: FloatArray, squares: FloatArray
) -> FloatArray:
    """(k,) in [0, 1]."""
    means = np.bincount(labels, reliabilities) / counts
    return np.clip(means, 0.0, 1.0)
