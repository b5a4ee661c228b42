"""The plain loop, the optimum with known identities and its cost, on a course of known truth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from evaluation.benches.plain_loop import KnownGraph, Solution, every_pose, every_scan, plain_loop
from evaluation.trajectory import compare_path, rmse
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from sensors.catalog import open_source
from sensors.dead_reckoning import in_order_of_time
from sensors.truth import Source
from tests.evaluation.known_course import known_course
from tests.sensors.sources import odometry_of, perceptions_of


@cache
def course() -> tuple[Source, KnownGraph, Solution, Solution]:
    source = known_course()
    start, steps = source.recording.map_T_start, every_pose(source.recording)
    graph, plain = KnownGraph(every_scan(source.recording), start), plain_loop(steps, start)
    return source, graph, plain, graph.optimum(plain)


def test_loop_and_optimum_are_near_the_truth_and_the_optimum_is_one() -> None:
    source, graph, plain, best = course()
    assert source.truth.path is not None
    for solution in (plain, best):
        errors = compare_path(solution.trajectory, source.truth.path)
        assert errors is not None
        assert rmse(errors.distances) < 0.05
    assert len(best.map_t_landmarks) == 30
    assert graph.cost(best) <= graph.cost(plain) < 1.2 * graph.cost(best)
    num_sightings = sum(len(scan) for scan in perceptions_of(source.recording))
    # Each residual's square is half a degree of freedom's.
    assert graph.cost(best) == pytest.approx(num_sightings, rel=0.15)


def test_a_moved_pose_costs_and_lacking_landmarks_are_placed_at_their_best() -> None:
    _, graph, _, best = course()
    poses = best.trajectory.map_T_bases.copy()
    poses[40, 0] += 0.05
    moved = Solution(Trajectory(best.trajectory.stamps_ns, poses), best.map_t_landmarks)
    assert graph.cost(moved) > graph.cost(best) + 1.0
    some = dict(list(best.map_t_landmarks.items())[:10])
    assert graph.cost(Solution(best.trajectory, some)) == pytest.approx(graph.cost(best), rel=1e-6)


def test_of_several_starts_the_best_optimum_is_taken() -> None:
    _, graph, plain, best = course()
    poses = best.trajectory.map_T_bases.copy()
    poses[60:, 2] += 2.0
    bad = Solution(Trajectory(best.trajectory.stamps_ns, poses), best.map_t_landmarks)
    assert graph.cost(graph.optimum(bad, plain)) <= graph.cost(graph.optimum(plain))


def test_poses_between_scans_are_composed_to_the_same_motion() -> None:
    source = known_course()
    scans, wheels = perceptions_of(source.recording)[::3], odometry_of(source.recording)
    sparse = in_order_of_time(wheels, scans)
    recording = replace(source.recording, measurements=sparse, num_scans=len(scans))
    poses, composed = every_pose(recording), every_scan(recording)
    assert (len(poses), len(composed)) == (len(wheels), len(scans))
    motion = poses[1].motion @ poses[2].motion @ poses[3].motion
    np.testing.assert_allclose(
        composed[1].motion.pose.as_array(), motion.pose.as_array(), atol=1e-9
    )


def test_a_graph_without_identities_or_wheels_is_refused() -> None:
    options = {"lap_s": 2.0}
    blind = open_source("course:perceptions", options).recording
    with pytest.raises(InputError, match="wheel odometry"):
        every_scan(blind)
    with_wheels = open_source("course:perceptions", {**options, "odometry": True}).recording
    for steps in (every_scan, every_pose):
        with pytest.raises(InputError, match="identity"):
            steps(with_wheels)
