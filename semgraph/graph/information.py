"""Covariances out of a sparse information matrix."""

from collections.abc import Callable, Sequence
from typing import Final, Self, final

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.graph.selected_inverse import selected_inverse

# So many are asked for together.
AT_ONCE: Final = 40


def marginals(
    joint: Callable[[Sequence[int]], FloatArray], keys: Sequence[int], size: int
) -> FloatArray:
    """(n, size, size) of each variable alone: by the dozen, which costs little more than one.

    Args:
        joint: the covariance of variables together, in the order of their keys.
        keys: n variables of one size.
        size: of each.
    """
    covariances = np.zeros((len(keys), size, size))
    for start in range(0, len(keys), AT_ONCE):
        some = keys[start : start + AT_ONCE]
        together = joint(some).reshape(len(some), size, len(some), size)
        each = np.arange(len(some))
        covariances[start : start + len(some)] = together[each, :, each, :]
    return covariances


@final
class DenseInformation:
    """The same as `Information` of a matrix (n, n) so small that it is quicker dense.

    Args:
        information: A^T A.

    Raises:
        GraphError: the matrix is singular.
    """

    def __init__(self, information: FloatArray) -> None:
        self._scale = _scale(information.diagonal())
        try:
            self._factor = cho_factor(self._scale[:, None] * information * self._scale)
        except np.linalg.LinAlgError as error:
            raise GraphError(f"no covariance: {error}") from error

    def covariance(self, columns: IntArray) -> FloatArray:
        """(k, k) covariance of some of the variables together.

        Raises:
            GraphError: not positive definite, which rounding makes of what is nearly singular.
        """
        unit = _unit(len(self._scale), columns)
        return _definite(cho_solve(self._factor, unit)[columns], self._scale[columns])


@final
class Information:
    """The information of all variables together, factored once.

    Scaled to a unit diagonal first, since sigmas of metres and of 1e-4 rad meet in it.

    Args:
        information: (n, n).

    Raises:
        GraphError: the matrix is singular.
    """

    def __init__(self, information: csc_matrix) -> None:
        self._scale = _scale(information.diagonal())
        scaling = diags(self._scale)
        try:
            # Symmetric, so that pivots need no search and the fill stays that of Cholesky.
            self._factors = splu(
                csc_matrix(scaling @ information @ scaling),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise GraphError(f"no covariance: {error}") from error

    @classmethod
    def by(cls, jacobian: csr_matrix) -> Self:
        """A^T A of a whitened Jacobian A (m, n)."""
        return cls(csc_matrix(jacobian.T @ jacobian))

    @property
    def num_columns(self) -> int:
        """Of all variables."""
        return len(self._scale)

    def covariance(self, columns: IntArray) -> FloatArray:
        """(k, k) covariance of some of the variables together.

        Raises:
            GraphError: not positive definite, which rounding makes of what is nearly singular.
        """
        unit = _unit(len(self._scale), columns)
        return _definite(self._factors.solve(unit)[columns], self._scale[columns])

    def marginals(self, columns: IntArray) -> FloatArray:
        """(k, d, d) covariance of each variable alone, by their columns (k, d).

        Raises:
            GraphError: not positive definite, which rounding makes of what is nearly singular.
        """
        (covariances,) = self._blocks(columns, (columns,))
        return covariances

    def chain(self, columns: IntArray) -> tuple[FloatArray, FloatArray]:
        """The same, and of each variable with the next one, 0 after the last.

        Raises:
            GraphError: not positive definite, which rounding makes of what is nearly singular.
        """
        covariances, crosses = self._blocks(columns, (columns, np.roll(columns, -1, axis=0)))
        crosses[-1:] = 0.0
        return covariances, crosses

    def _blocks(self, columns: IntArray, others: Sequence[IntArray]) -> list[FloatArray]:
        """(k, d, d) covariance of each variable with each of others, itself the first."""
        pairs = [np.broadcast_arrays(columns[:, :, None], other[:, None, :]) for other in others]
        rows, along = (
            np.concatenate([each.ravel() for each in side]) for side in zip(*pairs, strict=True)
        )
        place = self._factors.perm_c.astype(np.int64)
        scaled = selected_inverse(
            csc_matrix(self._factors.L), self._factors.U.diagonal(), place[rows], place[along]
        )
        elements = scaled * self._scale[rows] * self._scale[along]
        blocks = np.split(elements, len(others))
        shaped = [block.reshape(pairs[0][0].shape) for block in blocks]
        return [_checked(shaped[0]), *shaped[1:]]

    def solve(self, right: FloatArray) -> FloatArray:
        """(n, k) the covariance times (n, k)."""
        scale = self._scale[:, None]
        return np.asarray(scale * self._factors.solve(scale * right))


def _scale(diagonal: FloatArray) -> FloatArray:
    """That makes it 1."""
    if not (np.isfinite(diagonal) & (diagonal > 0.0)).all():
        raise GraphError("a variable has no information")
    scale: FloatArray = diagonal**-0.5
    return scale


def _unit(size: int, columns: IntArray) -> FloatArray:
    """(size, k) of these columns."""
    unit = np.zeros((size, len(columns)))
    unit[columns, np.arange(len(columns))] = 1.0
    return unit


def _checked(covariances: FloatArray) -> FloatArray:
    """(..., d, d) the same, symmetric."""
    symmetric: FloatArray = 0.5 * (covariances + covariances.swapaxes(-1, -2))
    try:
        np.linalg.cholesky(symmetric)
    except np.linalg.LinAlgError:
        raise GraphError("no covariance: the graph is nearly singular") from None
    return symmetric


def _definite(scaled: FloatArray, scale: FloatArray) -> FloatArray:
    """(k, k) in its units and symmetric."""
    return _checked(scale[:, None] * scaled * scale)
