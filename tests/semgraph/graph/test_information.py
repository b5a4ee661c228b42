"""Covariances out of a sparse information matrix agree with a dense inverse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_matrix, random_array

from semgraph.arrays import FloatArray
from semgraph.errors import GraphError
from semgraph.graph.information import Information


def jacobian(seed: int, n: int) -> FloatArray:
    """(3 n, n) sparse, its columns' sizes four decades apart."""
    rng = np.random.default_rng(seed)
    sparse = random_array((2 * n, n), density=0.3, rng=rng).toarray()
    return np.asarray(np.vstack([sparse, np.eye(n)]) * 10.0 ** rng.uniform(-2.0, 2.0, n))


@given(st.integers(0, 2**32 - 1), st.integers(2, 30))
def test_any_columns_in_any_order(seed: int, n: int) -> None:
    A = jacobian(seed, n)
    expected = np.linalg.inv(A.T @ A)
    information = Information.by(csr_matrix(A))
    columns = np.random.default_rng(seed).permutation(n)[: max(2, n // 2)]
    scale = np.sqrt(np.diag(expected))
    errors = (information.covariance(columns) - expected[np.ix_(columns, columns)]) / np.outer(
        scale[columns], scale[columns]
    )
    assert np.abs(errors).max() < 1e-8


def test_a_singular_matrix_is_one_line() -> None:
    with pytest.raises(GraphError, match="no information"):
        Information.by(csr_matrix(np.diag([1.0, 0.0, 1.0])))
    with pytest.raises(GraphError, match="no covariance"):
        Information.by(csr_matrix(np.array([[1.0, -1.0], [1.0, -1.0]]))).covariance(np.arange(2))
