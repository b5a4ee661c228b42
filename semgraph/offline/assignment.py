"""The cheapest pairing of rows and columns of which only few can be pairs."""

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray


def one_to_one(rows: IntArray, columns: IntArray, costs: FloatArray, limit: float) -> BoolArray:
    """(p,) which of the pairs hold: each row and column in at most one, the total the least.

    Args:
        rows: (p,) numbers from 0 on.
        columns: (p,) as well; no pair twice.
        costs: (p,) of each pair.
        limit: what a row without a pair costs; no pair that costs more holds.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    holds = np.zeros(len(rows), dtype=np.bool_)
    possible = np.flatnonzero(costs <= limit)
    if not len(possible):
        return holds
    best = possible[np.lexsort((costs[possible], rows[possible]))]
    best = best[np.unique(rows[best], return_index=True)[1]]
    holds[best] = True
    taken, counts = np.unique(columns[best], return_counts=True)
    contested = np.isin(columns, taken[counts > 1])
    if not contested.any():
        return holds
    num_rows = int(rows.max()) + 1
    size = num_rows + int(columns.max()) + 1
    links = (np.ones(len(possible)), (rows[possible], num_rows + columns[possible]))
    _, group_of = connected_components(csr_matrix(links, shape=(size, size)), directed=False)
    groups = group_of[rows[possible]]
    disputed = np.unique(group_of[rows[contested & (costs <= limit)]])
    order = possible[np.argsort(groups, kind="stable")]
    groups = np.sort(groups)
    for group in disputed.tolist():
        start, end = np.searchsorted(groups, [group, group + 1])
        pairs = order[start:end]
        holds[pairs] = _cheapest(rows[pairs], columns[pairs], costs[pairs], limit)
    return holds


def _cheapest(rows: IntArray, columns: IntArray, costs: FloatArray, limit: float) -> BoolArray:
    """As `one_to_one`, for a few pairs: a matrix with a column of its own for each row."""
    from scipy.optimize import linear_sum_assignment

    names, row = np.unique(rows, return_inverse=True)
    others, column = np.unique(columns, return_inverse=True)
    matrix = np.full((len(names), len(others) + len(names)), limit)
    matrix[:, : len(others)] = 2.0 * limit + 1.0
    matrix[row, column] = costs
    chosen = linear_sum_assignment(matrix)[1]
    return np.asarray(chosen[row] == column)
