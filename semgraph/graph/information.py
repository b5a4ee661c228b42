"""Covariances out of a sparse information matrix."""

from collections.abc import Callable, Sequence
from typing import Final, Self, final

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError

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


def _definite(scaled: FloatArray, scale: FloatArray) -> FloatArray:
    """(k, k) in its units and symmetric."""
    joint = scale[:, None] * scaled * scale
    covariance: FloatArray = 0.5 * (joint + joint.T)
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise GraphError("no covariance: the graph is nearly singular") from None
    return covariance
