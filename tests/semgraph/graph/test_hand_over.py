"""Sightings that were taken for a neighbour's come to their own landmark in the end."""

from collections.abc import Mapping

import numpy as np
import pytest

from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.graph.strays import Likeness
from semgraph.measurement_model import predict
from tests.semgraph.drives import START, polished

NOISE = np.diag([0.03, 0.004]) ** 2
STEP = UncertainPose2(Pose2(1.0, 0.0, 0.0), np.diag([0.02, 0.02, 0.01]) ** 2)
# 1 and 2 stand 0.4 m apart.
TREES = {0: (3.0, 4.0), 1: (6.0, -3.0), 2: (6.3, -3.27), 3: (9.0, 4.0)}
TREE = Likeness("tree")
GROUPS = dict.fromkeys(TREES, TREE)
LOG_ODDS = float(np.log(100.0))


def driven(
    wrong: dict[tuple[int, int], int], seed: int = 1, diameters_m: Mapping[int, float] | None = None
) -> FactorGraph:
    """Ten poses; `wrong` (pose, tree) is taken for another, and what is -1 is not sighted."""
    rng = np.random.default_rng(seed)
    graph = FactorGraph(START)
    for k in range(1, 11):
        pose = graph.add_pose(STEP, Pose2(float(k), 0.0, 0.0))
        for tree, place in TREES.items():
            name = wrong.get((k, tree), tree)
            if name < 0:
                continue
            if name not in graph.landmarks():
                graph.add_landmark(name, np.array(TREES[name]))
            polar = predict(Pose2(float(k), 0.0, 0.0), np.array([place]))[0]
            polar += rng.normal(size=2) * np.sqrt(np.diag(NOISE))
            range_m, bearing = polar.tolist()
            diameter_m = (diameters_m or {}).get(tree, np.nan)
            graph.add_sighting(
                Sighting(pose, name, range_m, bearing, NOISE, name, 0.0, diameter_m, 0.02)
            )
    graph.update()
    return polished(graph)


MIXED = {(4, 2): 1, (4, 1): -1, (7, 2): 1, (7, 1): -1}


@pytest.mark.parametrize("seed", range(5))
def test_what_a_neighbour_explains_better_becomes_the_neighbours(seed: int) -> None:
    graph = driven(MIXED, seed)
    ((old, new, handed),) = graph.hand_over_to_neighbours(GROUPS, LOG_ODDS)
    assert (old, new) == (1, 2)
    assert set(handed.poses.tolist()) <= {4, 7}
    assert set(handed.tracks.tolist()) == {1}
    assert graph.num_sightings(1) + graph.num_sightings(2) == 18
    polished(graph)
    right = driven({(4, 1): -1, (7, 1): -1}, seed)
    if len(handed) == 2:
        np.testing.assert_allclose(graph.landmark(2), right.landmark(2), atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_what_was_taken_for_each_other_in_one_scan_is_swapped(seed: int) -> None:
    """Neither is free to take the other's sighting alone."""
    swapped = {(4, 2): 1, (4, 1): 2, (7, 2): 1, (7, 1): 2}
    graph = driven(swapped, seed)
    handed = graph.hand_over_to_neighbours(GROUPS, LOG_ODDS)
    moves = sorted((old, new, *sighted.poses.tolist()) for old, new, sighted in handed)
    assert moves == [(1, 2, 4), (1, 2, 7), (2, 1, 4), (2, 1, 7)]
    polished(graph)
    right = driven({}, seed)
    for tree in TREES:
        np.testing.assert_allclose(graph.landmark(tree), right.landmark(tree), atol=0.02)
    assert [graph.num_sightings(tree) for tree in TREES] == [10, 10, 10, 10]
    assert (
        driven(swapped, seed).hand_over_to_neighbours(GROUPS | {2: Likeness("rock")}, LOG_ODDS)
        == []
    )


def test_diameters_tell_where_places_do_not() -> None:
    diameters_m, least = {1: 0.1, 2: 0.5}, 200.0
    likenesses = {k: Likeness("tree", (diameters_m.get(k, np.nan), 0.01)) for k in TREES}
    moved = [
        driven(MIXED, diameters_m=diameters_m).hand_over_to_neighbours(alike, least)
        for alike in (GROUPS, likenesses)
    ]
    poses = [sorted(handed.poses.tolist()) for ((_, _, handed),) in moved]
    assert poses == [[7], [4, 7]]


def test_what_is_right_stays_where_it_is() -> None:
    assert driven({}).hand_over_to_neighbours(GROUPS, LOG_ODDS) == []


@pytest.mark.parametrize(
    ("wrong", "groups"),
    [
        # Of another kind; not asked about; nothing asked about.
        (MIXED, GROUPS | {2: Likeness("rock")}),
        (MIXED, dict.fromkeys((0, 1, 3), TREE)),
        (MIXED, {}),
    ],
)
def test_what_cannot_be_the_neighbours_stays(
    wrong: dict[tuple[int, int], int], groups: dict[int, Likeness]
) -> None:
    graph = driven(wrong)
    assert graph.hand_over_to_neighbours(groups, LOG_ODDS) == []


def test_a_landmark_keeps_its_sightings_where_half_of_them_would_go() -> None:
    wrong = {(k, 2): 1 for k in range(1, 8)} | {(k, 1): -1 for k in range(1, 8)}
    graph = driven(wrong)
    assert all(len(handed) < 5 for _, _, handed in graph.hand_over_to_neighbours(GROUPS, LOG_ODDS))


def test_several_neighbours_together_do_not_take_all() -> None:
    """Three posts about a landmark that one sighting of each was taken for."""
    rng, nowhere = np.random.default_rng(1), np.array([6.0, 0.0])
    angles = 2.0 * np.pi * np.arange(3) / 3.0
    posts = nowhere + 0.3 * np.column_stack([np.cos(angles), np.sin(angles)])
    # So wide that the landmark stays between the posts.
    graph, noise = FactorGraph(START), np.diag([0.1, 0.02]) ** 2
    for name, place in enumerate([*posts, nowhere]):
        graph.add_landmark(name, place)
    for k in range(1, 10):
        here = Pose2(0.1 * k, 0.0, 0.0)
        step = UncertainPose2(Pose2(0.1, 0.0, 0.0), 1e-6 * np.eye(3))
        pose = graph.add_pose(step, here)
        shown = {j: j for j in range(3)} if k <= 6 else {k - 7: 3}
        for post, name in shown.items():
            range_m, bearing = predict(here, posts[[post]])[0] + 1e-3 * rng.normal(size=2)
            graph.add_sighting(Sighting(pose, name, range_m, bearing, noise, name))
    graph.update()
    polished(graph)
    graph.hand_over_to_neighbours(dict.fromkeys(range(4), TREE), 0.0)
    assert graph.num_sightings(3) == 3
    assert np.isfinite(polished(graph).landmark_covariances([3])).all()
