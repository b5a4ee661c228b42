"""Sections of trunks linked to trunks, and an axis through each."""

from dataclasses import dataclass

import numpy as np

from detectors.tree_3d_settings import Tree3dSettings
from semgraph.arrays import BoolArray, FloatArray, IntArray

NUM_ITERATIONS = 4
_CAUCHY = 2.5
_FLOOR_M = 0.003
# The variance of a median is that of a mean times pi / 2.
_OF_MEDIAN = 0.5 * np.pi
# Logistic regression on simulated woods, 16 and 64 rings; stems and saplings count as trunks.
_WEIGHTS = np.array([-8.607, 4.686, 4.301, -1.679])


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

    def select(self, kept: BoolArray) -> "Sections":
        """The sections of a mask."""
        return Sections(*(getattr(self, name)[kept] for name in Sections.__slots__))


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

    What hides the middle of a trunk leaves two pieces, each with an axis; where these meet between
    the pieces, they are one trunk.
    """
    labels = _linked(sections, settings)
    sections, labels = sections.select(labels >= 0), labels[labels >= 0]
    if not len(labels):
        return None
    labels = _joined(sections, labels, _fitted(sections, labels, settings), settings)
    lines = _fitted(sections, labels, settings)
    counts = np.bincount(labels)
    diameters_m = _medians(labels, sections.diameters_m, counts)
    variances = np.bincount(labels, sections.diameter_sigmas_m**2) / counts
    shared = _shared(counts, settings) / counts
    return Axes(
        lines.states[:, :2],
        lines.covariances + _FLOOR_M**2 * np.eye(2),
        diameters_m,
        np.sqrt(variances * shared * np.minimum(_OF_MEDIAN, counts) + _FLOOR_M**2),
        _reliabilities(labels, sections.reliabilities, lines.squares),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Axes (k, 4): centre at the reference height and lean; (n,) squared misfit of each section."""

    states: FloatArray
    covariances: FloatArray
    squares: FloatArray

    def centres_at(self, above_m: FloatArray) -> FloatArray:
        """(..., k, 2) at heights (..., k) above the reference."""
        return np.asarray(self.states[:, :2] + above_m[..., None] * self.states[:, 2:])


def _shared(counts: IntArray, settings: Tree3dSettings) -> FloatArray:
    """By how much n sections count less than n times: 1 + correlation (n - 1).

    Neighbouring sections err alike, as the same columns meet the same edges.
    """
    return np.asarray(1.0 + settings.row_correlation * (counts - 1.0))


def _fitted(sections: Sections, labels: IntArray, settings: Tree3dSettings) -> _Lines:
    """Weighted least squares for centre and lean, which is small beforehand.

    Sections far off the axis lose their weight.
    """
    counts = np.bincount(labels)
    heights_m = sections.level_t_centres[:, 2] - settings.reference_height_m
    xy_m = sections.level_t_centres[:, :2]
    shared = _shared(counts, settings)[labels]
    information = np.linalg.inv(sections.covariances) / shared[:, None, None]
    prior = np.diag([0.0, 0.0, settings.lean_sigma**-2, settings.lean_sigma**-2])
    weights = np.ones(len(labels))
    for _ in range(NUM_ITERATIONS):
        normal, right = _normal_equations(
            labels, len(counts), heights_m, xy_m, weights[:, None, None] * information
        )
        states = np.linalg.solve(normal + prior, right[:, :, None])[:, :, 0]
        residuals = xy_m - states[labels, :2] - heights_m[:, None] * states[labels, 2:]
        squares = np.einsum("ni,nij,nj->n", residuals, information, residuals) * shared
        weights = 1.0 / (1.0 + squares / _CAUCHY**2)
    return _Lines(states, np.linalg.inv(normal + prior)[:, :2, :2], squares)


def _joined(
    sections: Sections, labels: IntArray, lines: _Lines, settings: Tree3dSettings
) -> IntArray:
    """(n,) the trunk of each section, pieces of one trunk put together."""
    from scipy.sparse.csgraph import connected_components

    heights_m = sections.level_t_centres[:, 2] - settings.reference_height_m
    middles_m = np.bincount(labels, heights_m) / np.bincount(labels)
    between_m = 0.5 * (middles_m[:, None] + middles_m)
    centres = lines.centres_at(between_m)
    apart_m = np.linalg.norm(centres - centres.transpose(1, 0, 2), axis=2)
    _, trunks = connected_components(apart_m < settings.link_m, directed=False)
    return np.asarray(trunks[labels], dtype=np.int64)


def _linked(sections: Sections, settings: Tree3dSettings) -> IntArray:
    """(n,) trunk of each section, -1 for none."""
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
    return np.asarray(new[labels], dtype=np.int64)


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


def _medians(labels: IntArray, values: FloatArray, counts: IntArray) -> FloatArray:
    """(k,) of each trunk."""
    ordered = values[np.lexsort([values, labels])]
    starts = np.cumsum(counts) - counts
    low, high = starts + (counts - 1) // 2, starts + counts // 2
    return np.asarray(0.5 * (ordered[low] + ordered[high]))


def _reliabilities(labels: IntArray, reliabilities: FloatArray, squares: FloatArray) -> FloatArray:
    """(k,) in [0, 1], calibrated on simulated woods.

    It speaks of the number of sections, their own mean reliability, and how straight they lie.
    """
    counts = np.bincount(labels)
    means = np.bincount(labels, reliabilities) / counts
    misfits = np.bincount(labels, np.minimum(squares, 25.0)) / counts
    score = _WEIGHTS @ np.stack(
        [np.ones(len(counts)), np.log(counts), means, np.log(misfits + 0.1)]
    )
    return np.asarray(1.0 / (1.0 + np.exp(-score)))
