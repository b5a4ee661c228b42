"""Joint compatibility with the odds counted, against Gaussians written out by hand."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from semgraph.arrays import BoolArray, FloatArray
from semgraph.graph import association
from semgraph.graph.association import Pair

DENSITY = 0.005
# What is left open of one object's place, per axis.
SAME_PLACE = 0.02**2
OWN_M = 0.05


def drifted(
    recent: FloatArray, old: FloatArray, drift_m: float, own_m: float = OWN_M
) -> tuple[FloatArray, FloatArray]:
    """Differences and joint covariance, all recent ones sharing one drift."""
    a, b = len(recent), len(old)
    covariance = own_m**2 * np.eye(2 * (a + b))
    covariance[: 2 * a, : 2 * a] += drift_m**2 * np.tile(np.eye(2), (a, a))
    return recent[:, None] - old[None], covariance


def associate(
    differences: FloatArray,
    covariance: FloatArray,
    allowed: BoolArray,
    density: float,
    same_place: float = SAME_PLACE,
    ahead_by: float = 0.0,
) -> tuple[Pair, ...]:
    return association.associate(
        differences, covariance, allowed, density, np.full(allowed.shape, same_place), ahead_by
    )


def everything(a: int, b: int) -> BoolArray:
    return np.ones((a, b), dtype=np.bool_)


def pairs_of(result: tuple[Pair, ...]) -> set[tuple[int, int]]:
    return {(pair.recent, pair.old) for pair in result}


def joint_log_odds(
    differences: FloatArray, covariance: FloatArray, pairs: list[tuple[int, int]]
) -> float:
    """ln N(all differences; 0, S) - n ln density, in one piece."""
    if not pairs:
        return 0.0
    num_recent, num_old = differences.shape[:2]
    H = np.zeros((2 * len(pairs), 2 * (num_recent + num_old)))
    for k, (a, b) in enumerate(pairs):
        H[2 * k : 2 * k + 2, 2 * a : 2 * a + 2] = np.eye(2)
        H[2 * k : 2 * k + 2, 2 * (num_recent + b) : 2 * (num_recent + b) + 2] = -np.eye(2)
    S = H @ covariance @ H.T + SAME_PLACE * np.eye(len(H))
    d = np.concatenate([differences[pair] for pair in pairs])
    likelihood = float(multivariate_normal(np.zeros(len(d)), S).logpdf(d))
    return likelihood - len(pairs) * float(np.log(DENSITY))


def test_one_pair_has_the_odds_of_its_gaussian() -> None:
    differences = np.array([[[0.3, -0.2]]])
    covariance = np.diag([0.2, 0.1, 0.02, 0.03]) ** 2
    (pair,) = associate(differences, covariance, everything(1, 1), DENSITY)
    S = np.array([0.2**2 + 0.02**2 + SAME_PLACE, 0.1**2 + 0.03**2 + SAME_PLACE])
    by_hand = (
        -0.5 * (0.3**2 / S[0] + 0.2**2 / S[1])
        - np.log(2.0 * np.pi * np.sqrt(S[0] * S[1]))
        - np.log(DENSITY)
    )
    assert (pair.recent, pair.old) == (0, 0)
    assert pair.log_odds == pytest.approx(by_hand, abs=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
def test_log_odds_are_those_of_the_joint_gaussian(seed: int, num_pairs: int) -> None:
    """Each pair's are the joint log odds of all less those of all others: the chain rule."""
    rng = np.random.default_rng(seed)
    old = 10.0 * np.arange(num_pairs)[:, None] * (1.0, 0.5)
    root = 0.1 * rng.standard_normal((4 * num_pairs, 4 * num_pairs))
    covariance = root @ root.T + 0.05**2 * np.eye(4 * num_pairs)
    errors = rng.multivariate_normal(np.zeros(4 * num_pairs), covariance).reshape(2, num_pairs, 2)
    differences = (old + errors[0])[:, None] - (old + errors[1])[None]
    result = associate(differences, covariance, np.eye(num_pairs, dtype=np.bool_), DENSITY)
    pairs = [(pair.recent, pair.old) for pair in result]
    together = joint_log_odds(differences, covariance, pairs)
    for pair in result:
        others = [each for each in pairs if each != (pair.recent, pair.old)]
        added = together - joint_log_odds(differences, covariance, others)
        # No contradicting pair is allowed: the only rival is that all are new.
        assert pair.log_odds == pytest.approx(min(added, together), abs=1e-6)


