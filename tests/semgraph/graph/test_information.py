"""Covariances out of a sparse information matrix agree with a dense inverse."""

import itertools

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


@given(st.integers(0, 2**32 - 1), st.integers(2, 30), st.integers(1, 3), st.sampled_from([0, 16]))
def test_marginals_and_neighbours_whatever_the_factor_leaves_out(
    seed: int, n: int, width: int, digits: int
) -> None:
    """Of whole numbers elements cancel to zero, and a factor does not say that it has them."""
    A = np.round(jacobian(seed, n), digits) + np.vstack([np.zeros((2 * n, n)), np.eye(n)])
    columns = np.random.default_rng(seed).permutation(n)[: n // width * width].reshape(-1, width)
    expected = np.linalg.inv(A.T @ A)
    scale = np.sqrt(np.diag(expected))
    expected /= np.outer(scale, scale)
    information = Information.by(csr_matrix(A))
    covariances, crosses = information.chain(columns)
    assert np.allclose(covariances, information.marginals(columns), rtol=1e-6)
    for k, here in enumerate(columns):
        own = covariances[k] / np.outer(scale[here], scale[here])
        assert np.allclose(own, expected[np.ix_(here, here)], rtol=0.0, atol=1e-8)
    for k, (here, there) in enumerate(itertools.pairwise(columns)):
        cross = crosses[k] / np.outer(scale[here], scale[there])
        assert np.allclose(cross, expected[np.ix_(here, there)], rtol=0.0, atol=1e-8)
    assert not crosses[-1:].any()


def test_of_nothing_there_is_no_covariance() -> None:
    information = Information.by(csr_matrix(np.eye(3)))
    covariances, crosses = information.chain(np.zeros((0, 3), dtype=np.int64))
    assert covariances.shape == crosses.shape == (0, 3, 3)


def test_a_singular_matrix_is_one_line() -> None:
    with pytest.raises(GraphError, match="no information"):
        Information.by(csr_matrix(np.diag([1.0, 0.0, 1.0])))
    with pytest.raises(GraphError, match="no covariance"):
        Information.by(csr_matrix(np.array([[1.0, -1.0], [1.0, -1.0]]))).covariance(np.arange(2))
    with pytest.raises(GraphError, match="no covariance"):
        Information.by(csr_matrix(np.array([[1.0, -1.0], [1.0, -1.0]]))).marginals(
            np.arange(2)[None]
        )
