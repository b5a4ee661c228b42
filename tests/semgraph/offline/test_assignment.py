"""The cheapest pairing, beside trying all of them."""

from itertools import permutations

import numpy as np
import pytest

from semgraph.offline.assignment import one_to_one

LIMIT = 5.0


@pytest.mark.parametrize("seed", range(40))
def test_it_is_the_cheapest_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_rows, num_columns = int(rng.integers(1, 5)), int(rng.integers(1, 5))
    costs = np.where(rng.random((num_rows, num_columns)) < 0.7, 8.0 * rng.random(), np.inf)
    costs *= rng.random(costs.shape)
    rows, columns = np.nonzero(np.isfinite(costs))
    holds = one_to_one(rows, columns, costs[rows, columns], LIMIT)
    assert len(set(rows[holds])) == holds.sum() == len(set(columns[holds]))
    total = costs[rows[holds], columns[holds]].sum() + LIMIT * (num_rows - holds.sum())
    # With a column of its own for each row to be without a pair.
    whole = np.hstack([costs, np.full((num_rows, num_rows), LIMIT)])
    every = permutations(range(num_columns + num_rows), num_rows)
    best = min(whole[np.arange(num_rows), list(chosen)].sum() for chosen in every)
    assert total == pytest.approx(best)


def test_nothing_holds_beyond_the_limit() -> None:
    assert not one_to_one(np.array([0, 1]), np.array([0, 0]), np.array([6.0, 7.0]), LIMIT).any()
    empty = np.zeros(0, dtype=np.int64)
    assert not len(one_to_one(empty, empty, np.zeros(0), LIMIT))
