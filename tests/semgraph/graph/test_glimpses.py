"""What one scan showed is in no solver, and nothing is lost by it."""

import numpy as np
import pytest

from semgraph.errors import GraphError
from semgraph.geometry import Pose2
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.graph.loop_closure import find_closures
from semgraph.landmarks import Kind
from tests.semgraph.drives import NOISE, add_scan, drive

NUM_POSES, CLUTTER = 30, 100
# Glimpsed from poses 3 and 9, which are condensed, and from the last one, which is not.
OLD, LATER, NEW = CLUTTER + 3, CLUTTER + 9, CLUTTER + NUM_POSES
# The first of these, glimpsed from pose 10 as another one; and again from the last pose.
TWIN, TRIPLET = 998, 999
AHEAD = 4.0 * np.array([[np.cos(0.3), np.sin(0.3)]])


def driven(window_poses: int, *, clutter: bool = True) -> FactorGraph:
    """From each pose one thing is perceived that nothing else ever shows."""
    graph, made = FactorGraph(drive().start, window_poses), drive(1, NUM_POSES)
    graph.update()
    for pose in range(1, NUM_POSES + 1):
        add_scan(graph, made, pose)
        if clutter:
            glimpse(graph, made.motions[pose - 1].pose, CLUTTER + pose)
        graph.update()
        if clutter and pose in (10, NUM_POSES):
            look_back(graph, OLD, TWIN if pose == 10 else TRIPLET)
            graph.update()
    return graph


def glimpse(graph: FactorGraph, motion: Pose2, landmark: int) -> None:
    """A sighting 4 m ahead from the newest pose, where a motion led to."""
    last = graph.num_poses - 1
    guess = (graph.pose(last - 1) @ motion).transform(AHEAD)[0]
    graph.add_landmark(landmark, guess)
    graph.add_sighting(Sighting(last, landmark, 4.0, 0.3, NOISE, track=landmark))


def look_back(graph: FactorGraph, landmark: int, name: int) -> None:
    """It is sighted from the last pose, just where it is, by its own name or another one."""
    last, place = graph.num_poses - 1, graph.landmark(landmark)
    if name not in graph.landmarks():
        graph.add_landmark(name, place)
    x, y = graph.pose(last).inverse().transform(place[None])[0].tolist()
    range_m, bearing = float(np.hypot(x, y)), float(np.arctan2(y, x))
    graph.add_sighting(Sighting(last, name, range_m, bearing, NOISE, track=name))


@pytest.fixture
def graph() -> FactorGraph:
    graph = driven(6)
    assert {OLD, LATER, TWIN} < graph.glimpsed
    assert graph.glimpsed.isdisjoint((NEW, TRIPLET))
    return graph


def assert_as_good(found: FactorGraph, whole: FactorGraph) -> None:
    """But for where each stretch was linearized: half a sigma, and a seventh of the variance."""
    for each in (found, whole):
        each.update()
        each.settle()
    names = [name for name in found.landmarks() if name not in found.glimpsed]
    covariance = whole.landmark_covariance(names)
    places = [np.array([each.landmark(name) for name in names]) for each in (found, whole)]
    sigmas = np.sqrt(np.diag(covariance)).reshape(-1, 2)
    assert (np.abs(places[0] - places[1]) < 0.5 * sigmas).all()
    np.testing.assert_allclose(
        np.diag(found.landmark_covariance(names)), np.diag(covariance), rtol=0.15
    )
    assert found.incidents == ()


def test_what_was_glimpsed_is_not_solved_and_all_else_is_the_same(graph: FactorGraph) -> None:
    without = driven(6, clutter=False)
    for each in (graph, without):
        each.settle()
    isam = graph._solver.isam
    assert not any(map(isam.has_landmark, graph.glimpsed))
    assert set(graph.landmarks()) > graph.glimpsed
    names = [*range(4)]
    covariance = without.landmark_covariance(names)
    places = [np.array([each.landmark(name) for name in names]) for each in (graph, without)]
    assert (np.abs(places[0] - places[1]).ravel() < 0.2 * np.diag(covariance) ** 0.5).all()
    np.testing.assert_allclose(graph.landmark_covariance(names), covariance, rtol=0.1, atol=1e-3)


