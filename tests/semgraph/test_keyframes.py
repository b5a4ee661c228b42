"""Leaving scans without sightings out of the graph changes nothing about the others."""

import numpy as np
import pytest

from semgraph.factor_graph import FactorGraph
from semgraph.factors import Sighting
from semgraph.keyframes import Keyframes
from tests.semgraph.drives import LANDMARKS, NOISE, Drive, drive

SIGHTING = (1, 2, 5, 9)


def whole(made: Drive) -> FactorGraph:
    """Every scan is a pose."""
    graph = FactorGraph(made.start)
    for scan, (motion, guess) in enumerate(zip(made.motions, made.guesses, strict=True), start=1):
        sight(graph, made, scan, graph.add_pose(motion, guess))
    graph.polish()
    return graph


def thinned(made: Drive) -> tuple[FactorGraph, Keyframes]:
    """Only scans that sight something are."""
    graph, keyframes = FactorGraph(made.start), Keyframes()
    for scan, (motion, guess) in enumerate(zip(made.motions, made.guesses, strict=True), start=1):
        keyframes.move(motion)
        if scan in SIGHTING:
            pose = graph.add_pose(keyframes.since_last, guess)
            keyframes.add_pose(pose)
            sight(graph, made, scan, pose)
        else:
            keyframes.add_between(graph.num_poses - 1)
    graph.polish()
    return graph, keyframes


def sight(graph: FactorGraph, made: Drive, scan: int, pose: int) -> None:
    if scan not in SIGHTING:
        return
    for _, landmark, range_m, bearing in made.of_pose(scan):
        if landmark not in graph.landmarks():
            graph.add_landmark(landmark, made.start.pose.transform(LANDMARKS[[landmark]])[0])
        graph.add_sighting(Sighting(pose, landmark, range_m, bearing, NOISE))


@pytest.mark.parametrize("seed", range(4))
def test_all_scans_are_where_the_whole_graph_has_them(seed: int) -> None:
    """Those between two poses, those after the last, and with the same covariances."""
    made = drive(seed, num_poses=11)
    every, (graph, keyframes) = whole(made), thinned(made)
    assert graph.num_poses == 1 + len(SIGHTING)
    assert len(keyframes) == len(made.motions)
    poses = keyframes.trajectory(graph.estimate().map_T_bases)
    np.testing.assert_allclose(poses, every.estimate().map_T_bases[1:], atol=5e-3)
    covariances = keyframes.covariances(*graph.chain_covariances())
    expected = every.pose_covariances(range(1, every.num_poses))
    scales = np.sqrt(np.einsum("nii->ni", expected))
    np.testing.assert_allclose(
        (covariances - expected) / (scales[:, :, None] * scales[:, None, :]), 0.0, atol=0.05
    )
