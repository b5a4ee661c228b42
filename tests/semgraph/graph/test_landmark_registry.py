"""A wrong merge is taken back, and all is as if it never had been; a right one stands."""

import numpy as np
import pytest

from semgraph.decisions import What
from semgraph.fast_estimator import FastEstimator
from semgraph.files.yaw_rates import YawRateLog
from semgraph.graph.landmark_registry import LandmarkRegistry
from semgraph.graph.loop_closure import Closure
from semgraph.graph.smoother import Smoother
from semgraph.landmarks import Kind, Perceptions
from semgraph.moments import moments
from semgraph.perceiving import Perceiver
from semgraph.settings import Settings
from sensors.simulation.courses.perceptions import CourseOptions, read

COURSE = CourseOptions(
    scan_rate_hz=4.0, num_trees=60, track_radius_m=12.0, band_m=6.0, lap_s=24.0, max_range_m=8.0
)


def followed(seed: int, misled_at: int | None) -> tuple[Smoother, set[frozenset[int]]]:
    """A run; at one scan two landmarks that are 0.5 m or more apart are made one by force."""
    recording = read("course:perceptions", COURSE.model_copy(update={"seed": seed})).recording
    settings = Settings()
    tracker = FastEstimator(settings.tracker, recording.map_T_start)
    smoother = Smoother(settings.smoother, recording.map_T_start)
    forced: set[frozenset[int]] = set()
    perceiver = Perceiver(recording, settings)
    for scan, moment in enumerate(moments(recording, perceiver, YawRateLog())):
        step = tracker.step(moment.perceptions, moment.odometry)
        smoother.add(step, moment.perceptions, moment.views)
        if scan == misled_at:
            forced.add(mislead(smoother))
    smoother.finish(lambda _: None)
    return smoother, forced


def mislead(smoother: Smoother) -> frozenset[int]:
    """Makes one of two trees that were never seen at one time."""
    graph, known = smoother._graph, smoother._registry.landmarks
    graph.update()
    often = [each for each in graph.landmarks() if known[each].num_sightings > 8]
    recent, old = next(
        (b, a) for a in often for b in often[::-1] if a < b and known[a].may_be(known[b])
    )
    smoother._merging.close([Closure(recent, old, 5.0)])
    return frozenset((recent, old))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_wrong_merge_is_taken_back(seed: int) -> None:
    smoother, forced = followed(seed, 59)
    taken_back = {
        frozenset((each.landmark, each.other))
        for each in smoother.decisions
        if each.what is What.TAKEN_BACK
    }
    assert taken_back == forced
    undisturbed, _ = followed(seed, None)
    assert len(smoother.landmarks()) == len(undisturbed.landmarks())
    np.testing.assert_allclose(
        smoother.trajectory().map_T_bases, undisturbed.trajectory().map_T_bases, atol=0.02
    )


def test_what_was_known_before_is_known_again() -> None:
    """Sightings, diameters and later tracks; and what was taken back is not proposed again."""
    registry = LandmarkRegistry()
    for tracker_id in range(3):
        for scan in range(5 * tracker_id, 5 * tracker_id + 4):
            seen = perceived(scan, 0.2 + 0.1 * tracker_id)
            track = registry.track(tracker_id, seen, 0)
            registry.landmarks.setdefault(track.landmark, track.known)
            track.sight(scan, seen, 0)
    registry.merge(Closure(1, 0, 7.0), 9)
    registry.merge(Closure(2, 0, 7.0), 14)
    assert registry.landmarks.keys() == {0}
    assert registry.landmarks[0].num_sightings == 12
    assert [each.recent for _, each in registry.due([0], 24)] == [1, 2]
    assert registry.due([0], 24) == []
    registry.split(0, registry.merges(0)[0])
    assert registry.landmarks.keys() == {0, 1}
    assert list(registry.landmarks[1].scans) == [5, 6, 7, 8]
    assert registry.landmarks[1].diameter()[0] == pytest.approx(0.3)
    assert registry.landmarks[0].num_sightings == 8
    assert registry.landmark_ids(np.array([0, 1, 2, -1])).tolist() == [0, 1, 0, -1]
    assert not registry.may_merge(Closure(1, 0, 99.0))
    assert registry.may_merge(Closure(2, 1, 99.0))


def test_a_marker_that_comes_back_is_one_landmark_and_two_tracks() -> None:
    """What the first track says of it stays as it is when the second goes on."""
    registry = LandmarkRegistry()
    for scan, tracker_id in enumerate([0, 0, 0, 1, 1]):
        seen = perceived(scan, 0.2 + 0.1 * tracker_id, "7")
        track = registry.track(tracker_id, seen, 0)
        registry.landmarks.setdefault(track.landmark, track.known)
        track.sight(scan, seen, 0)
    first, second = registry.tracks(0)
    assert first.known is second.known is registry.landmarks[0]
    assert list(first.own.scans) == [0, 1, 2]
    assert list(second.own.scans) == [3, 4]
    assert list(first.known.scans) == [0, 1, 2, 3, 4]
    assert (first.own.num_tracks, first.known.num_tracks) == (1, 2)
    assert second.own.diameter()[0] == pytest.approx(0.3)
    assert first.own.existence is first.known.existence


def perceived(scan: int, diameter_m: float, identity: str = "") -> Perceptions:
    return Perceptions.from_arrays(
        100_000_000 * scan,
        Kind.TREE,
        np.array([5.0]),
        np.array([0.1]),
        np.diag([0.03, 0.01])[None] ** 2,
        diameters_m=np.array([diameter_m]),
        diameter_sigmas_m=np.array([0.02]),
        identities=np.array([identity]),
    )
