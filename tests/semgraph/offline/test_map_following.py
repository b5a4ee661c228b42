"""Marks in pairs that nothing tells apart, taken for each other for a while."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from semgraph.arrays import IntArray
from semgraph.estimates import Trajectory
from semgraph.files.run_log import RunLog
from semgraph.geometry import Pose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import concatenate
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.batch_graph import BatchGraph
from semgraph.offline.map_following import _apart, _Hypotheses, followed
from semgraph.offline.resighting import misfit, resighted
from semgraph.offline.sight_habits import NEVER, SightHabits
from tests.semgraph.test_hypotheses import FIRSTS, MARKS, START, drive

SETTINGS = SmootherSettings()


@cache
def log_of_drive() -> tuple[RunLog, IntArray]:
    """What was measured, with poses by wheels alone, and the true marks."""
    steps, marks = drive()
    poses, pose = [], START
    for _, motion in steps:
        pose = pose @ motion.pose
        poses.append(pose.as_array())
    log = RunLog(
        Trajectory(np.arange(len(steps)) * 10**8, np.array(poses)),
        SETTINGS.start(START),
        np.array([motion.pose.as_array() for _, motion in steps]),
        np.array([motion.covariance for _, motion in steps]),
        concatenate(0, [seen for seen, _ in steps]),
        np.arange(len(steps)),
        marks,
    )
    return log, marks


def swapped(marks: IntArray, rows: slice) -> IntArray:
    """The other one of each pair."""
    taken_for = marks.copy()
    taken_for[rows] = (marks[rows] + len(FIRSTS)) % len(MARKS)
    return taken_for


def optimum(landmarks: IntArray) -> tuple[Batch, Belief]:
    log, _ = log_of_drive()
    batch = Batch.of(log)
    known = {k: MARKS[k] for k in np.unique(landmarks[landmarks >= 0]).tolist()}
    belief = Belief(log.trajectory.map_T_bases, landmarks, known)
    return batch, BatchGraph(batch, belief).optimum()


def test_the_map_tells_what_all_perceptions_together_are_of() -> None:
    batch, belief = optimum(log_of_drive()[1])
    wrong = belief.taken_for(swapped(belief.landmarks, slice(60, 200)))
    found = followed(batch, wrong)
    assert np.mean(found == belief.landmarks) > 0.97


def test_without_landmarks_all_is_of_nothing() -> None:
    batch, belief = optimum(log_of_drive()[1])
    nothing = belief.taken_for(np.full(len(belief.landmarks), -1))
    assert (followed(batch, nothing) == -1).all()


def test_a_scan_shows_each_landmark_once() -> None:
    batch, belief = optimum(log_of_drive()[1])
    twice = np.repeat(np.arange(len(batch.seen)), 2)
    double = replace(
        batch,
        seen=batch.seen.select(twice),
        scans=batch.scans[twice],
        covariances=batch.covariances[twice],
    )
    found = followed(double, replace(belief, landmarks=belief.landmarks[twice])).reshape(-1, 2)
    assert (found[(found[:, 0] == found[:, 1])] == -1).all()


def test_a_perception_is_of_nothing_that_has_another_identity() -> None:
    batch, belief = optimum(log_of_drive()[1])
    names = np.where(belief.landmarks == 2, "named", "")
    named = replace(batch, seen=replace(batch.seen, identities=names))
    found = followed(named, belief)
    assert set(found[belief.landmarks == 2].tolist()) <= {2, -1}
    assert 2 not in found[belief.landmarks != 2]


def test_wheels_that_slip_once_are_forgiven() -> None:
    marks = log_of_drive()[1]
    batch, belief = optimum(marks)
    motions = np.array(batch.motions)
    motions[120] = (Pose2.from_array(motions[120]) @ Pose2(0.0, 0.0, 0.4)).as_array()
    found = followed(replace(batch, motions=motions), belief)
    assert np.mean(found == marks) > 0.95


def test_what_is_true_is_more_probable_than_what_is_swapped_or_doubled() -> None:
    marks = log_of_drive()[1]
    truly = misfit(*optimum(marks))
    assert truly < misfit(*optimum(swapped(marks, slice(60, 200)))) - 100.0
    batch, belief = optimum(marks)
    new = np.where((marks == 0) & (np.arange(len(marks)) % 2 == 0), len(MARKS), marks)
    doubled = Belief(belief.map_T_bases, new, {**belief.map_t_landmarks, len(MARKS): MARKS[0]})
    assert truly < misfit(batch, BatchGraph(batch, doubled).optimum()) - 20.0


def test_a_run_that_was_wrong_for_a_while_is_put_right() -> None:
    log, marks = log_of_drive()
    wrong = swapped(marks, slice(100, 150))
    batch, belief = optimum(wrong)
    path = Trajectory(log.trajectory.stamps_ns, belief.map_T_bases)
    found = resighted(replace(log, trajectory=path, landmarks=wrong), SETTINGS, lambda _: None)
    those = found.belief.landmarks
    right = sum(np.bincount(marks[those == k]).max() for k in found.belief.map_t_landmarks)
    assert right / len(marks) > 0.95
    assert found.misfit < misfit(batch, belief)


def test_what_was_in_sight_is_rather_in_sight_again() -> None:
    batch, belief = optimum(log_of_drive()[1])
    habits = SightHabits.of(batch, belief.landmarks, len(MARKS))
    last = np.array([[9, 8, 2, NEVER]])
    surprises = habits.surprises(10, last)
    assert np.exp(-0.5 * surprises).sum() == pytest.approx(1.0)
    assert surprises[0, 0] < surprises[0, 2]
    assert (habits.by_age > 0.0).all()
    assert (habits.by_age < 1.0).all()


@pytest.mark.parametrize("heading", [0.0, 0.5 * np.pi, -3.0])
def test_hypotheses_are_of_one_place_by_their_own_sigmas(heading: float) -> None:
    """Unsure along, sure across: wherever that is in the map."""
    covariances = np.tile(np.diag([1.0, 0.01, 0.001]), (2, 1, 1))
    first = Pose2(3.0, -2.0, heading)

    def num_places(off: Pose2) -> int:
        poses = np.array([first.as_array(), (first @ off).as_array()])
        nothing = np.zeros((2, 0), dtype=np.int64)
        costs, parents = np.array([0.0, 1.0]), np.zeros(2, dtype=np.int64)
        return len(_apart(_Hypotheses(poses, covariances, costs, parents, nothing, nothing)))

    assert num_places(Pose2(0.3, 0.0, 0.0)) == 1
    assert num_places(Pose2(0.0, 0.3, 0.0)) == 2
    assert num_places(Pose2(0.0, 0.0, 0.1)) == 2
