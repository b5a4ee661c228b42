"""The graph against independent solutions: scipy, closed forms, and GTSAM's batch solver."""

from collections.abc import Sequence
from itertools import permutations
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X
from scipy.optimize import OptimizeResult, least_squares

from semgraph.arrays import FloatArray
from semgraph.errors import GraphError
from semgraph.geometry import Pose2, UncertainPose2, wrap_angle
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.graph.incremental import Incremental, UpdateError
from semgraph.measurement_model import jacobians, predict
from tests.semgraph.drives import (
    LANDMARKS,
    NOISE,
    START,
    Drive,
    add_scan,
    assert_same,
    built,
    drive,
    halves,
    polished,
)


def gtsam_graph(made: Drive) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The same factors written down once more, without robust noise, and where they start."""
    gaussian = gtsam.noiseModel.Gaussian.Covariance
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    poses = [gtsam.Pose2(*each.as_array()) for each in (made.start.pose, *made.guesses)]
    graph.add(gtsam.PriorFactorPose2(X(0), poses[0], gaussian(made.start.covariance)))
    for k, motion in enumerate(made.motions):
        step = gtsam.Pose2(*motion.pose.as_array())
        graph.add(gtsam.BetweenFactorPose2(X(k), X(k + 1), step, gaussian(motion.covariance)))
    bearing_first = np.array([[NOISE[1, 1], NOISE[1, 0]], [NOISE[0, 1], NOISE[0, 0]]])
    for pose, k, range_m, bearing in made.seen:
        noise = gaussian(bearing_first)
        turned = gtsam.Rot2(bearing)
        graph.add(gtsam.BearingRangeFactor2D(X(pose), L(k), turned, range_m, noise))
    for k, each in enumerate(poses):
        values.insert(X(k), each)
    for k, point in enumerate(made.start.pose.transform(LANDMARKS)):
        values.insert(j=L(k), point2=point)
    return graph, values


def batch_optimum(made: Drive) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    graph, values = gtsam_graph(made)
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-14)
    params.setAbsoluteErrorTol(1e-14)
    return graph, gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()


def scipy_optimum(made: Drive, first_guess: FloatArray) -> OptimizeResult:
    """Poses (x, y, theta) and points by least squares, residuals written from the definitions."""
    num_poses = len(made.motions) + 1
    whiten_start, whiten_noise = (
        np.linalg.inv(np.linalg.cholesky(each)) for each in (made.start.covariance, NOISE)
    )

    def residuals(x: FloatArray) -> FloatArray:
        poses = [Pose2.from_array(row) for row in x[: 3 * num_poses].reshape(-1, 3)]
        points = x[3 * num_poses :].reshape(-1, 2)
        parts = [whiten_start @ logarithm(made.start.pose.between(poses[0]))]
        for k, motion in enumerate(made.motions):
            whiten = np.linalg.inv(np.linalg.cholesky(motion.covariance))
            moved = poses[k].between(poses[k + 1])
            parts.append(whiten @ logarithm(motion.pose.between(moved)))
        for pose, k, range_m, bearing in made.seen:
            expected = predict(poses[pose], points[[k]])[0]
            error = np.array([expected[0] - range_m, wrap_angle(expected[1] - bearing)])
            parts.append(whiten_noise @ error)
        return np.concatenate(parts)

    return least_squares(residuals, first_guess, xtol=1e-13, ftol=1e-13, gtol=1e-13)


def logarithm(pose: Pose2) -> FloatArray:
    """The tangent (x, y, theta) of SE(2); Eade 2017, Lie groups for 2D and 3D, section 4."""
    half = 0.5 * pose.theta
    scale = half / np.tan(half) if half else 1.0
    return np.array([scale * pose.x + half * pose.y, -half * pose.x + scale * pose.y, pose.theta])


def stacked(graph: FactorGraph) -> FloatArray:
    """(3n + 2m,) all variables, landmarks in the order of their numbers."""
    estimate = graph.estimate()
    points = [estimate.map_t_landmarks[k] for k in sorted(estimate.map_t_landmarks)]
    return np.concatenate([estimate.map_T_bases.ravel(), *points])


@pytest.mark.parametrize("seed", range(3))
def test_the_optimum_is_that_of_an_independent_solver(seed: int) -> None:
    made = drive(seed)
    ours = stacked(polished(built(made)))
    expected = scipy_optimum(made, ours + 0.02).x
    np.testing.assert_allclose(ours, expected, atol=2e-5)


def test_polish_reaches_the_optimum_of_the_batch_solver() -> None:
    made = drive(4, num_poses=12)
    graph = built(made, every=12)
    factors, optimum = batch_optimum(made)

    def cost() -> float:
        values = gtsam.Values()
        for k, row in enumerate(graph.estimate().map_T_bases):
            values.insert(X(k), gtsam.Pose2(*row))
        for k in graph.landmarks():
            values.insert(j=L(k), point2=graph.landmark(k))
        return float(factors.error(values))

    before = cost()
    graph.polish()
    assert before > cost()
    assert cost() == pytest.approx(factors.error(optimum), abs=1e-5)


by_both_ways = pytest.mark.parametrize("dense", [0, 10**9])


@by_both_ways
def test_covariances_are_the_marginals_of_the_batch_solution(
    monkeypatch: pytest.MonkeyPatch, dense: int
) -> None:
    monkeypatch.setattr("semgraph.graph.covariances._DENSE", dense)
    made = drive(1)
    graph = polished(built(made))
    together = graph.pose_covariances(range(graph.num_poses))
    marginals = gtsam.Marginals(*batch_optimum(made))
    for pose in range(graph.num_poses):
        expected = marginals.marginalCovariance(X(pose))
        np.testing.assert_allclose(graph.pose_covariance(pose), expected, 1e-3, 1e-9)
        np.testing.assert_allclose(together[pose], expected, 1e-3, 1e-9)
    together = graph.landmark_covariances(graph.landmarks())
    for landmark in graph.landmarks():
        expected = marginals.marginalCovariance(L(landmark))
        np.testing.assert_allclose(graph.landmark_covariance([landmark]), expected, 1e-3, 1e-9)
        np.testing.assert_allclose(together[landmark], expected, 1e-3, 1e-9)


@by_both_ways
@pytest.mark.parametrize("order", [*permutations(range(3)), (3, 0), (2, 3, 1, 0)])
def test_joint_covariances_have_the_order_that_was_asked(
    monkeypatch: pytest.MonkeyPatch, order: Sequence[int], dense: int
) -> None:
    monkeypatch.setattr("semgraph.graph.covariances._DENSE", dense)
    made = drive(1)
    graph = polished(built(made))
    solution = scipy_optimum(made, stacked(graph))
    everything = np.linalg.inv(solution.jac.T @ solution.jac)[3 * graph.num_poses :, :][
        :, 3 * graph.num_poses :
    ]
    rows = np.concatenate([[2 * k, 2 * k + 1] for k in order])
    np.testing.assert_allclose(
        graph.landmark_covariance(order), everything[np.ix_(rows, rows)], rtol=1e-3, atol=1e-8
    )


def test_one_sighting_has_the_covariance_of_first_order_propagation() -> None:
    start = UncertainPose2(Pose2(1.0, 2.0, 0.7), np.diag([0.1, 0.02, 0.01]) ** 2)
    noise = np.array([[0.3**2, 0.002], [0.002, 0.01**2]])
    graph = FactorGraph(start)
    point = np.array([[9.0, -3.0]])
    range_m, bearing = predict(start.pose, point)[0]
    graph.add_landmark(0, point[0])
    graph.add_sighting(Sighting(0, 0, float(range_m), float(bearing), noise))
    graph.update()
    by_pose, by_landmark = (each[0] for each in jacobians(start.pose, point))
    back = np.linalg.inv(by_landmark)
    expected = back @ (noise + by_pose @ start.covariance @ by_pose.T) @ back.T
    np.testing.assert_allclose(graph.landmark_covariance([0]), expected, rtol=1e-6)


def test_bearing_and_range_noise_are_not_swapped() -> None:
    graph = FactorGraph(UncertainPose2(Pose2(), 1e-12 * np.eye(3)))
    graph.add_landmark(0, np.array([10.0, 0.0]))
    graph.add_sighting(Sighting(0, 0, 10.0, 0.0, np.diag([1.0**2, 0.001**2])))
    graph.update()
    np.testing.assert_allclose(
        graph.landmark_covariance([0]), np.diag([1.0, 1e-4]), rtol=1e-3, atol=1e-8
    )


def test_the_estimate_moves_with_the_world() -> None:
    moved = UncertainPose2(Pose2(100.0, -40.0, 2.5), START.covariance)
    here, there = polished(built(drive(2))), polished(built(drive(2, start=moved)))
    for pose in range(here.num_poses):
        expected = moved.pose @ here.pose(pose)
        np.testing.assert_allclose(
            expected.between(there.pose(pose)).as_array(), np.zeros(3), atol=1e-5
        )
        np.testing.assert_allclose(
            there.pose_covariance(pose), here.pose_covariance(pose), 1e-3, 1e-9
        )


@pytest.mark.parametrize("every", [2, 3, 8])
def test_how_often_it_is_updated_does_not_change_the_optimum(every: int) -> None:
    assert_same(polished(built(drive(3))), polished(built(drive(3), every=every)))


def test_a_gross_outlier_is_given_little_weight() -> None:
    graph, clean = (built(drive(5)) for _ in range(2))
    graph.add_sighting(Sighting(4, 0, 30.0, -2.0, NOISE))
    polished(graph)
    polished(clean)
    np.testing.assert_allclose(graph.landmark(0), clean.landmark(0), atol=0.02)
    np.testing.assert_allclose(
        graph.estimate().map_T_bases, clean.estimate().map_T_bases, atol=0.02
    )


def test_sightings_that_fit_nothing_are_left_out() -> None:
    graph, clean = (built(drive(5)) for _ in range(2))
    row = len(graph.sightings(0))
    for pose in (4, 5):
        graph.add_sighting(Sighting(pose, 0, 30.0, -2.0, NOISE, track=7))
    polished(graph)
    left_out = graph.leave_out_strays(set(graph.landmarks()))
    assert list(left_out) == [0]
    assert (left_out[0].poses.tolist(), left_out[0].tracks.tolist()) == ([4, 5], [7, 7])
    assert graph.num_sightings(0) == row
    assert_same(graph, polished(clean))


def test_what_may_not_lose_sightings_keeps_them() -> None:
    """Those with an identity; what is in doubt itself; and one sighting is chance."""
    graph = built(drive(5))
    for pose in (4, 5):
        graph.add_sighting(Sighting(pose, 0, 30.0, -2.0, NOISE))
    graph.add_sighting(Sighting(6, 2, 30.0, -1.0, NOISE, track=2))
    for pose in range(1, 9):
        graph.add_sighting(Sighting(pose, 1, 30.0, 2.0, NOISE))
    polished(graph)
    assert graph.leave_out_strays({1, 2, 3}) == {}
    assert graph.num_sightings(0) == 10


@pytest.mark.parametrize("start_sigma", [1e-4, 1.0, 100.0])
@pytest.mark.parametrize("step_sigma", [1e-4, 1e-2])
def test_covariances_chain_whatever_the_ratio_of_the_sigmas(
    start_sigma: float, step_sigma: float
) -> None:
    expected = UncertainPose2(Pose2(), np.diag([start_sigma, start_sigma, 0.03 * start_sigma]) ** 2)
    graph = FactorGraph(expected)
    sigmas = np.array([step_sigma, 2.0 * step_sigma, 0.1 * step_sigma])
    step = UncertainPose2(Pose2(1.0, 0.2, 0.1), np.diag(sigmas) ** 2)
    for _ in range(19):
        expected = expected @ step
        graph.add_pose(step, expected.pose)
        graph.update()
    polished(graph)
    assert all("rebuilt" in incident for incident in graph.incidents)
    assert len(graph.incidents) <= 1
    np.testing.assert_allclose(graph.pose(19).as_array(), expected.pose.as_array(), atol=1e-6)
    scale = expected.covariance.max()
    np.testing.assert_allclose(
        graph.pose_covariance(19), expected.covariance, rtol=1e-4, atol=1e-9 * scale
    )


def test_sightings_a_million_times_finer_than_the_odometry_are_solved() -> None:
    graph = FactorGraph(START)
    loose = UncertainPose2(Pose2(1.0, 0.0, 0.0), np.eye(3))
    fine = np.diag([1e-6, 1e-6]) ** 2
    for index in range(1, 6):
        graph.add_pose(loose, Pose2(index + 0.2, 0.1, 0.05))
        for landmark, point in enumerate(LANDMARKS):
            if index == 1:
                graph.add_landmark(landmark, point + 0.05)
            range_m, bearing = predict(Pose2(float(index), 0.0, 0.0), point[None])[0]
            graph.add_sighting(Sighting(index, landmark, float(range_m), float(bearing), fine))
    graph.update()
    graph.polish()
    assert all("rebuilt" in incident for incident in graph.incidents)
    assert len(graph.incidents) <= 1
    first = graph.pose(1)
    for index in range(1, 6):
        relative = first.between(graph.pose(index)).as_array()
        np.testing.assert_allclose(relative, [index - 1.0, 0.0, 0.0], atol=1e-4)
    assert np.linalg.eigvalsh(graph.landmark_covariance([0, 1, 2, 3]))[0] > 0.0


def test_a_graph_that_fails_again_and_again_goes_on_by_qr(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(3)
    expected = polished(built(made))
    update = Incremental.update

    def fail(self: Incremental, *args: Any, **options: Any) -> None:
        if self.factorization == "CHOLESKY" and self.has_pose(0):
            raise UpdateError("indeterminate")
        update(self, *args, **options)

    monkeypatch.setattr(Incremental, "update", fail)
    graph = built(made)
    assert graph.incidents == (
        *("update failed, graph rebuilt: indeterminate",) * 2,
        "update failed, graph rebuilt, by QR from now on: indeterminate",
    )
    assert_same(polished(graph), expected)


def test_what_held_firmly_has_its_kernel_also_after_a_failure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two trees are made one by mistake: firm at first, the kernel then lets its sightings go."""

    def fail(**_: object) -> None:
        raise UpdateError("indeterminate")

    graphs = [built(drive(3)) for _ in range(2)]
    for graph in graphs:
        graph.merge(3, 0)
    # The one that is built anew is another one, and does not fail.
    monkeypatch.setattr(graphs[1]._solver.isam, "update", fail)
    for graph in graphs:
        graph.update(relinearize=True)
        graph.settle()
    assert [len(graph.incidents) for graph in graphs] == [0, 1]
    assert [num_with_kernel(graph) for graph in graphs] == [32, 32]


