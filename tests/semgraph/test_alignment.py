import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semgraph.alignment import Alignment, Solve, align, fuse_with_prior
from semgraph.errors import InputError
from semgraph.estimates import NoEstimate, NoEstimateReason
from semgraph.geometry import Pose2, UncertainPose2

seeds = st.integers(0, 10_000)


def scene(seed: int, n: int) -> tuple[Pose2, np.ndarray, np.ndarray]:
    """map_T_base, perceived and mapped landmarks that agree exactly."""
    rng = np.random.default_rng(seed)
    map_T_base = Pose2.from_array(rng.uniform(-3.0, 3.0, 3) * (7.0, 7.0, 1.0))
    base_t_landmarks = rng.uniform(-15.0, 15.0, (n, 2))
    return map_T_base, base_t_landmarks, map_T_base.transform(base_t_landmarks)


def solved(result: Alignment | NoEstimate) -> Alignment:
    assert isinstance(result, Alignment)
    return result


@given(seeds, st.integers(2, 20), st.sampled_from(Solve))
@settings(deadline=None)
def test_any_rigid_motion_is_recovered(seed: int, n: int, solve: Solve) -> None:
    map_T_base, perceived, mapped = scene(seed, n)
    estimate = solved(align(perceived, mapped, np.full(n, 1e-4), solve))
    offset = estimate.map_T_base.pose.between(map_T_base).as_array()
    np.testing.assert_allclose(offset, 0.0, atol=1e-9)
    assert estimate.scale == pytest.approx(1.0)


@given(seeds, st.integers(2, 12))
@settings(deadline=None)
def test_similarity_is_the_papers_least_squares(seed: int, n: int) -> None:
    """A x = b of section 3.3 solves R p + t = l, not R l + t = p."""
    _, p, mapped = scene(seed, n)
    mapped = mapped + np.random.default_rng(seed + 1).normal(0.0, 0.1, mapped.shape)
    A = np.zeros((2 * n, 4))
    A[0::2] = np.column_stack([p[:, 0], -p[:, 1], np.ones(n), np.zeros(n)])
    A[1::2] = np.column_stack([p[:, 1], p[:, 0], np.zeros(n), np.ones(n)])
    cosine, sine, u, v = np.linalg.lstsq(A, mapped.ravel(), rcond=None)[0]
    estimate = solved(align(p, mapped, np.full(n, 1e-4), Solve.SIMILARITY))
    pose = estimate.map_T_base.pose
    np.testing.assert_allclose([pose.x, pose.y], [u, v], atol=1e-8)
    assert np.cos(pose.theta - np.arctan2(sine, cosine)) == pytest.approx(1.0)
    assert estimate.scale == pytest.approx(np.hypot(cosine, sine))
    inverse = solved(align(mapped, p, np.full(n, 1e-4), Solve.RIGID)).map_T_base.pose.inverse()
    assert np.cos(inverse.theta - pose.theta) == pytest.approx(1.0)


def test_rigid_beats_similarity_by_what_theory_says_for_few_landmarks() -> None:
    rng = np.random.default_rng(5)
    base = np.array([[8.0, 3.0], [6.0, -5.0]])
    errors: dict[Solve, list[float]] = {solve: [] for solve in Solve}
    for _ in range(3000):
        mapped = base + rng.normal(0.0, 0.05, base.shape)
        for solve in Solve:
            pose = solved(align(base, mapped, np.full(2, 0.0025), solve)).map_T_base.pose
            errors[solve].append(pose.x**2 + pose.y**2)
    ratio = np.sqrt(np.mean(errors[Solve.SIMILARITY]) / np.mean(errors[Solve.RIGID]))
    assert 1.1 < ratio < 1.5


def test_covariance_agrees_with_monte_carlo() -> None:
    rng = np.random.default_rng(2)
    map_T_base, perceived, mapped = scene(11, 6)
    variances = np.full(6, 0.05**2)
    nees = []
    for _ in range(2000):
        noisy = perceived + rng.normal(0.0, 0.05, perceived.shape)
        estimate = solved(align(noisy, mapped, variances)).map_T_base
        error = estimate.pose.between(map_T_base).as_array()
        nees.append(error @ np.linalg.solve(estimate.covariance, error))
    assert 2.8 < np.mean(nees) < 3.2


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (np.zeros((0, 2)), NoEstimateReason.TOO_FEW_MATCHES),
        (np.ones((1, 2)), NoEstimateReason.TOO_FEW_MATCHES),
        (np.ones((4, 2)), NoEstimateReason.DEGENERATE_GEOMETRY),
    ],
)
def test_weak_geometry_gives_a_typed_no(points: np.ndarray, reason: NoEstimateReason) -> None:
    assert align(points, points, np.full(len(points), 0.01)) == NoEstimate(reason)


def test_shapes_that_disagree_are_refused() -> None:
    with pytest.raises(InputError):
        align(np.zeros((3, 2)), np.zeros((2, 2)), np.ones(2))


def test_fused_with_a_weak_prior_is_the_closed_form_and_without_landmarks_the_prior() -> None:
    map_T_base, perceived, mapped = scene(4, 5)
    covariances = np.tile(0.01 * np.eye(2), (5, 1, 1))
    off = map_T_base @ Pose2(0.3, -0.2, 0.1)
    weak = fuse_with_prior(
        off, UncertainPose2(off, 1e4 * np.eye(3)), perceived, mapped, covariances
    )
    np.testing.assert_allclose(weak.pose.between(map_T_base).as_array(), 0.0, atol=1e-4)
    prior = UncertainPose2(off, 0.1 * np.eye(3))
    alone = fuse_with_prior(off, prior, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    np.testing.assert_allclose(alone.pose.between(off).as_array(), 0.0, atol=1e-12)
    np.testing.assert_allclose(alone.covariance, prior.covariance)
