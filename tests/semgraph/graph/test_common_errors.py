"""Errors that all sightings of a thing share, beside graphs that were measured with them."""

from dataclasses import replace

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.geometry import relative_poses
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.batch_graph import BatchGraph
from tests.semgraph.drives import LANDMARKS, NOISE, Drive, drive
from tests.semgraph.logs import log, places

SHARES = np.array([0.5, 0.0, 0.2, 1.0])
SIGMA_M = float(np.sqrt(NOISE[0, 0]))


def built(made: Drive, shares: FloatArray, longer_m: FloatArray | None = None) -> FactorGraph:
    """The optimum, where ranges to each landmark are longer by so much."""
    graph = FactorGraph(made.start)
    for landmark, place in enumerate(LANDMARKS):
        graph.add_landmark(landmark, place)
    longer_m = np.zeros(4) if longer_m is None else longer_m
    for pose, (motion, guess) in enumerate(zip(made.motions, made.guesses, strict=True), start=1):
        graph.add_pose(motion, guess)
        for _, k, range_m, bearing in made.of_pose(pose):
            graph.add_sighting(
                Sighting(
                    pose,
                    k,
                    range_m + float(longer_m[k]),
                    bearing,
                    NOISE,
                    common_share=float(shares[k]),
                )
            )
    graph.update()
    graph.polish()
    return graph


def shifts(made: Drive) -> tuple[FloatArray, FloatArray]:
    """(4, n, 3) of poses and (4, 4, 2) of landmarks by each landmark's error of one sigma."""
    little = 0.01
    before = built(made, SHARES).estimate()
    of_poses, of_landmarks = [], []
    for k, share in enumerate(SHARES):
        longer_m = np.zeros(4)
        longer_m[k] = little * np.sqrt(share) * SIGMA_M
        after = built(made, SHARES, longer_m).estimate()
        of_poses.append(relative_poses(before.map_T_bases, after.map_T_bases) / little)
        of_landmarks.append(
            [(after.map_t_landmarks[j] - before.map_t_landmarks[j]) / little for j in range(4)]
        )
    return np.array(of_poses), np.array(of_landmarks)


def assert_about(found: FloatArray, moved: FloatArray) -> None:
    """To what linearization leaves."""
    np.testing.assert_allclose(found, moved, rtol=0.03, atol=0.02 * float(np.abs(moved).max()))


def test_what_they_add_is_what_they_move() -> None:
    made = drive(seed=2)
    of_poses, of_landmarks = shifts(made)
    alone, shared = built(made, np.zeros(4)), built(made, SHARES)
    (own, crosses), (own_shared, crosses_shared) = (
        each.chain_covariances() for each in (alone, shared)
    )
    moved = np.einsum("kni,knj->nij", of_poses, of_poses)
    assert_about(own_shared - own, moved)
    with_next = np.einsum("kni,knj->nij", of_poses[:, :-1], of_poses[:, 1:])
    assert_about((crosses_shared - crosses)[:-1], with_next)
    assert not (crosses_shared - crosses)[-1].any()
    added = shared.landmark_covariances(range(4)) - alone.landmark_covariances(range(4))
    moved = np.einsum("kni,knj->nij", of_landmarks, of_landmarks)
    assert_about(added, moved)
    assert added[3].trace() > 0.5 * SIGMA_M**2


def test_the_batch_adds_the_same_as_the_graph() -> None:
    measured = log()
    shares = np.tile(SHARES, len(measured.seen) // 4)
    batches = [
        Batch.of(replace(measured, seen=replace(measured.seen, common_shares=each)))
        for each in (np.zeros(len(shares)), shares)
    ]
    begin = Belief(
        measured.trajectory.map_T_bases, np.arange(len(shares), dtype=np.int64) % 4, places()
    )
    added = []
    for batch in batches:
        at_once = BatchGraph(batch, begin)
        at_once.optimum()
        added.append((at_once.pose_covariances(), at_once.landmark_covariances(range(4))))
    whole = FactorGraph(measured.start)
    for landmark, place in places().items():
        whole.add_landmark(landmark, place)
    for scan in range(len(measured.motions)):
        pose = whole.add_pose(
            measured.motion(scan), batches[0].starts[0].pose @ measured.motion(scan).pose
        )
        for row in np.flatnonzero(measured.scans == scan).tolist():
            whole.add_sighting(Sighting.of(batches[1].seen, row, pose, row % 4))
    whole.update()
    whole.polish()
    for of_batch, of_graph in zip(
        added[1],
        (whole.chain_covariances()[0][1:], whole.landmark_covariances(range(4))),
        strict=True,
    ):
        np.testing.assert_allclose(of_batch, of_graph, rtol=1e-3, atol=1e-9)
    assert (np.linalg.eigvalsh(added[1][1] - added[0][1])[:, 1] > 0.0).all()