def num_with_kernel(graph: FactorGraph) -> int:
    factors = graph._solver.isam._isam.getFactorsUnsafe()
    there: list[Any] = [factors.at(k) for k in range(factors.size()) if factors.exists(k)]
    return sum(isinstance(each.noiseModel(), gtsam.noiseModel.Robust) for each in there)


@pytest.mark.parametrize("seed", range(4))
def test_merging_gives_the_graph_of_the_true_identity(seed: int) -> None:
    """Tracks of random length, merged in random order and direction."""
    made = drive(seed, num_poses=10)
    rng = np.random.default_rng(seed)
    names = np.arange(4) + 10 * np.cumsum(rng.uniform(size=(11, 4)) < 0.25, axis=0)
    merged = built(made, name=lambda pose, k: int(names[pose, k]))
    while len(merged.landmarks()) > 4:
        gone = int(rng.choice(merged.landmarks()))
        others = [k for k in merged.landmarks() if k != gone and k % 10 == gone % 10]
        if others:
            merged.merge(gone, int(rng.choice(others)))
            merged.update(relinearize=bool(rng.integers(2)))
    known = built(made, name=lambda _, k: next(m for m in merged.landmarks() if m % 10 == k))
    assert_same(polished(merged), polished(known))
    for landmark in merged.landmarks():
        assert len(merged.sightings(landmark)) == 10
        assert {each.landmark for each in merged.sightings(landmark)} == {landmark}
    assert merged.incidents == ()


