"""The batch optimum, beside another solver and with scans composed away."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2
from semgraph.measurement_model import innovations, predict
from semgraph.offline.batch import Batch, Belief, Prior
from semgraph.offline.batch_graph import BatchGraph
from tests.semgraph.drives import LANDMARKS, NOISE
from tests.semgraph.logs import log, places

PRIOR = Prior(1, LANDMARKS[1] + (0.05, -0.05), np.diag([0.02, 0.03]) ** 2)


def right(batch: Batch) -> IntArray:
    return np.arange(len(batch.seen), dtype=np.int64) % 4


def belief(batch: Batch, landmarks: IntArray | None = None) -> Belief:
    taken_for = right(batch) if landmarks is None else landmarks
    poses = [Pose2()]
    for scan in range(len(batch)):
        poses.append(poses[-1] @ batch.motion(scan).pose)
    return Belief(np.array([pose.as_array() for pose in poses[1:]]), taken_for, places())


def whitened(covariance: FloatArray, error: FloatArray) -> FloatArray:
    return np.linalg.solve(np.linalg.cholesky(covariance), error)


def logarithm(pose: Pose2) -> FloatArray:
    """(3,) the constant twist that leads to the pose. Source: Barfoot 2017, section 7.1."""
    half = 0.5 * pose.theta
    cotangent = half / np.tan(half) if half else 1.0
    x, y = cotangent * pose.x + half * pose.y, cotangent * pose.y - half * pose.x
    return np.array([x, y, pose.theta])


def residuals(unknowns: FloatArray, batch: Batch) -> FloatArray:
    """All of the graph's, each by its definition."""
    n = len(batch)
    poses = [Pose2.from_array(each) for each in unknowns[: 3 * n].reshape(n, 3)]
    points = unknowns[3 * n :].reshape(-1, 2)
    start = batch.starts[0] @ batch.motion(0)
    parts = [whitened(start.covariance, -logarithm(poses[0].between(start.pose)))]
    for scan in range(1, n):
        moved = poses[scan - 1].between(poses[scan])
        error = logarithm(batch.motion(scan).pose.between(moved))
        parts.append(whitened(batch.motion_covariances[scan], error))
    for scan, pose in enumerate(poses):
        rows = np.flatnonzero(batch.scans == scan)
        errors = innovations(
            predict(pose, points), batch.seen.ranges_m[rows], batch.seen.bearings[rows]
        )
        parts += [whitened(NOISE, error) for error in errors]
    parts.append(whitened(PRIOR.covariance, points[1] - PRIOR.map_t_landmark))
    return np.concatenate(parts)


def test_it_is_the_least_squares_optimum_with_its_covariances() -> None:
    batch = Batch.of(log())
    begin = replace(belief(batch), priors=(PRIOR,))
    graph = BatchGraph(batch, begin)
    found = graph.optimum()
    unknowns = np.concatenate(
        [begin.map_T_bases.ravel(), np.array(list(begin.map_t_landmarks.values())).ravel()]
    )
    other = least_squares(residuals, unknowns, args=(batch,), xtol=1e-14, ftol=1e-14, gtol=1e-12)
    n = 3 * len(batch)
    np.testing.assert_allclose(found.map_T_bases.ravel(), other.x[:n], atol=2e-5)
    np.testing.assert_allclose(found.places(np.arange(4)).ravel(), other.x[n:], atol=2e-5)
    assert graph.cost == pytest.approx(other.cost, rel=1e-5)
    covariance = np.linalg.inv(other.jac.T @ other.jac)
    np.testing.assert_allclose(
        graph.landmark_covariance(range(4)), covariance[n:, n:], rtol=1e-3, atol=1e-9
    )


def test_composing_equals_not_composing() -> None:
    batch = Batch.of(log(3, num_scans=12, sighted_from=(2, 5, 6, 9)))
    begin = belief(batch)
    short, whole = BatchGraph(batch, begin), BatchGraph(batch, begin, every_scan=True)
    assert short.num_factors == whole.num_factors - 7
    one, other = short.optimum(), whole.optimum()
    np.testing.assert_allclose(one.map_T_bases, other.map_T_bases, atol=2e-4)
    np.testing.assert_allclose(one.places(np.arange(4)), other.places(np.arange(4)), atol=2e-4)
    np.testing.assert_allclose(
        short.landmark_covariance(range(4)), whole.landmark_covariance(range(4)), rtol=0.02
    )
    assert short.cost == pytest.approx(whole.cost, rel=1e-3)
    np.testing.assert_allclose(
        short.pose_covariances(), whole.pose_covariances()[[0, 2, 5, 6, 9]], rtol=0.03, atol=1e-8
    )


@pytest.mark.parametrize("num_scans", [1, 2, 9])
def test_without_sightings_the_motions_carry_on(num_scans: int) -> None:
    batch = Batch.of(log(2, num_scans, sighted_from=()))
    begin = replace(belief(batch), map_t_landmarks={})
    found = BatchGraph(batch, begin).optimum()
    np.testing.assert_allclose(found.map_T_bases, begin.map_T_bases, atol=1e-9)
    covariances = BatchGraph(batch, begin, every_scan=True).pose_covariances()
    expected = batch.starts[0]
    for scan in range(num_scans):
        expected = expected @ batch.motion(scan)
        np.testing.assert_allclose(covariances[scan], expected.covariance, rtol=0.02, atol=1e-9)


def test_wrong_sightings_have_no_say() -> None:
    batch = Batch.of(log(5, num_scans=20))
    wrong = np.array(right(batch))
    wrong[[9, 26, 41, 62, 77]] = (wrong[[9, 26, 41, 62, 77]] + 1) % 4
    is_right = wrong == right(batch)
    without = np.where(is_right, wrong, -1)
    best = BatchGraph(batch, belief(batch, without)).optimum()
    robust = BatchGraph(batch, belief(batch, wrong)).optimum()
    np.testing.assert_allclose(robust.map_T_bases, best.map_T_bases, atol=2e-3)
    fit = robust.fit(batch)
    assert (fit[~is_right] > 13.8).all()
    assert (fit[is_right] < 13.8).all()


def test_it_is_as_good_as_levenberg_marquardt() -> None:
    batch = Batch.of(log(8, num_scans=40))
    graph = BatchGraph(batch, belief(batch))
    best = graph.cost_by_gtsam(1e-12)
    graph.optimum()
    assert graph.cost == pytest.approx(best, rel=1e-5)
