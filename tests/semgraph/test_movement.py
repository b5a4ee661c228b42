"""What is to be expected of a robot that moved as its places tell."""

import numpy as np
import pytest

from semgraph.geometry import Pose2, UncertainPose2
from semgraph.motion_model import MotionNoise
from semgraph.movement import Movement

SECOND_NS = 1_000_000_000
NOISE = MotionNoise()
STEP = Pose2(1.0, 0.0, 0.1)


def moved(num_steps: int, step: Pose2 = STEP, num_known: int = 5) -> Movement:
    """That often the same, each second, with so many landmarks known at each end."""
    movement = Movement(NOISE)
    movement.note(0, Pose2(), Pose2(), num_known, is_seen=False, is_perceived=False)
    for k in range(1, num_steps + 1):
        expected = movement.expected(k * SECOND_NS).pose
        movement.note(k * SECOND_NS, expected, step, num_known, is_seen=True, is_perceived=True)
    return movement


def sigmas(motion: UncertainPose2) -> list[float]:
    sigmas: list[float] = np.sqrt(np.diag(motion.covariance)).tolist()
    return sigmas


def test_before_the_first_scan_the_robot_is_where_it_is() -> None:
    motion = Movement(NOISE).expected(5 * SECOND_NS)
    assert motion.pose == Pose2()
    assert max(sigmas(motion)) < 1e-5


def test_the_last_movement_comes_once_more_as_long_as_the_time_that_passes() -> None:
    motion = moved(3).expected(3 * SECOND_NS + SECOND_NS // 2)
    np.testing.assert_allclose(motion.pose.as_array(), [0.5, 0.0, 0.05], atol=1e-9)


def test_who_moves_evenly_is_expected_to() -> None:
    movement = moved(30)
    at = 31 * SECOND_NS
    assert sigmas(movement.usual(at))[0] < 0.2 * sigmas(movement.expected(at))[0]
    assert sigmas(moved(5).usual(6 * SECOND_NS)) == sigmas(moved(5).expected(6 * SECOND_NS))


def test_a_speed_that_nobody_saw_says_nothing_though_it_is_gone_on_with() -> None:
    at = 4 * SECOND_NS
    seen, unseen = moved(3), moved(3, num_known=1)
    assert seen.told(at, seen.expected(at)).covariance.trace() == pytest.approx(
        seen.expected(at).covariance.trace()
    )
    told = unseen.told(at, unseen.expected(at))
    assert told.pose == unseen.expected(at).pose
    assert sigmas(told)[0] > NOISE.unknown_speed


def test_without_places_the_velocity_wanders_until_it_is_unknown() -> None:
    movement = moved(3)
    along_m = []
    for k in range(4, 8):
        motion = movement.expected(k * SECOND_NS)
        along_m.append(sigmas(motion)[0])
        movement.note(k * SECOND_NS, motion.pose, motion.pose, 0, is_seen=False, is_perceived=False)
    assert (np.diff(along_m)[:2] > 0.5).all()
    assert along_m[-1] == pytest.approx(NOISE.unknown_speed + NOISE.floor_m)


def test_from_what_begins_to_be_seen_an_unknown_speed_leads_no_farther_than_it_can() -> None:
    """However long nothing was seen before; for where that was it stays as unknown."""
    movement = Movement(NOISE)
    for k in range(20):
        num_known = 2 * (k == 19)
        pose = movement.expected(k * SECOND_NS).pose
        movement.note(k * SECOND_NS, pose, pose, num_known, is_seen=False, is_perceived=False)
    soon = 19 * SECOND_NS + SECOND_NS // 5
    expected = movement.expected(soon)
    assert sigmas(expected)[0] == pytest.approx(0.2 * NOISE.unknown_speed + NOISE.floor_m)
    assert sigmas(movement.told(soon, expected))[0] > 2.0 * NOISE.unknown_speed


def test_after_a_restart_the_speed_is_unknown_and_the_habit_is_not() -> None:
    movement = moved(30)
    movement.restart(40 * SECOND_NS)
    assert movement.expected(41 * SECOND_NS).pose == Pose2()
    assert sigmas(movement.expected(41 * SECOND_NS))[0] >= NOISE.unknown_speed
    for k in (41, 42):
        movement.note(k * SECOND_NS, Pose2(), STEP, 5, is_seen=True, is_perceived=True)
    at = 43 * SECOND_NS
    assert sigmas(movement.usual(at))[0] < 0.2 * sigmas(movement.expected(at))[0]
