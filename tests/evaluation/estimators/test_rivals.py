"""EKF-SLAM and plain iSAM2 are honest: consistent, near the batch, and they close loops."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.association import compare_associations
from evaluation.closures import compare_closures
from evaluation.consistency import bounds_of_mean, gauge, pose_nees
from evaluation.estimators.catalog import estimator
from evaluation.estimators.ekf_slam import EkfSlam, paired
from evaluation.estimators.estimate import Estimate
from evaluation.oracle import oracle
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from semgraph.settings import Settings
from sensors.catalog import open_source
from sensors.truth import Source
from tests.evaluation.estimators.short_course import estimated, short_course

RIVALS = ("ekf-slam", "plain-isam2")
SEEDS = range(1, 9)


def last_nees(estimate: Estimate, source: Source) -> float:
    path = source.truth.path
    assert path is not None
    world_T_map = gauge(estimate.trajectory, path)
    assert world_T_map is not None
    return float(pose_nees(estimate.trajectory, estimate.covariances, path, world_T_map)[-1])


@pytest.mark.parametrize("name", RIVALS)
def test_the_last_poses_of_several_runs_are_as_far_off_as_they_say(name: str) -> None:
    squares = [last_nees(estimated(name, seed), short_course(seed)) for seed in SEEDS]
    low, high = bounds_of_mean(3, len(squares), 0.99)
    assert low <= np.mean(squares) <= high


@pytest.mark.parametrize("name", RIVALS)
def test_innovations_are_as_large_as_they_say(name: str) -> None:
    nis = np.concatenate([estimated(name, seed).nis for seed in SEEDS])
    # Of two degrees of freedom, cut off at 99 %.
    assert np.mean(nis) == pytest.approx(1.9, abs=0.1)


@pytest.mark.parametrize("name", RIVALS)
def test_hardly_any_association_is_wrong(name: str) -> None:
    for seed in (1, 2):
        true = short_course(seed).truth.associations
        assert true is not None
        estimate = estimated(name, seed)
        pairs = compare_associations(estimate.associations, true)
        assert pairs is not None
        assert pairs.precision > 0.99
        assert pairs.recall > 0.95


@pytest.mark.parametrize("name", RIVALS)
def test_loops_are_closed_in_time(name: str) -> None:
    source = open_source("course:perceptions", {"seed": 1, "odometry": True})
    estimate = estimator(name)(source, Settings(), np.random.default_rng(0))
    true = source.truth.associations
    assert true is not None
    closures = compare_closures(estimate.closed_at_ns, true)
    assert closures is not None
    assert closures.share_closed == 1.0
    assert closures.delays_s.max() < 2.0


@pytest.mark.parametrize("name", RIVALS)
def test_the_map_in_the_end_is_the_batchs(name: str) -> None:
    """All associations being right, what is left is linearization and what gates left out."""
    source = short_course(1)
    best, estimate = oracle(source, Settings()), estimated(name, 1)
    for landmark in estimate.landmarks:
        off_m = [
            np.linalg.norm(place - landmark.map_t_landmark)
            for place in best.map_t_landmarks.values()
        ]
        row = list(best.map_t_landmarks)[int(np.argmin(off_m))]
        assert min(off_m) < 0.05
        ratio = np.trace(landmark.covariance) / np.trace(best.landmark_covariances[row])
        assert 0.7 < ratio < 1.5
    last, limit = estimate.trajectory.pose(-1), best.trajectory.pose(-1)
    apart = limit.between(last)
    assert np.hypot(apart.x, apart.y) < 0.03
    assert abs(apart.theta) < 0.005


def one_scan(ranges_m: list[float], bearings: list[float], stamp_ns: int = 0) -> Perceptions:
    n = len(ranges_m)
    return Perceptions.from_arrays(
        stamp_ns,
        Kind.TREE,
        np.array(ranges_m),
        np.array(bearings),
        polar_covariances(np.full(n, 0.03), np.full(n, 0.005)),
    )


STILL = UncertainPose2(Pose2(), 1e-6 * np.eye(3))


def slam() -> EkfSlam:
    return EkfSlam(UncertainPose2(Pose2(), 1e-8 * np.eye(3)), SmootherSettings())


def test_a_single_false_perception_is_forgotten_and_a_tree_is_not() -> None:
    filter_ = slam()
    filter_.step(one_scan([5.0, 8.0], [0.0, 1.0]), STILL)
    for k in range(1, 20):
        filter_.step(one_scan([5.0], [0.0], k * 100_000_000), STILL)
    assert len(filter_.state) == 1
    (tree,) = filter_.landmarks()
    assert tree.map_t_landmark == pytest.approx([5.0, 0.0], abs=1e-6)
    assert tree.num_sightings == 20


def test_between_the_gates_a_perception_is_left_open() -> None:
    filter_ = slam()
    filter_.step(one_scan([5.0, 8.0], [0.0, 1.0]), STILL)
    sigma_m = np.sqrt(0.03**2 * 2.0 + 1e-6)
    ids = filter_.step(one_scan([5.0 + 3.6 * sigma_m, 8.0, 3.0], [0.0, 1.0, -1.0], 1), STILL)
    assert ids.tolist() == [-1, 1, 2]


def test_what_contradicts_the_others_does_not_pass_the_joint_gate() -> None:
    """Unsure by a metre, each pair passes by itself; together one of them cannot be."""
    filter_ = slam()
    ranges_m, bearings = [6.0, 6.0, 6.0, 6.0], [-1.5, -0.5, 0.5, 1.5]
    filter_.step(one_scan(ranges_m, bearings), STILL)
    loose = UncertainPose2(Pose2(), np.diag([0.5, 0.5, 1e-4]))
    ids = filter_.step(one_scan([6.0, 6.0, 6.7, 6.0], bearings, 1), loose)
    assert ids.tolist() == [0, 1, -1, 3]


def test_an_identity_that_a_landmark_bears_makes_no_second_one() -> None:
    filter_ = slam()
    names = np.array(["a", "b"])
    near = replace(one_scan([5.0, 8.0], [0.0, 1.0]), identities=names)
    assert filter_.step(near, STILL).tolist() == [0, 1]
    far = replace(one_scan([7.0, 8.0], [0.0, 1.0], 1), identities=names)
    assert filter_.step(far, STILL).tolist() == [-1, 1]
    other = replace(one_scan([7.0, 8.0], [0.0, 1.0], 2), identities=np.array(["c", "b"]))
    assert filter_.step(other, STILL).tolist() == [2, 1]


def test_pairs_are_as_many_as_possible_then_cheapest() -> None:
    costs = np.array([[1.0, 2.0], [1.5, 90.0]])
    rows, columns = paired(costs, np.array([[True, True], [True, False]]))
    assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == [(0, 1), (1, 0)]
    rows, _ = paired(costs, np.zeros((2, 2), dtype=np.bool_))
    assert len(rows) == 0
