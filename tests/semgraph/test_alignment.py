import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from semgraph.alignment import Alignment, Solve, align, fuse_with_prior, fuse_with_priors
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.estimates import NoEstimate, NoEstimateReason
from semgraph.geometry import Pose2, UncertainPose2, relative_poses, wrap_angle

POSES = st.builds(
    Pose2, st.floats(-100.0, 100.0), st.floats(-100.0, 100.0), st.floats(-math.pi, math.pi)
)
SEEDS = st.integers(0, 2**32 - 1)
BOTH_SOLVES = pytest.mark.parametrize("solve", list(Solve))
PRIOR = UncertainPose2(Pose2(4.9, -3.2, 0.72), np.diag([0.2**2, 0.1**2, 0.05**2]))


def constellation(rng: np.random.Generator, n: int) -> FloatArray:
    """(n, 2) landmarks within 15 m of the robot, at least two of them well apart."""
    points = rng.uniform(-10.0, 10.0, (n, 2))
    points[1] = points[0] + (6.0, -2.0)
    return points


def aligned(
    base: FloatArray, mapped: FloatArray, variances: FloatArray, solve: Solve = Solve.RIGID
) -> Alignment:
    alignment = align(base, mapped, variances, solve)
    assert isinstance(alignment, Alignment)
    return alignment


def assert_same(one: Pose2, other: Pose2, atol: float = 1e-9) -> None:
    assert (one.x, one.y) == pytest.approx((other.x, other.y), abs=atol)
    assert wrap_angle(one.theta - other.theta) == pytest.approx(0.0, abs=atol)


