"""A long run of which only what is about the robot is solved: a ring driven round and further."""

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from evaluation.benches.bench_runs import run_course
from semgraph.arrays import FloatArray
from semgraph.errors import GraphError
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting, pose_key
from semgraph.graph.graph_states import GraphEstimate
from semgraph.graph.incremental import Incremental, NoCovarianceError, Values
from semgraph.measurement_model import predict

RADIUS_M = 25.0
STEP = Pose2(1.0, 0.0, 1.0 / RADIUS_M)
ROUND = round(2.0 * np.pi * RADIUS_M)
MOTION_NOISE = np.diag([0.02, 0.02, 0.004]) ** 2
NOISE = np.diag([0.02, 0.005]) ** 2
START = UncertainPose2(Pose2(), np.diag([1e-3, 1e-3, 1e-4]) ** 2)
RANGE_M = 5.0
# A second lap's landmarks are called by so much more, until they are found to be the first one's.
LAP = 1000
# Sighted from one pose of the first lap only.
GLIMPSED, GLIMPSED_FROM = 500, 60


def landmarks() -> FloatArray:
    """Inside and outside of the ring, every three metres."""
    angles = np.arange(0.0, 2.0 * np.pi, 3.0 / RADIUS_M)
    radii = RADIUS_M + np.where(np.arange(len(angles)) % 2 == 0, 2.0, -2.0)
    return np.column_stack([radii * np.sin(angles), RADIUS_M - radii * np.cos(angles)])