def test_it_is_where_it_was_seen_from_wherever_that_is_now(graph: FactorGraph) -> None:
    graph.merge(1, 0)
    graph.update(relinearize=True)
    estimate = graph.estimate()
    for landmark in (OLD, LATER):
        np.testing.assert_allclose(
            estimate.map_t_landmarks[landmark],
            graph.pose(landmark - CLUTTER).transform(AHEAD)[0],
            atol=1e-6,
        )


def test_sighted_again_it_is_solved_as_if_it_always_had_been(graph: FactorGraph) -> None:
    whole = driven(0)
    for each in (graph, whole):
        look_back(each, OLD, OLD)
        look_back(each, OLD, OLD)
    assert_as_good(graph, whole)
    assert OLD not in graph.glimpsed
    assert LATER in graph.glimpsed


@pytest.mark.parametrize("pair", [(OLD, TWIN), (TWIN, OLD), (TRIPLET, OLD), (TWIN, TRIPLET)])
def test_merged_it_counts_and_split_it_stays(graph: FactorGraph, pair: tuple[int, int]) -> None:
    whole = driven(0)
    for each in (graph, whole):
        each.merge(*pair)
        each.update(relinearize=True)
    assert_as_good(graph, whole)
    gone, kept = pair
    for each in (graph, whole):
        each.split(kept, {gone}, gone)
    assert_as_good(graph, whole)


def test_taken_out_it_is_no_more(graph: FactorGraph) -> None:
    graph.remove(OLD)
    graph.update()
    assert OLD not in graph.glimpsed
    assert OLD not in graph.landmarks()
    assert OLD not in graph.estimate().map_t_landmarks
    graph.remove(0)
    assert_as_good(graph, graph)


def test_how_sure_it_is_can_be_asked(graph: FactorGraph) -> None:
    whole, names = driven(0), [OLD, 0, LATER]
    expected = whole.landmark_covariance(names)
    np.testing.assert_allclose(graph.landmark_covariance(names), expected, rtol=0.2, atol=1e-4)
    np.testing.assert_allclose(
        driven(6).landmark_covariances(names)[2], expected[4:, 4:], rtol=0.2, atol=1e-4
    )
    around = driven(6).covariance_around([*names, NEW], [0, 1])
    assert (np.linalg.eigvalsh(around) > 0.0).all()


def test_a_graph_goes_back_to_before_it_counted(graph: FactorGraph) -> None:
    graph.settle()
    before, poses = graph.checkpoint(), graph.estimate().map_T_bases
    graph.merge(OLD, TRIPLET)
    graph.update(relinearize=True)
    graph.split(TRIPLET, {OLD}, OLD)
    graph.go_back(before)
    np.testing.assert_allclose(graph.estimate().map_T_bases, poses, atol=0.1)
    look_back(graph, OLD, OLD)
    graph.update()
    assert graph._solver.isam.has_landmark(OLD)
    assert graph.incidents == ()


def test_in_the_end_all_is_solved(graph: FactorGraph) -> None:
    graph.polish()
    assert not graph.glimpsed
    assert all(map(graph._solver.isam.has_landmark, graph.landmarks()))


def test_a_graph_built_anew_leaves_it_out(graph: FactorGraph) -> None:
    graph.optimize()
    assert OLD in graph.glimpsed
    graph._solver.rebuild()
    assert not graph._solver.isam.has_landmark(OLD)
    assert graph.incidents == ()


def test_no_loop_closes_with_what_was_glimpsed(graph: FactorGraph) -> None:
    """Though it stands just where something in sight does."""
    known = {name: GraphLandmark(Kind.TREE, "") for name in graph.landmarks()}
    assert find_closures(graph, known, [TRIPLET], -100.0) == []
    assert find_closures(graph, known, [OLD], -100.0) == []
    graph.landmark_covariance([OLD])
    assert [each.old for each in find_closures(graph, known, [TRIPLET], -100.0)] == [OLD]


def test_where_the_first_of_several_cannot_be_condensed_anew_all_are_shown(
    graph: FactorGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise GraphError("singular")

    monkeypatch.setattr(graph._solver, "condense", fail)
    assert graph.landmark_covariances([OLD, LATER]).shape == (2, 2, 2)
    assert graph.incidents == ("nothing is condensed any more: singular",)
