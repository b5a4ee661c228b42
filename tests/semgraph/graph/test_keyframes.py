"""Leaving scans without sightings out of the graph changes nothing about the others."""

from dataclasses import replace

import numpy as np
import pytest

from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.graph.keyframes import Keyframes
from tests.semgraph.drives import LANDMARKS, NOISE, Drive, drive

SIGHTING = (1, 2, 5, 9)


def whole(made: Drive) -> FactorGraph:
    """Every scan is a pose."""
    graph = FactorGraph(made.start)
    for scan, (motion, guess) in enumerate(zip(made.motions, made.guesses, strict=True), start=1):
        sight(graph, made, scan, graph.add_pose(motion, guess))
    graph.polish()
    return graph


def thinned(made: Drive, *, bends: bool = False) -> tuple[FactorGraph, Keyframes]:
    """Only scans that sight something are; with `bends` those before it is too unsure, too."""
    graph, keyframes = FactorGraph(made.start), Keyframes()
    for scan, (motion, guess) in enumerate(zip(made.motions, made.guesses, strict=True), start=1):
        keyframes.move(motion)
        if scan in SIGHTING or (bends and keyframes.is_bent):
            pose = graph.add_pose(keyframes.since_last, guess)
            keyframes.add_pose(pose)
            sight(graph, made, scan, pose)
        else:
            keyframes.add_between(graph.num_poses - 1)
    graph.polish()
    return graph, keyframes


def calm(made: Drive) -> Drive:
    """The same with steps that hardly err."""
    true = Pose2(1.0, 0.05, 0.1)
    motions = []
    for motion in made.motions:
        error = 0.1 * true.between(motion.pose).as_array()
        motions.append(UncertainPose2(true @ Pose2.from_array(error), motion.covariance))
    return replace(made, motions=motions)


def unsteady(made: Drive, seed: int) -> Drive:
    """The same with headings that err by 0.15 rad in each step, and say so."""
    turns, more = np.random.default_rng(seed).normal(0.0, 0.15, len(made.motions)), 0.15**2
    motions = [
        UncertainPose2(
            motion.pose @ Pose2(0.0, 0.0, turn), motion.covariance + np.diag([0.0, 0.0, more])
        )
        for motion, turn in zip(made.motions, turns.tolist(), strict=True)
    ]
    return replace(made, motions=motions)


def sight(graph: FactorGraph, made: Drive, scan: int, pose: int) -> None:
    if scan not in SIGHTING:
        return
    for _, landmark, range_m, bearing in made.of_pose(scan):
        if landmark not in graph.landmarks():
            graph.add_landmark(landmark, made.start.pose.transform(LANDMARKS[[landmark]])[0])
        graph.add_sighting(Sighting(pose, landmark, range_m, bearing, NOISE))


@pytest.mark.parametrize("seed", range(4))
def test_all_scans_are_where_the_whole_graph_has_them(seed: int) -> None:
    """Those between two poses, those after the last, and with the same covariances.

    To first order: both linearize the same motions elsewhere. Odometry here errs by a tenth of
    what it says, and what is left of the second order with that.
    """
    made = calm(drive(seed, num_poses=11))
    every, (graph, keyframes) = whole(made), thinned(made)
    assert graph.num_poses == 1 + len(SIGHTING)
    assert len(keyframes) == len(made.motions)
    poses = keyframes.trajectory(graph.estimate().map_T_bases)
    np.testing.assert_allclose(poses, every.estimate().map_T_bases[1:], atol=1e-3)
    covariances = keyframes.covariances(*graph.chain_covariances())
    expected = every.pose_covariances(range(1, every.num_poses))
    scales = np.sqrt(np.einsum("nii->ni", expected))
    np.testing.assert_allclose(
        (covariances - expected) / (scales[:, :, None] * scales[:, None, :]), 0.0, atol=0.02
    )


@pytest.mark.parametrize("seed", range(4))
def test_where_headings_are_unsure_scans_between_stay_poses(seed: int) -> None:
    """Composed as if along a line, what comes after is elsewhere."""
    made = unsteady(drive(seed, num_poses=11), seed)
    expected = whole(made).estimate().map_T_bases[1:]
    off = []
    for bends in (False, True):
        graph, keyframes = thinned(made, bends=bends)
        poses = keyframes.trajectory(graph.estimate().map_T_bases)
        off.append(np.abs(poses - expected)[:, :2].max())
    assert off[1] < 1e-3 < off[0]


def test_wheels_are_sure_enough_to_compose() -> None:
    keyframes, step = Keyframes(), UncertainPose2(Pose2(0.2, 0.0, 0.01), 1e-6 * np.eye(3))
    for _ in range(1000):
        keyframes.move(step)
        keyframes.add_between(0)
    assert not keyframes.is_bent