def test_joint_compatibility_sees_through_a_drift_larger_than_the_spacing() -> None:
    old = np.array([[0.0, 0.0], [2.0, 0.3], [4.1, -0.2], [5.0, 3.0]])
    recent = old + np.array([1.3, 0.9])
    nearest = np.linalg.norm(recent[:, None] - old[None], axis=2).argmin(axis=1)
    assert nearest.tolist() != [0, 1, 2, 3]
    result = associate(*drifted(recent, old, 1.0), everything(4, 4), DENSITY)
    assert pairs_of(result) == {(k, k) for k in range(4)}
    assert min(pair.log_odds for pair in result) > np.log(100.0)


@pytest.mark.parametrize(
    ("drift_m", "nearest_fails"),
    [
        (1.0, 0.2),
        (2.0, 0.5),
    ],
)
def test_sure_pairs_are_right_where_the_nearest_neighbour_is_not(
    drift_m: float, nearest_fails: float
) -> None:
    """Seven of twenty trees 2.5 m apart are seen again, over seeded draws of the drift."""
    rng = np.random.default_rng(7)
    grid = 2.5 * np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    right, by_nearest = [], []
    for _ in range(40):
        old = grid + rng.uniform(-0.6, 0.6, grid.shape)
        seen = rng.choice(20, 7, replace=False)
        noise = np.sqrt(2.0) * OWN_M * rng.standard_normal((7, 2))
        recent = old[seen] + drift_m * rng.standard_normal(2) + noise
        result = associate(*drifted(recent, old, drift_m), everything(7, 20), DENSITY)
        sure = [pair for pair in result if pair.log_odds > np.log(100.0)]
        right += [seen[pair.recent] == pair.old for pair in sure]
        nearest = np.linalg.norm(recent[:, None] - old[None], axis=2).argmin(axis=1)
        by_nearest += (nearest == seen).tolist()
    assert np.mean(by_nearest) < 1.0 - nearest_fails
    assert len(right) > 0.8 * 40 * 7
    assert np.mean(right) > 0.99


@pytest.mark.parametrize("drift_m", [0.5, 1.0, 3.0])
def test_two_equal_rivals_leave_it_open(drift_m: float) -> None:
    old = np.array([[-1.0, 0.0], [1.0, 0.0]])
    result = associate(*drifted(np.zeros((1, 2)), old, drift_m), everything(1, 2), DENSITY)
    assert max((pair.log_odds for pair in result), default=0.0) < 0.1


def test_a_row_shifted_by_one_spacing_leaves_it_open() -> None:
    """Two of an endless even row: which two, only the drift's prior can say."""
    old = np.column_stack([2.0 * np.arange(-6, 7), np.zeros(13)])
    recent = np.array([[-1.0, 0.0], [1.0, 0.0]])
    result = associate(*drifted(recent, old, 3.0), everything(2, 13), DENSITY)
    assert max((pair.log_odds for pair in result), default=0.0) < np.log(100.0)


@pytest.mark.parametrize("is_even", [False, True])
def test_where_rows_end_settles_nothing_that_must_be_far_ahead(*, is_even: bool) -> None:
    """A drift of one spacing, and five trees of which four fit one tree farther on."""
    along = 2.0 * np.arange(5) if is_even else np.array([0.0, 2.3, 3.1, 6.6, 8.0])
    old = np.column_stack([along, np.zeros(5)])
    drifted_m = drifted(old + np.array([0.9, 0.0]), old, 1.5)
    sure = pairs_of(associate(*drifted_m, everything(5, 5), DENSITY, ahead_by=0.5))
    assert len(associate(*drifted_m, everything(5, 5), DENSITY)) == 5
    assert sure == (set() if is_even else {(k, k) for k in range(5)})


def test_a_landmark_off_the_row_settles_it() -> None:
    old = np.column_stack([2.0 * np.arange(-6, 7), np.zeros(13)])
    old = np.vstack([old, [0.5, 1.7]])
    recent = old[[6, 7, 13]] + (1.0, 0.0)
    result = associate(*drifted(recent, old, 2.0), everything(3, 14), DENSITY)
    sure = {(pair.recent, pair.old) for pair in result if pair.log_odds > np.log(100.0)}
    assert sure == {(0, 6), (1, 7), (2, 13)}


