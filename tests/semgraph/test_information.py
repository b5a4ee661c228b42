"""Covariances out of a sparse information matrix agree with a dense inverse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_matrix, random_array

from semgraph.arrays import FloatArray
from semgraph.errors import GraphError
from semgraph.information import Information


def jacobian(seed: int, n: int) -> FloatArray:
    """(3 n, n) sparse, its columns' sizes four decades apart."""
    rng = np.random.default_rng(seed)
    sparse = random_array((2 * n, n), density=0.3, rng=rng).toarray()
    return np.asarray(np.vstack([sparse, np.eye(n)]) * 10.0 ** rng.uniform(-2.0, 2.0, n))


@given(st.integers(0, 2**32 - 1), st.integers(2, 30))
def test_any_columns_together_and_alone(seed: int, n: int) -> None:
    A = jacobian(seed, n)
    expected = np.linalg.inv(A.T @ A)
    information = Information(csr_matrix(A))
    columns = np.random.default_rng(seed).permutation(n)[: max(2, n // 2)]
    scale = np.sqrt(np.diag(expected))
    errors = (information.covariance(columns) - expected[np.ix_(columns, columns)]) / np.outer(
        scale[columns], scale[columns]
    )
    assert np.abs(errors).max() < 1e-8
    pairs = np.arange(n - n % 2).reshape(-1, 2)
    for pair, marginal in zip(pairs, information.marginals(pairs), strict=True):
        np.testing.assert_allclose(marginal, information.covariance(pair), rtol=1e-9, atol=0.0)


def test_hundreds_of_marginals_are_those_asked_for() -> None:
    A = jacobian(1, 300)
    columns = np.random.default_rng(2).permutation(300).reshape(-1, 3)
    expected = np.linalg.inv(A.T @ A)
    for triple, marginal in zip(
        columns, Information(csr_matrix(A)).marginals(columns), strict=True
    ):
        np.testing.assert_allclose(
            marginal, expected[np.ix_(triple, triple)], rtol=1e-6, atol=1e-12
        )


def test_a_singular_matrix_is_one_line() -> None:
    with pytest.raises(GraphError, match="no information"):
        Information(csr_matrix(np.diag([1.0, 0.0, 1.0])))
    with pytest.raises(GraphError, match="no covariance"):
        Information(csr_matrix(np.array([[1.0, -1.0], [1.0, -1.0]]))).covariance(np.arange(2))