def test_the_drive_goes_on_after_a_merge() -> None:
    made = drive(6, num_poses=10)
    graph = FactorGraph(made.start)
    for pose in range(1, 11):
        add_scan(graph, made, pose, halves if pose <= 6 else lambda _, k: k)
        graph.update()
        if pose == 6:
            for landmark in range(4):
                graph.merge(landmark + 10, landmark)
    assert_same(polished(graph), polished(built(made)))


@pytest.mark.parametrize("is_rebuilt", [False, True])
def test_a_merge_counts_every_sighting_once(*, is_rebuilt: bool) -> None:
    """Straight from iSAM2: a batch solution would hide a factor that was left behind.

    Two in a hundred are of where it was linearized; a factor counted twice is a fifth.
    """
    made = drive(9)
    graph = built(made, name=halves)
    if is_rebuilt:
        graph.polish()
    for landmark in range(4):
        graph.merge(landmark + 10, landmark)
    for _ in range(4):
        graph.update(relinearize=True)
    np.testing.assert_allclose(
        graph.pose_covariance(8),
        polished(built(made)).pose_covariance(8),
        rtol=0.03,
        atol=1e-8,
    )
    assert graph.incidents == ()


def test_what_was_merged_can_be_split_again() -> None:
    """The graph is as if it never had been one, whatever was sighted in between."""
    made = drive(11, num_poses=10)
    graph = FactorGraph(made.start)
    for pose in range(1, 11):
        add_scan(graph, made, pose, halves)
        graph.update()
        if pose == 7:
            graph.merge(12, 3)
            graph.update(relinearize=True)
            assert 12 not in graph.landmarks()
            assert graph.near(graph.landmark(3), 0.1).keys() == {3}
            graph.split(3, {12}, 12)
    assert_same(polished(graph), polished(built(made, name=halves)))
    assert graph.incidents == ()


def test_a_split_needs_both_sides() -> None:
    graph = built(drive(11), name=halves)
    with pytest.raises(GraphError, match="some but not all"):
        graph.split(2, {12}, 12)


def test_what_is_near_is_where_it_is_now() -> None:
    graph = built(drive(2))
    places = graph.estimate().map_t_landmarks
    centre = graph.pose(4).as_array()[:2]
    near = graph.near(centre, 6.0)
    expected = {k for k, place in places.items() if np.hypot(*(place - centre)) <= 6.0}
    assert near.keys() == expected
    assert 0 < len(near) < len(places)
    for landmark, place in near.items():
        np.testing.assert_allclose(place, places[landmark], atol=1e-12)


def test_covariances_along_the_chain_are_joint_marginals() -> None:
    graph = polished(built(drive(3, num_poses=50)))
    covariances, crosses = graph.chain_covariances()
    for pose in (1, 39, 40, 41, 50):
        np.testing.assert_allclose(covariances[pose], graph.pose_covariance(pose), rtol=1e-6)
    for pose in (39, 40):
        joint = graph._covariances.joint([X(pose), X(pose + 1)])
        np.testing.assert_allclose(crosses[pose], joint[:3, 3:], rtol=1e-6, atol=1e-12)
