"""Who of two groups of things is nearest to whom."""

import numpy as np

from semgraph.arrays import FloatArray, IntArray


def nearest_to_each_other(
    places: FloatArray, kinds: IntArray, other_places: FloatArray, other_kinds: IntArray
) -> tuple[IntArray, IntArray]:
    """(k,) rows of each group: pairs of one kind of which each is the nearest to the other.

    Args:
        places: (n, 2) m.
        kinds: (n,) codes of `Kind`.
        other_places: (m, 2) m, in the same frame.
        other_kinds: (m,).
    """
    from scipy.spatial import KDTree

    pairs = np.zeros((0, 2), dtype=np.int64)
    for kind in np.intersect1d(kinds, other_kinds).tolist():
        rows, others = np.flatnonzero(kinds == kind), np.flatnonzero(other_kinds == kind)
        trees = KDTree(places[rows]), KDTree(other_places[others])
        nearest = trees[1].query(trees[0].data)[1]
        is_mutual = trees[0].query(trees[1].data)[1][nearest] == np.arange(len(rows))
        both = np.column_stack([rows[is_mutual], others[nearest[is_mutual]]])
        pairs = np.concatenate([pairs, both])
    return pairs[:, 0], pairs[:, 1]
