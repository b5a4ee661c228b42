"""Both estimators together: who is at work when, hand-overs, kidnapping, leaps."""

import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.known_map.fixed_map import FixedMap
from semgraph.localizer import (
    Estimator,
    Localized,
    Localizer,
    LocalizerSettings,
    Start,
    Use,
    start_of,
)
from tests.semgraph.stands import measured, perceive, stand

STEP = Pose2(0.3, 0.0, 0.03)


def drive(
    localizer: Localizer,
    trees: FixedMap,
    poses: list[Pose2],
    seed: int = 0,
    *,
    odometry: bool = True,
    since: int = 0,
) -> list[Localized]:
    """Poses 0.1 s apart; wheels measure each motion, but none across the start."""
    rng, found = np.random.default_rng(seed), []
    for k, pose in enumerate(poses):
        motion = poses[k - 1].between(pose) if k else Pose2()
        wheels = measured(motion, rng) if odometry else None
        stamp_ns = (since + k) * 100_000_000
        found.append(localizer.step(perceive(trees, pose, stamp_ns, rng), wheels))
    return found


def way(start: Pose2, num_poses: int, step: Pose2 = STEP) -> list[Pose2]:
    poses = [start]
    for _ in range(num_poses - 1):
        poses.append(poses[-1] @ step)
    return poses


def off_m(found: Localized, pose: Pose2) -> float:
    off = found.map_T_base.pose.between(pose)
    return float(np.hypot(off.x, off.y))


def test_particles_begin_and_the_fast_estimator_goes_on() -> None:
    trees = stand(num_trees=80)
    localizer = Localizer(trees, LocalizerSettings(), Start())
    poses = way(Pose2(20.0, 25.0, 0.5), 20)
    found = drive(localizer, trees, poses)
    assert found[0].estimator is Estimator.PARTICLES
    assert found[-1].estimator is Estimator.FAST
    assert len(localizer.events) == 1
    assert "fast estimator takes over" in localizer.events[0]
    assert max(off_m(each, pose) for each, pose in zip(found[3:], poses[3:], strict=True)) < 0.15
    assert found[-1].quality > 0.99


def test_covariance_is_handed_over() -> None:
    trees = stand(num_trees=80)
    localizer = Localizer(trees, LocalizerSettings(), Start())
    found = drive(localizer, trees, way(Pose2(20.0, 25.0, 0.5), 8))
    first_fast = next(k for k, each in enumerate(found) if each.estimator is Estimator.FAST)
    before, after = found[first_fast - 1 : first_fast + 1]
    ratio = np.sqrt(np.diag(after.map_T_base.covariance) / np.diag(before.map_T_base.covariance))
    assert (ratio < 3.0).all()
    assert (ratio > 0.1).all()


def test_carried_off_it_is_noticed_and_found_again() -> None:
    trees = stand(num_trees=80)
    localizer = Localizer(trees, LocalizerSettings(), Start())
    drive(localizer, trees, way(Pose2(15.0, 15.0, 0.5), 10))
    poses = way(Pose2(42.0, 45.0, -2.0), 30)
    found = drive(localizer, trees, poses, 1, since=10)
    # Within 3 m it no longer claims to be where it is not, within 9 m it is found.
    assert not any(
        each.quality > 0.5 and off_m(each, pose) > 1.0
        for each, pose in zip(found[10:], poses[10:], strict=True)
    )
    assert off_m(found[-1], poses[-1]) < 0.2
    assert any("particle filter takes over" in event for event in localizer.events)


def test_a_leap_without_wheels_is_survived() -> None:
    trees = stand(num_trees=80)
    localizer = Localizer(trees, LocalizerSettings(), Start())
    step = Pose2(0.1, 0.0, 0.01)
    poses = way(Pose2(20.0, 25.0, 0.5), 10, step)
    poses += way(poses[-1] @ Pose2(4.0, 1.0, 0.8), 8, step)
    found = drive(localizer, trees, poses, odometry=False)
    assert max(off_m(each, pose) for each, pose in zip(found[12:], poses[12:], strict=True)) < 0.2


def test_large_measured_motion_is_the_particles() -> None:
    trees = stand(num_trees=80)
    localizer = Localizer(trees, LocalizerSettings(), Start())
    poses = way(Pose2(20.0, 25.0, 0.5), 10)
    poses.append(poses[-1] @ Pose2(2.5, 0.0, 0.6))
    found = drive(localizer, trees, poses)
    assert found[-2].estimator is Estimator.FAST
    assert found[-1].estimator is Estimator.PARTICLES
    assert "moved 2." in localizer.events[-1]
    assert off_m(found[-1], poses[-1]) < 0.2


def test_each_can_be_kept_to() -> None:
    trees = stand(num_trees=80)
    poses = way(Pose2(20.0, 25.0, 0.5), 10)
    particles = Localizer(trees, LocalizerSettings(use=Use.PARTICLES), Start())
    assert {each.estimator for each in drive(particles, trees, poses)} == {Estimator.PARTICLES}
    assert particles.events == ()
    fast = Localizer(trees, LocalizerSettings(use=Use.FAST), Start())
    drive(fast, trees, poses)
    lost = drive(fast, trees, way(Pose2(42.0, 45.0, -2.0), 10), since=10)
    assert {each.estimator for each in lost} == {Estimator.FAST}
    assert lost[-1].quality < 0.5


def test_the_same_seed_gives_the_same_run() -> None:
    trees, poses = stand(), way(Pose2(20.0, 25.0, 0.5), 6)
    runs = [drive(Localizer(trees, LocalizerSettings(), Start()), trees, poses) for _ in range(2)]
    assert [each.map_T_base.pose for each in runs[0]] == [each.map_T_base.pose for each in runs[1]]


def test_a_start_is_taken_from_the_command_line() -> None:
    at = start_of((1.0, 2.0, 90.0), None).map_T_base
    assert isinstance(at, UncertainPose2)
    np.testing.assert_allclose(at.pose.as_array(), [1.0, 2.0, np.pi / 2])
    circle = start_of(None, (10.0, 3.0, 4.0))
    assert (circle.radius_m, circle.map_t_point) == (10.0, (3.0, 4.0))
    assert start_of(None, None) == Start()
    with pytest.raises(InputError, match="radius above 0"):
        start_of(None, (0.0, 3.0, 4.0))
    with pytest.raises(InputError, match="finite"):
        start_of((float("nan"), 0.0, 0.0), None)


def test_a_pose_and_a_radius_begin_near() -> None:
    trees = stand(num_trees=80)
    true = Pose2(20.0, 25.0, 0.5)
    rough = UncertainPose2(true @ Pose2(0.2, -0.2, 0.03), np.diag([0.3, 0.3, 0.05]) ** 2)
    for start in (Start(rough), Start(map_t_point=(22.0, 24.0), radius_m=5.0)):
        found = drive(Localizer(trees, LocalizerSettings(), start), trees, way(true, 3))
        assert off_m(found[-1], way(true, 3)[-1]) < 0.2