def ring(num_poses: int = ROUND + 12) -> FactorGraph:
    """As it is before any landmark of the second lap is known to be one of the first."""
    rng = np.random.default_rng(0)
    graph, points = FactorGraph(START, 8), landmarks()
    graph.update()
    true, guess = Pose2(), Pose2()
    for pose in range(1, num_poses + 1):
        true = true @ STEP
        motion = STEP @ Pose2.from_array(rng.multivariate_normal(np.zeros(3), MOTION_NOISE))
        guess = graph.pose(pose - 1) @ motion
        graph.add_pose(UncertainPose2(motion, MOTION_NOISE), guess)
        polar = predict(true, points) + rng.multivariate_normal(np.zeros(2), NOISE, len(points))
        for k in np.flatnonzero(polar[:, 0] < RANGE_M).tolist():
            if pose < ROUND // 4 and k > len(points) // 2:
                continue  # Behind the start; ahead of it, at the end of the lap, it is seen well.
            name = k + LAP * (pose > 3 * ROUND // 4 and k < len(points) // 2)
            if name not in graph.landmarks():
                x, y = polar[k, 0] * np.array([np.cos(polar[k, 1]), np.sin(polar[k, 1])])
                graph.add_landmark(name, guess.transform(np.array([[x, y]]))[0])
            range_m, bearing = polar[k].tolist()
            graph.add_sighting(Sighting(pose, name, range_m, bearing, NOISE, track=name))
        if pose == GLIMPSED_FROM:
            graph.add_landmark(GLIMPSED, guess.transform(np.array([[3.0, 0.0]]))[0])
            graph.add_sighting(Sighting(pose, GLIMPSED, 3.0, 0.0, NOISE, track=GLIMPSED))
        graph.update()
    return graph


def join(graph: FactorGraph) -> None:
    """All that was seen on both laps becomes one, among what is awake."""
    pairs = [(name, name - LAP) for name in graph.landmarks() if name >= LAP]
    graph.checkpoint([name for pair in pairs for name in pair])
    for pair in pairs:
        graph.merge(*pair)
    graph.update(relinearize=True)
    graph.settle()


def close_loop(graph: FactorGraph) -> None:
    """The same, and what rests goes with it."""
    join(graph)
    graph.knit()


@pytest.fixture
def resting(monkeypatch: pytest.MonkeyPatch) -> Iterator[FactorGraph]:
    """Nine tenths of it rest."""
    monkeypatch.setattr("semgraph.graph.graph_solver._LONG_WINDOWS", 2)
    graph = ring()
    awake, windows = graph._solver.resting.awake, graph._solver.windows
    assert awake is not None
    assert len(awake) < len(windows) // 2
    yield graph
    assert graph.incidents == ()


@pytest.fixture(scope="module")
def whole() -> FactorGraph:
    return ring()


def errors(one: GraphEstimate, other: GraphEstimate) -> float:
    """The largest difference in m."""
    off = one.map_T_bases[:, :2] - other.map_T_bases[:, :2]
    return float(np.hypot(*off.T).max())


def test_what_rests_stays_where_it_is_and_the_rest_goes_on(
    resting: FactorGraph, whole: FactorGraph
) -> None:
    """Beside a drift of most of a metre, both differ in what they make of the same noise."""
    assert errors(resting.estimate(), whole.estimate()) < 0.3
    assert resting.landmarks() == whole.landmarks()


def test_the_last_pose_is_as_unsure_as_in_the_whole(
    resting: FactorGraph, whole: FactorGraph
) -> None:
    last = resting.num_poses - 1
    here, there = (float(graph.pose_covariance(last)[:2, :2].trace()) for graph in (resting, whole))
    assert 0.9 * there < here < 2.0 * there
    assert there > 0.3**2


def test_groups_that_are_not_joined_are_as_unsure_of_each_other_as_they_are(
    resting: FactorGraph, whole: FactorGraph
) -> None:
    """The pair that is to become one: first lap and second; the first rests until it is asked."""
    new = min(name for name in resting.landmarks() if name >= LAP)
    pair = [new, new - LAP]
    differences = np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    here, there = (
        differences @ graph.landmark_covariance(pair) @ differences.T for graph in (resting, whole)
    )
    assert 0.9 < here.trace() / there.trace() < 2.0


def test_what_hangs_together_has_drifted_less_than_it_is_unsure_in_the_map(
    resting: FactorGraph, whole: FactorGraph
) -> None:
    """As the joint covariance with what holds it says; what only the map joins is unsure of all."""
    drift, last, solver = resting.drift(), resting.num_poses - 1, resting._solver
    new = min(name for name in resting.landmarks() if name >= LAP)
    assert drift.beside is not None
    assert new in drift.beside
    assert new - LAP not in drift.beside
    anchor = solver.part.holds[-1].anchor
    joint = solver.isam.covariance([pose_key(anchor), pose_key(last)])
    last_Ad_anchor = resting.pose(last).between(resting.pose(anchor)).adjoint()
    to_last = np.hstack([-last_Ad_anchor, np.eye(3)])
    exact = (to_last @ joint @ to_last.T)[:2, :2]
    assert drift.beside_m == pytest.approx(np.linalg.eigvalsh(exact)[-1] ** 0.5, rel=0.1)
    assert drift.beside_m < 0.2 < drift.apart_m
    near_m, far_m = drift.reaches_m([new, new - LAP]).tolist()
    assert near_m / drift.beside_m == pytest.approx(far_m / drift.apart_m)
    assert far_m == drift.reach_m == pytest.approx(5.257 * drift.apart_m, rel=1e-3)
    assert whole.drift().beside is None
    assert whole.drift().beside_m == pytest.approx(whole.drift().apart_m, rel=0.05)


def test_two_groups_that_became_one_are_as_unsure_as_the_map_says(resting: FactorGraph) -> None:
    new = min(name for name in resting.landmarks() if name >= LAP)
    join(resting)
    drift = resting.drift()
    assert drift.beside is not None
    assert {0, new - LAP} <= drift.beside
    assert drift.beside_m == drift.apart_m


def test_a_loop_that_closes_brings_what_rests_to_the_optimum_too(resting: FactorGraph) -> None:
    before = resting.estimate()
    close_loop(resting)
    assert resting._solver.resting.awake is not None
    closed = resting.estimate()
    assert errors(before, closed) > 0.3
    last = resting.num_poses - 1
    assert float(resting.pose_covariance(last)[:2, :2].trace()) < 0.1**2
    resting.polish()
    assert errors(closed, resting.estimate()) < 0.1


def test_what_is_torn_unnoticed_is_knit_when_is_chosen_anew(resting: FactorGraph) -> None:
    join(resting)
    resting._solver._is_stale = True
    resting.update()
    assert resting.is_updated
    updated = resting.estimate()
    resting.polish()
    assert errors(updated, resting.estimate()) < 0.1


def test_what_becomes_one_with_something_that_rests_wakes_it(resting: FactorGraph) -> None:
    """Half a ring away, which it is not: the solver is to take it, not to judge it."""
    solver = resting._solver
    new = max(name for name in resting.landmarks() if name >= LAP)
    old = next(name for name in resting.landmarks() if not solver.isam.has_landmark(name))
    resting.merge(new, old)
    resting.update()
    assert solver.isam.has_landmark(old)
    assert new not in resting.landmarks()


def test_what_was_glimpsed_from_what_rests_wakes_it_when_it_is_sighted_again(
    resting: FactorGraph,
) -> None:
    solver = resting._solver
    number = solver.windows.of_motion(GLIMPSED_FROM)
    assert GLIMPSED in resting.glimpsed
    assert solver.resting.awake is not None
    assert number not in solver.resting.awake
    last = resting.pose(resting.num_poses - 1)
    x, y = last.inverse().transform(resting.landmark(GLIMPSED)[None])[0].tolist()
    seen = Sighting(resting.num_poses - 1, GLIMPSED, np.hypot(x, y), np.arctan2(y, x), NOISE)
    resting.add_sighting(seen)
    resting.update()
    assert number in solver.resting.awake
    assert solver.isam.has_landmark(GLIMPSED)


def test_a_wrong_closure_is_undone_while_the_rest_rests(resting: FactorGraph) -> None:
    solver = resting._solver
    here = [name for name in resting.landmarks() if solver.is_solved(name)]
    before = resting.checkpoint(here)
    places = resting.estimate()
    resting.merge(here[-1], here[-2])
    resting.update(relinearize=True)
    assert resting.cost() > before.cost + 50.0
    resting.split(here[-2], {here[-1]}, here[-1])
    resting.go_back(before)
    assert errors(resting.estimate(), places) < 1e-6
    assert resting.cost() == pytest.approx(before.cost)


def test_how_sure_all_is_can_be_asked_at_any_time(resting: FactorGraph, whole: FactorGraph) -> None:
    names = resting.landmarks()
    here, there = (graph.landmark_covariances(names) for graph in (resting, whole))
    np.testing.assert_allclose(np.trace(here.T), np.trace(there.T), 0.1)
    resting.update()
    ends = [window.last for window in resting._solver.windows]
    here, there = (graph.pose_covariances(ends) for graph in (resting, whole))
    np.testing.assert_allclose(np.trace(here.T), np.trace(there.T), 0.1)


def test_what_rests_can_be_taken_out(resting: FactorGraph) -> None:
    solver = resting._solver
    gone = next(name for name in resting.landmarks() if not solver.isam.has_landmark(name))
    resting.remove(gone)
    resting.update()
    assert gone not in resting.estimate().map_t_landmarks
    resting.polish()


def test_a_group_that_nothing_is_known_of_cannot_be_held(resting: FactorGraph) -> None:
    solver = resting._solver
    with pytest.raises(GraphError, match="not known how sure"):
        solver.resting.holds(solver.pose, solver.landmark, {})


def test_where_it_is_not_known_how_sure_the_graph_is_nothing_rests_and_that_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("semgraph.graph.graph_solver._LONG_WINDOWS", 2)
    monkeypatch.setattr(Incremental, "covariance", no_covariance)
    graph = ring(60)
    assert graph._solver.resting.awake is None
    assert any(each.startswith("it is not known how sure pose") for each in graph.incidents)
    assert any(each.startswith("nothing rests") for each in graph.incidents)


def no_covariance(isam: Incremental, keys: Sequence[int]) -> FloatArray:
    raise NoCovarianceError("indeterminate")


def test_a_loop_whose_batch_fails_is_solved_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("semgraph.graph.graph_solver._LONG_WINDOWS", 2)
    graph = ring()
    before = graph.estimate()
    monkeypatch.setattr(Incremental, "go_to_optimum", no_optimum)
    close_loop(graph)
    monkeypatch.undo()
    (incident,) = graph.incidents
    assert incident == "the whole is solved step by step: indeterminate"
    closed = graph.estimate()
    assert errors(before, closed) > 0.3
    graph.polish()
    assert errors(closed, graph.estimate()) < 0.15


def no_optimum(isam: Incremental) -> Values:
    raise GraphError("indeterminate")


def test_a_run_ends_the_same_whether_or_not_most_of_it_rests(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three lanes beside each other, whose trees become one from lane to lane."""
    _, solved = run_course("course:lanes", length_m=140.0)
    monkeypatch.setattr("semgraph.graph.graph_solver._LONG_WINDOWS", 4)
    _, rested = run_course("course:lanes", length_m=140.0)
    assert len(rested.landmarks) == len(solved.landmarks)
    off = rested.smoothed.map_T_bases[:, :2] - solved.smoothed.map_T_bases[:, :2]
    assert np.hypot(*off.T).max() < 0.01
