import numpy as np
import pytest

from semgraph.association import associate

DENSITY = 0.005


def drifted(
    recent: np.ndarray, old: np.ndarray, drift_m: float, own_m: float = 0.05
) -> tuple[np.ndarray, np.ndarray]:
    """Differences and joint covariance, all recent ones sharing one drift."""
    a, b = len(recent), len(old)
    covariance = own_m**2 * np.eye(2 * (a + b))
    covariance[: 2 * a, : 2 * a] += drift_m**2 * np.tile(np.eye(2), (a, a))
    return recent[:, None] - old[None], covariance


def pairs_of(result: tuple) -> set[tuple[int, int]]:  # type: ignore[type-arg]  # pairs or none
    return {(pair.recent, pair.old) for pair in result}


def test_joint_compatibility_sees_through_a_drift_larger_than_the_spacing() -> None:
    old = np.array([[0.0, 0.0], [2.0, 0.3], [4.1, -0.2], [5.0, 3.0]])
    recent = old + np.array([1.3, 0.9])
    nearest = np.linalg.norm(recent[:, None] - old[None], axis=2).argmin(axis=1)
    assert nearest.tolist() != [0, 1, 2, 3]
    result = associate(*drifted(recent, old, 1.0), np.ones((4, 4), dtype=np.bool_), DENSITY)
    assert pairs_of(result) == {(k, k) for k in range(4)}
    assert min(pair.log_odds for pair in result) > np.log(100.0)


def test_log_odds_are_those_of_the_joint_gaussian() -> None:
    old = np.array([[0.0, 0.0], [9.0, 1.0]])
    recent = old + np.array([[0.2, 0.1], [0.25, 0.05]])
    differences, covariance = drifted(recent, old, 0.3)
    result = associate(differences, covariance, np.eye(2, dtype=np.bool_), DENSITY)
    d = np.concatenate([differences[0, 0], differences[1, 1]])
    S = 0.3**2 * np.tile(np.eye(2), (2, 2)) + (2 * 0.05**2 + 0.02**2) * np.eye(4)
    joint = -0.5 * d @ np.linalg.solve(S, d) - 0.5 * np.log(np.linalg.det(2 * np.pi * S))
    single = -0.5 * d[:2] @ np.linalg.solve(S[:2, :2], d[:2]) - 0.5 * np.log(
        np.linalg.det(2 * np.pi * S[:2, :2])
    )
    support_of_the_second = joint - single - np.log(DENSITY)
    assert result[0].log_odds > 0.0
    by_recent = {pair.recent: pair.log_odds for pair in result}
    assert by_recent[1] == pytest.approx(
        min(support_of_the_second, joint - 2 * np.log(DENSITY)), 1e-6
    )


def test_two_equal_rivals_leave_it_open() -> None:
    old = np.array([[-1.0, 0.0], [1.0, 0.0]])
    result = associate(
        *drifted(np.zeros((1, 2)), old, 1.0), np.ones((1, 2), dtype=np.bool_), DENSITY
    )
    assert max((pair.log_odds for pair in result), default=0.0) < 0.5


def test_what_is_not_allowed_is_not_paired_and_what_is_far_neither() -> None:
    here = np.zeros((1, 2))
    assert associate(*drifted(here, here, 0.1), np.zeros((1, 1), dtype=np.bool_), DENSITY) == ()
    far = here + 5.0
    assert associate(*drifted(far, here, 0.1), np.ones((1, 1), dtype=np.bool_), DENSITY) == ()


def test_a_wide_uncertainty_alone_convinces_nobody() -> None:
    here = np.zeros((1, 2))
    sure = associate(*drifted(here, here, 0.1), np.ones((1, 1), dtype=np.bool_), DENSITY)
    unsure = associate(*drifted(here, here, 8.0), np.ones((1, 1), dtype=np.bool_), DENSITY)
    assert sure[0].log_odds > np.log(100.0)
    assert max((pair.log_odds for pair in unsure), default=0.0) < np.log(100.0)
