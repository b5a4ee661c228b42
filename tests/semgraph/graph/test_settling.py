"""A graph that moves far when a loop closes comes to rest where the batch solver does."""

import numpy as np
import pytest

from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.measurement_model import predict
from tests.semgraph.drives import START

RING_M = 240.0
NUM_POSES = 480
NOISE = np.diag([0.1, 0.01]) ** 2
# What is sighted once more after a lap is called anew.
ANEW = 10_000


def ring(seed: int, unknown_m: float) -> tuple[FactorGraph, dict[int, int]]:
    """A lap and a little more without wheels, after a motion of which next to nothing is known.

    Returns:
        the graph, and what was called anew, with its first name.
    """
    rng = np.random.default_rng(seed)
    angles = 2.0 * np.pi * np.arange(NUM_POSES + 6) / NUM_POSES
    map_T_bases = np.column_stack(
        [RING_M * np.cos(angles), RING_M * np.sin(angles), angles + np.pi / 2.0]
    )
    radii, turns = RING_M + rng.uniform(-10.0, 10.0, 2000), rng.uniform(0.0, 2.0 * np.pi, 2000)
    trees = radii[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
    graph = FactorGraph(START)
    unknown = UncertainPose2(Pose2(), np.diag([unknown_m, unknown_m, 1.8]) ** 2)
    step = Pose2.from_array(map_T_bases[0]).between(Pose2.from_array(map_T_bases[1]))
    usual = UncertainPose2(step, np.diag([2.0, 2.0, 0.3]) ** 2)
    known = Pose2()
    for k, map_T_base in enumerate(map_T_bases):
        known = known @ step if k else Pose2(3.0, 1.0, 0.5)
        pose = graph.add_pose(usual if k else unknown, known)
        for tree in np.flatnonzero(np.hypot(*(trees - map_T_base[:2]).T) < 12.0).tolist():
            true = predict(Pose2.from_array(map_T_base), trees[[tree]])[0]
            range_m, bearing = (true + rng.normal(size=2) * np.sqrt(np.diag(NOISE))).tolist()
            range_m = max(range_m, 0.1)
            name = tree + ANEW * (k > NUM_POSES // 2)
            if name not in graph.landmarks():
                graph.add_landmark(
                    name,
                    known.transform(range_m * np.array([[np.cos(bearing), np.sin(bearing)]]))[0],
                )
            graph.add_sighting(Sighting(pose, name, range_m, bearing, NOISE, track=name))
        if k % 5 == 4:
            graph.update()
            known = graph.pose(pose)
    graph.update()
    return graph, {
        name: name - ANEW
        for name in graph.landmarks()
        if name - ANEW in graph.landmarks() and graph.sighted(name).poses.max() > NUM_POSES
        if (graph.sighted(name - ANEW).poses < NUM_POSES // 4).all()
    }


@pytest.mark.parametrize("seed", range(3))
def test_a_loop_closed_far_off_settles_near_the_optimum(seed: int) -> None:
    """iSAM2 looks for what has moved from the root on; here the root is where nothing has.

    Where the kernel has let go what it should hold, only a batch gets to the optimum.
    """
    graph, pairs = ring(seed, unknown_m=200.0)
    assert len(pairs) > 5
    for anew, first in pairs.items():
        graph.merge(anew, first)
    graph.update(relinearize=True)
    graph.settle()
    settled = graph.cost()
    graph.optimize()
    condensed = graph.cost()
    graph.polish()
    assert settled < 1.4 * graph.cost()
    assert condensed < 1.001 * graph.cost()