@BOTH_SOLVES
@given(POSES, SEEDS, st.integers(2, 12))
def test_any_rigid_motion_is_recovered(solve: Solve, map_T_base: Pose2, seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    perceived = constellation(rng, n)
    variances = rng.uniform(0.01, 0.04, n)
    alignment = aligned(perceived, map_T_base.transform(perceived), variances, solve)
    assert_same(alignment.map_T_base.pose, map_T_base)
    assert alignment.scale == pytest.approx(1.0)


@BOTH_SOLVES
def test_the_pose_takes_perceived_to_mapped_and_its_inverse_mapped_to_perceived(
    solve: Solve,
) -> None:
    """R p + t = l holds, as the paper's A says; R l + t = p, as its text says, does not."""
    map_T_base = Pose2(4.0, -2.0, 0.9)
    perceived = constellation(np.random.default_rng(0), 5)
    mapped = map_T_base.transform(perceived)
    there = aligned(perceived, mapped, np.ones(5), solve).map_T_base.pose
    back = aligned(mapped, perceived, np.ones(5), solve).map_T_base.pose
    np.testing.assert_allclose(there.transform(perceived), mapped, atol=1e-9)
    np.testing.assert_allclose(back.transform(mapped), perceived, atol=1e-9)
    assert np.abs(there.transform(mapped) - perceived).max() > 1.0
    assert_same(back, there.inverse())


@given(POSES, SEEDS, st.integers(2, 12))
def test_similarity_is_the_least_squares_of_the_paper(map_T_base: Pose2, seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    perceived = constellation(rng, n)
    mapped = map_T_base.transform(perceived) + 0.1 * rng.standard_normal((n, 2))
    A = np.zeros((2 * n, 4))
    A[0::2] = np.column_stack([perceived[:, 0], -perceived[:, 1], np.ones(n), np.zeros(n)])
    A[1::2] = np.column_stack([perceived[:, 1], perceived[:, 0], np.zeros(n), np.ones(n)])
    cosine, sine, u, v = np.linalg.lstsq(A, mapped.ravel(), rcond=None)[0]
    variances = rng.uniform(0.01, 0.5, n)
    alignment = aligned(perceived, mapped, variances, Solve.SIMILARITY)
    assert_same(alignment.map_T_base.pose, Pose2(u, v, math.atan2(sine, cosine)), atol=1e-8)
    assert alignment.scale == pytest.approx(math.hypot(cosine, sine))


@settings(max_examples=40)
@given(SEEDS, st.integers(2, 8))
def test_rigid_is_the_weighted_optimum(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    perceived = constellation(rng, n)
    variances = rng.uniform(0.01, 0.2, n)
    mapped = Pose2(3.0, 1.0, 2.0).transform(perceived) + 0.1 * rng.standard_normal((n, 2))

    def whitened(step: FloatArray) -> FloatArray:
        moved = (pose @ Pose2.from_array(step)).transform(perceived)
        residuals: FloatArray = ((moved - mapped) / np.sqrt(variances)[:, None]).ravel()
        return residuals

    pose = aligned(perceived, mapped, variances).map_T_base.pose
    solved = least_squares(whitened, np.zeros(3), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    np.testing.assert_allclose(solved.x, 0.0, atol=1e-5)


@given(POSES, POSES, SEEDS)
def test_moving_the_map_moves_the_estimate(moved: Pose2, map_T_base: Pose2, seed: int) -> None:
    rng = np.random.default_rng(seed)
    perceived = constellation(rng, 5)
    mapped = map_T_base.transform(perceived) + 0.1 * rng.standard_normal((5, 2))
    variances = rng.uniform(0.01, 0.2, 5)
    before = aligned(perceived, mapped, variances).map_T_base
    after = aligned(perceived, moved.transform(mapped), variances).map_T_base
    assert_same(after.pose, moved @ before.pose, atol=1e-8)
    np.testing.assert_allclose(after.covariance, before.covariance)


@pytest.mark.parametrize("n", [2, 8])
@BOTH_SOLVES
def test_the_covariance_is_that_of_monte_carlo(solve: Solve, n: int) -> None:
    rng = np.random.default_rng(n)
    map_T_base = Pose2(4.0, -2.0, 0.9)
    perceived = constellation(rng, n)
    sigmas = rng.uniform(0.01, 0.05, n)
    poses = np.array(
        [
            aligned(
                perceived + sigmas[:, None] * noise, mapped, sigmas**2, solve
            ).map_T_base.pose.as_array()
            for mapped in [map_T_base.transform(perceived)]
            for noise in rng.standard_normal((2000, n, 2))
        ]
    )
    exact = aligned(perceived, map_T_base.transform(perceived), sigmas**2, solve)
    errors = relative_poses(np.tile(map_T_base.as_array(), (len(poses), 1)), poses)
    root = np.linalg.cholesky(exact.map_T_base.covariance)
    np.testing.assert_allclose(np.cov(np.linalg.solve(root, errors.T)), np.eye(3), atol=0.12)


@pytest.mark.parametrize(("solve", "lever"), [(Solve.RIGID, 1.0), (Solve.SIMILARITY, 2.0)])
@given(SEEDS, st.integers(2, 20))
def test_the_covariance_is_the_statistical_limit(
    solve: Solve, lever: float, seed: int, n: int
) -> None:
    """sigma / (R sqrt n), and sigma / sqrt n sqrt(2 + |c|^2 / R^2); the paper's solve twice |c|."""
    sigma = 0.05
    perceived = constellation(np.random.default_rng(seed), n)
    covariance = aligned(perceived, perceived, np.full(n, sigma**2), solve).map_T_base.covariance
    centroid = perceived.mean(axis=0)
    radius2 = ((perceived - centroid) ** 2).sum(axis=1).mean()
    assert covariance[2, 2] == pytest.approx(sigma**2 / (radius2 * n))
    limit = sigma**2 / n * (2.0 + lever * (centroid @ centroid) / radius2)
    assert np.trace(covariance[:2, :2]) == pytest.approx(limit)


def test_the_scale_tells_of_a_wrong_match() -> None:
    perceived = np.array([[5.0, 0.0], [0.0, 5.0], [-5.0, 0.0]])
    stretched = perceived * 1.2
    for solve in Solve:
        assert aligned(perceived, stretched, np.ones(3) * 1e-4, solve).scale == pytest.approx(1.2)


@BOTH_SOLVES
@pytest.mark.parametrize("n", [0, 1])
def test_fewer_than_two_are_no_estimate(solve: Solve, n: int) -> None:
    points = np.ones((n, 2))
    assert align(points, points, np.ones(n), solve) == NoEstimate(NoEstimateReason.TOO_FEW_MATCHES)


@BOTH_SOLVES
@pytest.mark.parametrize("spread_m", [0.0, 1e-9, 0.02])
@pytest.mark.parametrize("n", [2, 3, 10])
def test_coinciding_landmarks_are_no_estimate(solve: Solve, spread_m: float, n: int) -> None:
    spread = spread_m * np.column_stack([np.linspace(-1.0, 1.0, n), np.zeros(n)])
    perceived = np.array([6.0, 2.0]) + spread
    assert align(perceived, perceived, np.full(n, 0.05**2), solve) == NoEstimate(
        NoEstimateReason.DEGENERATE_GEOMETRY
    )
    assert align(perceived, np.ones((n, 2)), np.full(n, 0.05**2), solve) == NoEstimate(
        NoEstimateReason.DEGENERATE_GEOMETRY
    )


def test_landmarks_that_coincide_in_the_map_are_no_estimate() -> None:
    perceived = np.array([[5.0, 0.0], [0.0, 5.0], [-5.0, 0.0]])
    assert align(perceived, np.ones((3, 2)), np.full(3, 0.01)) == NoEstimate(
        NoEstimateReason.DEGENERATE_GEOMETRY
    )


@pytest.mark.parametrize(
    "shapes",
    [
        ((3, 2), (4, 2), (3,)),
        ((3, 2), (3, 2), (2,)),
        ((3, 2), (3, 2), (3, 1)),
        ((3, 3), (3, 3), (3,)),
        ((3,), (3,), (3,)),
        ((2, 3), (2, 3), (2,)),
        ((0, 2), (1, 2), (0,)),
    ],
)
def test_shapes_that_disagree_are_refused(shapes: tuple[tuple[int, ...], ...]) -> None:
    base, mapped, variances = (np.ones(shape) for shape in shapes)
    with pytest.raises(InputError, match="alignment: shapes disagree"):
        align(base, mapped, variances)


@given(POSES, SEEDS, st.integers(2, 10))
def test_with_a_weak_prior_fusing_is_the_closed_form(map_T_base: Pose2, seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    perceived = constellation(rng, n)
    mapped = map_T_base.transform(perceived) + 0.02 * rng.standard_normal((n, 2))
    variances = rng.uniform(0.01**2, 0.05**2, n)
    closed_form = aligned(perceived, mapped, variances).map_T_base
    weak = UncertainPose2(map_T_base @ Pose2(0.3, -0.2, 0.05), 1e4 * np.eye(3))
    fused = fuse_with_prior(
        map_T_base, weak, perceived, mapped, variances[:, None, None] * np.eye(2)
    )
    assert_same(fused.pose, closed_form.pose, atol=1e-5)
    np.testing.assert_allclose(fused.covariance, closed_form.covariance, rtol=1e-3, atol=1e-9)


def test_without_landmarks_fusing_gives_the_prior() -> None:
    fused = fuse_with_prior(
        Pose2(1.0, 2.0, 3.0), PRIOR, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2))
    )
    assert_same(fused.pose, PRIOR.pose)
    np.testing.assert_allclose(fused.covariance, PRIOR.covariance)


@pytest.mark.parametrize("n", [1, 2, 6])
def test_fusing_finds_the_least_sum_of_both_costs(n: int) -> None:
    rng = np.random.default_rng(n)
    perceived = rng.uniform(-10.0, 10.0, (n, 2))
    mapped = Pose2(5.0, -3.0, 0.7).transform(perceived) + 0.05 * rng.standard_normal((n, 2))
    roots = 0.05 * (np.eye(2) + 0.3 * rng.standard_normal((n, 2, 2)))
    fused = fuse_with_prior(PRIOR.pose, PRIOR, perceived, mapped, roots @ roots.transpose(0, 2, 1))

    def whitened(values: FloatArray) -> FloatArray:
        pose = Pose2.from_array(values)
        residuals = pose.inverse().transform(mapped) - perceived
        to_prior = pose.between(PRIOR.pose).as_array() / np.sqrt(np.diag(PRIOR.covariance))
        return np.concatenate([np.linalg.solve(roots, residuals[..., None]).ravel(), to_prior])

    solved = least_squares(whitened, PRIOR.pose.as_array(), xtol=1e-12)
    assert_same(fused.pose, Pose2.from_array(solved.x), atol=2e-3)
    assert (whitened(fused.pose.as_array()) ** 2).sum() <= 2.0 * solved.cost * (1.0 + 1e-3) + 1e-6


@pytest.mark.parametrize("n", [0, 1, 3])
def test_the_fused_covariance_is_honest(n: int) -> None:
    """The mean NEES over 600 drawn cases lies within 4 sigma of its 3 degrees of freedom."""
    rng = np.random.default_rng(10 + n)
    true = Pose2(5.0, -3.0, 0.7)
    points = rng.uniform(-10.0, 10.0, (n, 2))
    covariances = np.tile(np.array([[0.03, 0.01], [0.01, 0.02]]) * 0.1, (n, 1, 1))
    root = np.linalg.cholesky(covariances)
    nees = []
    for _ in range(600):
        error = rng.multivariate_normal(np.zeros(3), PRIOR.covariance * 0.25)
        prior = UncertainPose2(true @ Pose2.from_array(error), PRIOR.covariance * 0.25)
        perceived = points + (root @ rng.standard_normal((n, 2, 1)))[..., 0]
        fused = fuse_with_prior(prior.pose, prior, perceived, true.transform(points), covariances)
        off = fused.pose.between(true).as_array()
        nees.append(off @ np.linalg.solve(fused.covariance, off))
    assert np.mean(nees) == pytest.approx(3.0, abs=4.0 * math.sqrt(6.0 / 600.0))


def test_many_poses_are_fused_as_each_alone() -> None:
    rng = np.random.default_rng(4)
    poses = [Pose2(3.0, 1.0, 0.4), Pose2(-5.0, 2.0, 3.0), Pose2(0.5, 9.0, -1.0)]
    owners = np.repeat([0, 1, 2], [4, 0, 7])
    base_t = rng.normal(0.0, 6.0, (len(owners), 2))
    noise = rng.normal(0.0, 0.1, base_t.shape)
    map_t = np.vstack([poses[k].transform(base_t[owners == k]) for k in range(3)]) + noise
    covariances = np.tile([[0.02, 0.004], [0.004, 0.01]], (len(owners), 1, 1))
    prior = np.diag([0.3, 0.2, 0.1]) ** 2
    starts = np.array([pose.as_array() for pose in poses])
    together, of_each = fuse_with_priors(starts, starts, prior, owners, base_t, map_t, covariances)
    for k, pose in enumerate(poses):
        own = owners == k
        alone = fuse_with_prior(
            pose, UncertainPose2(pose, prior), base_t[own], map_t[own], covariances[own]
        )
        assert together[k] == pytest.approx(alone.pose.as_array(), abs=1e-9)
        assert of_each[k] == pytest.approx(alone.covariance, abs=1e-12)
