"""Those elements of a sparse matrix's inverse that lie where its factor has some, or are asked for.

All marginals, and those of variables that a factor joins, in time that grows as the factor does;
column by column it would grow as the square. From the last column back each is found by the inverse
among those it hangs on, and those are among what the next one hangs on. Source: Takahashi, Fagan
and Chen 1973; Erisman and Tinney 1975. Columns that hang on the same are taken together.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import coo_matrix, csc_matrix

from semgraph.arrays import FloatArray, IntArray


def selected_inverse(
    lower: csc_matrix, diagonal: FloatArray, rows: IntArray, columns: IntArray
) -> FloatArray:
    """(k,) elements of the inverse of L D L^T.

    Args:
        lower: (n, n) L, with ones on its diagonal; zeros may be left out.
        diagonal: (n,) of D.
        rows: (k,) of each element.
        columns: (k,).
    """
    low, high = np.minimum(rows, columns), np.maximum(rows, columns)
    order = np.argsort(low, kind="stable")
    low, high = low[order], high[order]
    below = _below(lower, low, high)
    starts = _starts(below)
    ends = np.append(starts[1:], len(below))
    owners = np.repeat(np.arange(len(starts)), ends - starts)
    parents = [int(owners[below[end - 1][0]]) if len(below[end - 1]) else -1 for end in ends]
    num_waiting = np.bincount(np.array(parents) + 1, minlength=len(starts) + 1)[1:]
    asked = np.searchsorted(low, np.append(starts, len(below)))
    known: dict[int, _Known] = {}
    found = np.empty(len(low))
    for k in reversed(range(len(starts))):
        columns_here = np.arange(starts[k], ends[k])
        known[k] = _inverse(
            lower, diagonal, columns_here, below[ends[k] - 1], known.get(parents[k])
        )
        which = slice(asked[k], asked[k + 1])
        found[which] = known[k].at(high[which], low[which])
        if parents[k] >= 0:
            num_waiting[parents[k]] -= 1
        for done in {k, parents[k]} - {-1}:
            if not num_waiting[done]:
                del known[done]
    elements = np.empty(len(low))
    elements[order] = found
    return elements


class _Known(NamedTuple):
    """The inverse (m, m) among some columns (m,), ascending."""

    columns: IntArray
    inverse: FloatArray

    def at(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """(k,) elements."""
        i, j = (np.searchsorted(self.columns, each) for each in (rows, columns))
        elements: FloatArray = self.inverse[i, j]
        return elements


def _inverse(
    lower: csc_matrix,
    diagonal: FloatArray,
    columns: IntArray,
    after: IntArray,
    parent: "_Known | None",
) -> _Known:
    """Among columns that hang on the same others `after` them, and those; `parent` knows these."""
    f, members = len(columns), np.concatenate([columns, after])
    counts = np.diff(lower.indptr[columns[0] : columns[-1] + 2])
    span = slice(lower.indptr[columns[0]], lower.indptr[columns[-1] + 1])
    factor = np.zeros((len(members), f))
    rows = np.searchsorted(members, lower.indices[span])
    factor[rows, np.repeat(np.arange(f), counts)] = lower.data[span]
    unit = solve_triangular(
        factor[:f], np.eye(f), lower=True, unit_diagonal=True, check_finite=False
    )
    inverse = np.empty((len(members), len(members)))
    inverse[:f, :f] = unit.T @ (unit / diagonal[columns, None])
    if parent is not None:
        gain = factor[f:] @ unit
        where = np.searchsorted(parent.columns, after)
        inverse[f:, f:] = parent.inverse[np.ix_(where, where)]
        inverse[f:, :f] = -inverse[f:, f:] @ gain
        inverse[:f, f:] = inverse[f:, :f].T
        inverse[:f, :f] -= gain.T @ inverse[f:, :f]
    return _Known(members, inverse)


def _below(lower: csc_matrix, low: IntArray, high: IntArray) -> list[IntArray]:
    """Of each column the rows below the diagonal in which its elements are to be known.

    That is where the factor has some and what is asked for, and of each but the first the same in
    the column of the first, on which it hangs.
    """
    entries = lower.tocoo()
    pattern = coo_matrix(
        (
            np.ones(len(entries.row) + len(low), dtype=np.int8),
            (np.concatenate([entries.row, high]), np.concatenate([entries.col, low])),
        ),
        shape=lower.shape,
    ).tocsc()
    pattern.sort_indices()
    each = np.split(pattern.indices, pattern.indptr[1:-1])
    below = [rows[1:] if rows[0] == k else rows for k, rows in enumerate(each)]
    for rows in below:
        if len(rows) > 1 and not np.array_equal(rows[1:], below[rows[0]]):
            below[rows[0]] = np.union1d(rows[1:], below[rows[0]])
    return below


def _starts(below: list[IntArray]) -> IntArray:
    """The first of each stretch of columns of which each hangs on the next, and what that does."""
    sizes = np.array([len(rows) for rows in below])
    firsts = np.array([rows[0] if len(rows) else -1 for rows in below])
    is_same = (firsts[:-1] == np.arange(1, len(below))) & (sizes[:-1] == sizes[1:] + 1)
    return np.flatnonzero(np.concatenate([[True], ~is_same]))