def test_what_is_not_allowed_is_never_paired() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        old = rng.uniform(-3.0, 3.0, (6, 2))
        recent = old[:4] + 0.3 * rng.standard_normal(2)
        allowed = rng.uniform(size=(4, 6)) < 0.6
        for pair in associate(*drifted(recent, old, 0.5), allowed, DENSITY):
            assert allowed[pair.recent, pair.old]
    assert associate(*drifted(recent, old, 0.5), np.zeros((4, 6), dtype=np.bool_), DENSITY) == ()


@given(st.integers(0, 2**32 - 1))
def test_pairs_are_one_to_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    recent, old = rng.uniform(0.0, 2.0, (5, 2)), rng.uniform(0.0, 2.0, (4, 2))
    result = associate(*drifted(recent, old, 0.5, 0.3), everything(5, 4), DENSITY)
    assert len({pair.recent for pair in result}) == len(result)
    assert len({pair.old for pair in result}) == len(result)


@given(st.integers(0, 2**32 - 1), st.permutations(range(5)), st.permutations(range(6)))
def test_the_order_of_the_rows_changes_nothing(
    seed: int, recent_rows: list[int], old_rows: list[int]
) -> None:
    rng = np.random.default_rng(seed)
    old = rng.uniform(-4.0, 4.0, (6, 2))
    recent = old[:5] + 0.6 * rng.standard_normal(2) + OWN_M * rng.standard_normal((5, 2))
    differences, covariance = drifted(recent, old, 0.8)
    allowed = rng.uniform(size=(5, 6)) < 0.9
    rows = np.array([2 * k + axis for k in recent_rows for axis in (0, 1)])
    rows = np.concatenate([rows, [10 + 2 * k + axis for k in old_rows for axis in (0, 1)]])
    grid = np.ix_(recent_rows, old_rows)
    plain = associate(differences, covariance, allowed, DENSITY)
    mixed = associate(differences[grid], covariance[np.ix_(rows, rows)], allowed[grid], DENSITY)
    expected = {(pair.recent, pair.old): pair.log_odds for pair in plain}
    found = {(recent_rows[pair.recent], old_rows[pair.old]): pair.log_odds for pair in mixed}
    assert found == pytest.approx(expected, abs=1e-6)


def test_what_is_far_is_not_paired() -> None:
    here = np.zeros((1, 2))
    assert associate(*drifted(here + 5.0, here, 0.1), everything(1, 1), DENSITY) == ()


def test_a_wide_uncertainty_alone_convinces_nobody() -> None:
    here = np.zeros((1, 2))
    sure = associate(*drifted(here, here, 0.1), everything(1, 1), DENSITY)
    unsure = associate(*drifted(here, here, 8.0), everything(1, 1), DENSITY)
    assert sure[0].log_odds > np.log(100.0)
    assert max((pair.log_odds for pair in unsure), default=0.0) < np.log(100.0)


def test_an_object_of_loose_outline_may_seem_elsewhere_from_its_other_side() -> None:
    here = np.zeros((1, 2))
    apart = drifted(here + 0.4, here, 0.02)
    assert associate(*apart, everything(1, 1), DENSITY) == ()
    (pair,) = associate(*apart, everything(1, 1), DENSITY, same_place=0.3**2)
    assert pair.log_odds > 0.0


def test_a_denser_stand_asks_for_more_evidence() -> None:
    here = np.zeros((1, 2))
    sparse, dense = (
        associate(*drifted(here, here, 0.3), everything(1, 1), density)[0].log_odds
        for density in (0.001, 0.1)
    )
    assert sparse - dense == pytest.approx(np.log(100.0))


def test_the_best_of_all_assignments_is_found_among_few() -> None:
    """Against every assignment of three to three, judged by the joint density."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        old = rng.uniform(-2.0, 2.0, (3, 2))
        recent = old + 0.7 * rng.standard_normal(2) + OWN_M * rng.standard_normal((3, 2))
        differences, covariance = drifted(recent, old, 0.8)
        result = associate(differences, covariance, everything(3, 3), DENSITY)
        ours = joint_log_odds(differences, covariance, sorted(pairs_of(result)))
        best = max(
            joint_log_odds(differences, covariance, list(enumerate(order)))
            for order in permutations(range(3))
        )
        assert ours >= best - 1e-6
