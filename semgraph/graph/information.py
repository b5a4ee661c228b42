"""Covariances out of a sparse information matrix."""

from typing import final

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError


@final
class Information:
    """The information A^T A of all variables together, factored once.

    Scaled to a unit diagonal first, since sigmas of metres and of 1e-4 rad meet in it.

    Args:
        jacobian: A (m, n), whitened.

    Raises:
        GraphError: the matrix is singular.
    """

    def __init__(self, jacobian: csr_matrix) -> None:
        information = csc_matrix(jacobian.T @ jacobian)
        diagonal = information.diagonal()
        if not (np.isfinite(diagonal) & (diagonal > 0.0)).all():
            raise GraphError("a variable has no information")
        self._scale: FloatArray = diagonal**-0.5
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

    def covariance(self, columns: IntArray) -> FloatArray:
        """(k, k) covariance of some of the variables together.

        Raises:
            GraphError: not positive definite, which rounding makes of what is nearly singular.
        """
        unit = np.zeros((len(self._scale), len(columns)))
        unit[columns, np.arange(len(columns))] = 1.0
        scale = self._scale[columns]
        joint = scale[:, None] * self._factors.solve(unit)[columns] * scale
        covariance: FloatArray = 0.5 * (joint + joint.T)
        try:
            np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            raise GraphError("no covariance: the graph is nearly singular") from None
        return covariance
