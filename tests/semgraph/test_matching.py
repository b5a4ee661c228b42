import numpy as np
import pytest

from semgraph.geometry import Pose2, rotation
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from semgraph.matching import Assignment, LocalMap, SweepRule, compatible, local_map, match
from semgraph.navigation_map import NavigationMap


def perceive(
    points: np.ndarray, diameters_m: np.ndarray | None = None, identity: str = ""
) -> Perceptions:
    n = len(points)
    return Perceptions.from_arrays(
        0,
        Kind.TREE,
        np.hypot(points[:, 0], points[:, 1]),
        np.arctan2(points[:, 1], points[:, 0]),
        polar_covariances(np.full(n, 0.05), np.full(n, 0.005)),
        diameters_m=diameters_m,
        diameter_sigmas_m=None if diameters_m is None else 0.05 * diameters_m,
        identities=np.full(n, identity, dtype=np.str_),
    )


def around(
    points: np.ndarray, diameters_m: np.ndarray | None = None, identity: str = ""
) -> LocalMap:
    perceptions = perceive(points, diameters_m, identity)
    landmarks = NavigationMap()
    landmarks.insert(perceptions, points, np.tile(0.01 * np.eye(2), (len(points), 1, 1)))
    return local_map(landmarks, Pose2(), perceptions, 2.0)


@pytest.fixture
def trees() -> np.ndarray:
    """(12, 2) at least 1.5 m apart."""
    rng = np.random.default_rng(7)
    kept: list[np.ndarray] = []
    while len(kept) < 12:
        point = rng.uniform(-15, 15, 2)
        if all(np.linalg.norm(point - other) > 1.5 for other in kept):
            kept.append(point)
    return np.array(kept)


def test_permuting_perceptions_changes_nothing(trees: np.ndarray) -> None:
    near = around(trees)
    seen = trees + np.random.default_rng(0).normal(0.0, 0.1, trees.shape)
    order = np.random.default_rng(1).permutation(len(trees))
    plain = match(perceive(seen), near, np.zeros(1), 1.0)
    shuffled = match(perceive(seen[order]), near, np.zeros(1), 1.0)
    pairs = set(zip(plain.rows.tolist(), plain.columns.tolist(), strict=True))
    back = zip(order[shuffled.rows].tolist(), shuffled.columns.tolist(), strict=True)
    assert pairs == set(back) == {(k, k) for k in range(12)}


def test_two_perceptions_never_share_a_landmark_unless_the_paper_says_so() -> None:
    near = around(np.array([[5.0, 0.0]]))
    seen = perceive(np.array([[5.1, 0.0], [4.8, 0.0]]))
    assert match(seen, near, np.zeros(1), 1.0).rows.tolist() == [0]
    assert len(match(seen, near, np.zeros(1), 1.0, Assignment.NEAREST)) == 2


def test_the_sweep_finds_a_rotation(trees: np.ndarray) -> None:
    near = around(trees)
    seen = perceive(trees @ rotation(-0.2).T)
    assert len(match(seen, near, np.zeros(1), 0.5)) < 12
    swept = match(seen, near, np.array([0.0, 0.1, -0.1, 0.2, -0.2]), 0.5)
    assert swept.rows.tolist() == swept.columns.tolist() == list(range(12))


def test_the_lowest_mean_deviation_favours_few_matches() -> None:
    landmarks = np.array([[10.0, 0.0], [0.0, 10.0], [-10.0, 0.0]])
    near = around(landmarks)
    seen = perceive(np.array([[10.2, 0.0], [0.0, 10.2], [10.0 * np.cos(2.9), 10.0 * np.sin(2.9)]]))
    turns = np.array([0.0, np.pi - 2.9])
    most = match(seen, near, turns, 0.5, rule=SweepRule.MOST_MATCHES)
    lowest = match(seen, near, turns, 0.5, rule=SweepRule.LOWEST_MEAN_DEVIATION)
    assert (len(most), len(lowest)) == (2, 1)


def test_kind_diameter_and_identity_gate() -> None:
    point = np.array([[5.0, 0.0]])
    thick, thin = np.array([0.6]), np.array([0.2])
    assert compatible(perceive(point, thin), around(point, thin)).all()
    assert not compatible(perceive(point, thin), around(point, thick)).any()
    assert compatible(perceive(point, thin), around(point)).all()
    assert not compatible(perceive(point, identity="7"), around(point)).any()
    far = perceive(np.array([[5.0, 9.0]]), identity="7")
    assert len(match(far, around(point, identity="7"), np.zeros(1), 1.0)) == 1
