"""Covariances of a graph's variables: by iSAM2's cliques, or by the whole matrix factored."""

import itertools
from collections.abc import Sequence
from typing import Final, final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.graph.incremental import Incremental
from semgraph.graph.information import AT_ONCE, Information, marginals

# Entries of the Bayes tree a column, from which on a graph is dense.
_DENSE: Final = 200


@final
class Covariances:
    """Of a graph as of its last update.

    Args:
        isam: the graph.
        num_columns: of its matrix; None for a graph that is never factored as a whole.
        incidents: told what went wrong.
    """

    def __init__(self, isam: Incremental, num_columns: int | None, incidents: list[str]) -> None:
        self._isam, self._num_columns, self._incidents = isam, num_columns, incidents
        self._factored: Information | None = None
        self._columns: dict[int, IntArray] = {}

    def joint(self, keys: Sequence[int]) -> FloatArray:
        """(d, d) of variables together.

        iSAM2 needs the cliques between them; where these are large, in a dense stand, the sparse
        matrix of the whole graph is tenfold quicker.

        Raises:
            NoCovarianceError: the graph is singular, as far as its factorization can tell.
        """
        try:
            if len(keys) > 1 and self._is_dense():
                information, columns = self.information()
                return information.covariance(np.concatenate([columns[k] for k in keys]))
        except GraphError as error:
            self._incidents.append(f"covariance by iSAM2: {error}")
        return self._isam.covariance(keys)

    def marginals(self, keys: Sequence[int], size: int) -> FloatArray:
        """(n, size, size) of each variable alone."""
        if len(keys) > AT_ONCE:
            try:
                information, columns = self.information()
                return information.marginals(np.array([columns[key] for key in keys]))
            except GraphError as error:
                self._incidents.append(f"covariances by iSAM2: {error}")
        return marginals(self.joint, keys, size)

    def chain(self, keys: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """(n, 3, 3) of poses, and of each with the next one, 0 after the last."""
        try:
            information, columns = self.information()
            return information.chain(np.array([columns[key] for key in keys]))
        except GraphError as error:
            self._incidents.append(f"covariances by iSAM2: {error}")
        crosses = np.zeros((len(keys), 3, 3))
        for row, pair in enumerate(itertools.pairwise(keys)):
            crosses[row] = self.joint(pair)[:3, 3:]
        return self.marginals(keys, 3), crosses

    def _is_dense(self) -> bool:
        return (
            self._num_columns is not None and self._isam.num_entries >= _DENSE * self._num_columns
        )

    def information(self) -> tuple[Information, dict[int, IntArray]]:
        """Of all variables, and the columns of each key; made when it is first asked for.

        Raises:
            GraphError: the graph is singular.
        """
        if self._factored is None:
            jacobian, self._columns = self._isam.jacobian()
            self._factored = Information.by(jacobian)
        return self._factored, self._columns
