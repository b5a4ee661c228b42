"""Marks in pairs that nothing tells apart, one seen a scan, and wheels that turn unsurely."""

from functools import cache

import numpy as np
import pytest

from evaluation.association_causes import num_wrong
from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.fast_estimator import FastEstimator
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.hypotheses import HypothesesTracker
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from semgraph.measurement_model import predict
from semgraph.settings import TrackerSettings
from semgraph.tracking import Tracker, tracker_of
from sensors.measurements import OdometryNoise, Recording

FIRSTS = np.array([[0.0, 3.0], [3.0, 0.0], [-3.0, 0.0], [0.0, -3.0]])
SECONDS = FIRSTS + np.where(FIRSTS[:, :1] == 0.0, (0.7, 0.0), (0.0, 0.7))
MARKS = np.vstack([FIRSTS, SECONDS])
RANGE_SIGMA_M, BEARING_SIGMA = 0.05, 0.02
WHEELS = np.diag([0.02, 0.02, 0.05]) ** 2
STEP = Pose2(0.1, 0.0, 0.1)
START = Pose2(0.0, -1.0, 0.0)


def seen(stamp_ns: int, z: FloatArray, identity: str = "", kind: Kind = Kind.MARKER) -> Perceptions:
    n = len(z)
    sigmas = np.full(n, RANGE_SIGMA_M), np.full(n, BEARING_SIGMA)
    names = np.full(n, identity)
    return Perceptions.from_arrays(
        stamp_ns, kind, z[:, 0], z[:, 1], polar_covariances(*sigmas), identities=names
    )


@cache
def drive() -> tuple[list[tuple[Perceptions, UncertainPose2]], IntArray]:
    """Four rounds on a circle of 1 m, and the true mark of each perception."""
    rng, pose = np.random.default_rng(4), START
    steps, marks = [], []
    for k in range(250):
        motion = STEP if k else Pose2()
        pose = pose @ motion
        z = predict(pose, MARKS)
        ahead = np.flatnonzero(np.abs(z[:, 1]) < 0.6)
        mark = rng.choice(ahead) if len(ahead) else int(np.abs(z[:, 1]).argmin())
        noisy = z[[mark]] + rng.standard_normal((1, 2)) * (RANGE_SIGMA_M, BEARING_SIGMA)
        told = motion.as_array() + rng.standard_normal(3) * np.sqrt(np.diag(WHEELS))
        steps.append((seen(10**8 * k, noisy), UncertainPose2(Pose2.from_array(told), WHEELS)))
        marks.append(mark)
    return steps, np.array(marks)


def followed(tracker: Tracker) -> IntArray:
    return np.concatenate([tracker.step(*each).landmark_ids for each in drive()[0]])


def many(n: int = 300, seed: int = 1) -> HypothesesTracker:
    return HypothesesTracker(n, 0.03, START, np.random.default_rng(seed))


def test_it_tells_apart_what_one_hypothesis_confuses() -> None:
    marks = drive()[1]
    one = followed(FastEstimator(TrackerSettings(), START))
    found = followed(many(500))
    assert num_wrong(one, marks) > 0.2 * len(marks)
    assert num_wrong(found, marks) < 0.25 * num_wrong(one, marks)
    assert np.mean(found < 0) < 0.1
    assert len(np.unique(found)) < 20


def test_the_same_seed_gives_the_same_tracks() -> None:
    assert np.array_equal(followed(many(50)), followed(many(50)))


def test_its_frame_drifts_like_the_wheels_and_never_jumps() -> None:
    tracker, pose = many(50), START
    for perceptions, motion in drive()[0][:50]:
        pose = pose @ motion.pose
        step = tracker.step(perceptions, motion)
        assert step.map_T_base.pose.as_array() == pytest.approx(pose.as_array())
        assert step.motion is motion


STILL = UncertainPose2(Pose2(), 1e-6 * np.eye(3))
HERE = np.array([[2.0, 0.1]])


@pytest.mark.parametrize(
    "other", [seen(1, HERE, identity="b"), seen(1, HERE, kind=Kind.TREE)], ids=["name", "kind"]
)
def test_what_is_named_or_looks_otherwise_is_another(other: Perceptions) -> None:
    tracker = many(50)
    (first,) = tracker.step(seen(0, HERE), STILL).landmark_ids
    (second,) = tracker.step(other, STILL).landmark_ids
    (again,) = tracker.step(seen(2, HERE), STILL).landmark_ids
    assert first == again >= 0
    assert second not in (first, -1)


def test_two_of_one_scan_are_never_one() -> None:
    ids = many(50).step(seen(0, np.vstack([HERE, HERE])), STILL).landmark_ids
    assert len(np.unique(ids)) == 2


def test_nothing_perceived_is_no_error() -> None:
    assert len(many(50).step(seen(0, np.zeros((0, 2))), STILL).landmark_ids) == 0


def test_while_hypotheses_disagree_a_perception_is_of_nothing() -> None:
    """After a turn that may be any, either of two marks, or another, may be seen."""
    tracker = many(300)
    pair = np.array([[2.0, 0.3], [2.0, -0.3], [2.0, 0.9], [2.0, -0.9]])
    for k in range(5):
        tracker.step(seen(k, pair), STILL)
    unsure = UncertainPose2(Pose2(), np.diag([1e-6, 1e-6, 1.0]))
    assert tracker.step(seen(9, np.array([[2.0, 0.0]])), unsure).landmark_ids.tolist() == [-1]


def test_after_wheels_slipped_marks_are_what_they_were() -> None:
    """Turned by six sigma, what is seen then fits no landmark but by a slip."""
    around = np.column_stack([[2.0, 2.5, 3.0, 2.0], [0.0, 0.9, -0.8, 2.0]])
    tracker, wheels = many(1000), UncertainPose2(Pose2(), WHEELS)
    before = [tracker.step(seen(k, around), wheels).landmark_ids for k in range(10)][-1]
    turned = around - (0.0, 6.0 * WHEELS[2, 2] ** 0.5)
    after = [tracker.step(seen(10 + k, turned), wheels).landmark_ids for k in range(5)][-1]
    assert after.tolist() == before.tolist()


def test_without_wheels_it_says_what_to_do() -> None:
    with pytest.raises(InputError, match="expected wheel odometry"):
        many(50).step(seen(0, HERE), None)


def test_as_many_hypotheses_as_told_or_else_as_the_recording_asks_for() -> None:
    asks = Recording("few marks", (), 0, OdometryNoise(), num_hypotheses=60)
    one = TrackerSettings(hypotheses=1)
    assert isinstance(tracker_of(asks, TrackerSettings()), HypothesesTracker)
    assert isinstance(tracker_of(asks, one), FastEstimator)
    assert isinstance(tracker_of(Recording("plain", (), 0), TrackerSettings()), FastEstimator)
    with pytest.raises(InputError, match=r"few marks: expected wheel odometry.*hypotheses=1"):
        tracker_of(Recording("few marks", (), 0, num_hypotheses=60), TrackerSettings())
