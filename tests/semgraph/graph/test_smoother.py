"""The smoother on small seeded courses, run as the pipeline runs it."""

import gc
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from evaluation.benches.bench_graph import num_mixed
from evaluation.consistency import bounds_of_mean, gauge, pose_nees
from evaluation.metrics import judge
from evaluation.oracle import oracle
from semgraph.arrays import FloatArray, IntArray
from semgraph.decisions import What
from semgraph.files.yaw_rates import YawRateLog
from semgraph.graph.smoother import Smoother
from semgraph.landmarks import Kind, Perceptions
from semgraph.moments import moments
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.results import RunResult
from semgraph.settings import load_settings
from semgraph.tracking import tracker_of
from sensors.measurements import Measurement, Recording
from sensors.simulation.courses.eight import EightOptions
from sensors.simulation.courses.eight import read as read_eight
from sensors.simulation.courses.perceptions import CourseOptions, read
from sensors.truth import Source

# So small a reach that a tree is out of sight for most of the lap.
SMALL = CourseOptions(
    scan_rate_hz=4.0,
    num_trees=60,
    track_radius_m=12.0,
    band_m=6.0,
    lap_s=36.0,
    overlap_s=4.0,
    max_range_m=8.0,
)
SEEDS_WITH_WHEELS = range(100, 112)
SEEDS_WITHOUT = range(100, 104)


@dataclass(frozen=True)
class Judged:
    """A run with its figures, and its pose NEES at each eighth of the way."""

    result: RunResult
    figures: dict[str, float]
    nees: FloatArray


def ran(recording: Recording) -> RunResult:
    settings = load_settings(None, [])
    return run(recording, settings, Perceiver(recording, settings), Silence(), {})


@cache
def judged(seed: int, *, odometry: bool) -> Judged:
    source = read(
        "course:perceptions", SMALL.model_copy(update={"seed": seed, "odometry": odometry})
    )
    result, path = ran(source.recording), source.truth.path
    assert path is not None
    world_T_map = gauge(result.smoothed, path)
    assert world_T_map is not None
    nees = pose_nees(result.smoothed, result.smoothed_covariances, path, world_T_map)
    figures = {metric.name: metric.value for metric in judge(result, source.truth)}
    return Judged(result, figures, nees[np.linspace(0, len(nees) - 1, 9).astype(int)[1:]])


def all_judged(*, odometry: bool) -> list[Judged]:
    seeds = SEEDS_WITH_WHEELS if odometry else SEEDS_WITHOUT
    return [judged(seed, odometry=odometry) for seed in seeds]


def changed(recording: Recording, change: Callable[[int, Perceptions], Perceptions]) -> Recording:
    """The recording with every scan changed; wheels stay as they are."""
    measurements: list[Measurement] = []
    for each in recording.measurements:
        scan = sum(isinstance(before, Perceptions) for before in measurements)
        measurements.append(change(scan, each) if isinstance(each, Perceptions) else each)
    return replace(recording, measurements=tuple(measurements))


def delayed(recording: Recording, scan: int, seconds: float) -> Recording:
    """Nothing for so long before this scan, while the robot stands still."""
    return changed(
        recording,
        lambda k, each: replace(each, stamp_ns=each.stamp_ns + int(seconds * 1e9) * (k >= scan)),
    )


def small(**options: float | bool) -> Source:
    return read("course:perceptions", CourseOptions.model_validate(SMALL.model_dump() | options))


@pytest.mark.parametrize("odometry", [False, True])
def test_every_tree_stands_once_and_loops_close(*, odometry: bool) -> None:
    for each in all_judged(odometry=odometry):
        assert each.figures["landmarks_duplicate"] == 0
        assert each.figures["landmarks_missed"] == 0
        assert each.figures["landmarks_false"] == 0
        assert each.figures["num_loop_closures"] > 0
        assert not [event for event in each.result.events if "failed" in event]


@pytest.mark.parametrize("odometry", [False, True])
def test_smoothing_pays(*, odometry: bool) -> None:
    gains = [
        each.figures["trajectory_rmse_m"] / each.figures["fast_trajectory_rmse_m"]
        for each in all_judged(odometry=odometry)
    ]
    assert np.mean(gains) < 0.95


def test_poses_are_as_sure_as_they_say() -> None:
    """NEES along the way over seeded runs, with wheels that err as they say."""
    nees = np.array([each.nees for each in all_judged(odometry=True)])
    low, high = bounds_of_mean(3, len(nees), 0.999)
    means = nees.mean(axis=0)
    assert (low < means).all(), means
    assert (means < high).all(), means


def test_the_order_of_perceptions_changes_nothing() -> None:
    source = small(seed=120, lap_s=20.0)
    rng = np.random.default_rng(0)
    mixed = changed(source.recording, lambda _, each: each.select(rng.permutation(len(each))))
    first, second = ran(source.recording), ran(mixed)
    np.testing.assert_allclose(first.smoothed.map_T_bases, second.smoothed.map_T_bases, atol=1e-6)
    one, other = (
        np.array(sorted(each.map_t_landmark.tolist() for each in result.landmarks))
        for result in (first, second)
    )
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_two_runs_are_equal() -> None:
    recording = small(seed=121, lap_s=12.0).recording
    first, second = ran(recording), ran(recording)
    np.testing.assert_array_equal(first.smoothed.map_T_bases, second.smoothed.map_T_bases)
    assert first.events == second.events


def test_one_identity_is_one_landmark_wherever_it_is_seen_again() -> None:
    """Numbered markers, and half the lap blind: the drift is no matter."""
    source = small(seed=122, odometry=True)
    truth, associations = source.truth.landmarks, source.truth.associations
    assert truth is not None
    assert associations is not None
    rows = list(associations.values())

    def numbered(scan: int, each: Perceptions) -> Perceptions:
        names = np.array([f"m{row}" for row in rows[scan]], dtype=np.str_)
        marked = replace(
            each, kinds=np.full(len(each), Kind.MARKER, dtype=np.int64), identities=names
        )
        return marked.select(np.full(len(each), not 40 <= scan < 100))

    result = ran(changed(source.recording, numbered))
    names = [each.semantics.identity for each in result.landmarks]
    assert len(names) > 20
    assert len(set(names)) == len(names)
    errors = [
        each.map_t_landmark - truth.world_t_landmarks[int(each.semantics.identity[1:])]
        for each in result.landmarks
    ]
    assert np.linalg.norm(errors, axis=1).max() < 0.3


def test_scans_that_perceive_nothing_are_bridged_by_the_wheels() -> None:
    source = small(seed=123, odometry=True)
    blind = changed(
        source.recording,
        lambda k, each: each.select(np.full(len(each), not (k < 3 or 50 <= k < 75))),
    )
    result = ran(blind)
    figures = {each.name: each.value for each in judge(result, source.truth)}
    assert len(result.smoothed) == source.recording.num_scans
    assert figures["trajectory_rmse_m"] < 0.25
    assert figures["landmarks_duplicate"] == 0
    sigmas = np.sqrt(result.smoothed_covariances[:, 0, 0])
    assert sigmas[62] > 1.2 * sigmas[45]


def test_a_stretch_of_clutter_adds_no_tree() -> None:
    source = small(seed=124, odometry=True)
    noisy = small(seed=124, odometry=True, clutter=3.0)
    cluttered = [each for each in noisy.recording.measurements if isinstance(each, Perceptions)]
    mixed = changed(source.recording, lambda k, each: cluttered[k] if 40 <= k < 80 else each)
    figures = {each.name: each.value for each in judge(ran(mixed), source.truth)}
    assert figures["landmarks_missed"] == 0
    assert figures["landmarks_duplicate"] == 0
    assert figures["landmarks_false"] <= 2
    assert figures["trajectory_rmse_m"] < 0.2


@pytest.mark.parametrize(
    "seconds",
    [
        1.0,
        5.0,
        20.0,
        600.0,
    ],
)
def test_a_gap_without_wheels_costs_accuracy_but_never_the_run(seconds: float) -> None:
    source = small(seed=125, lap_s=20.0)
    result = ran(delayed(source.recording, 40, seconds))
    assert len(result.smoothed) == source.recording.num_scans
    assert np.isfinite(result.smoothed_covariances).all()


def test_a_run_of_nothing_but_clutter_ends() -> None:
    source = small(seed=1, num_trees=0, clutter=5.0, lap_s=10.0)
    result = ran(source.recording)
    assert len(result.smoothed) == result.num_scans
    assert np.isfinite(result.smoothed_covariances).all()


def test_a_run_without_any_perception_is_that_of_the_wheels() -> None:
    source = small(seed=126, odometry=True, lap_s=10.0)
    nothing = changed(source.recording, lambda _, each: each.select(np.zeros(len(each), np.bool_)))
    result = ran(nothing)
    assert result.landmarks == ()
    np.testing.assert_allclose(result.smoothed.map_T_bases, result.fast.map_T_bases, atol=1e-6)
    sigmas = np.sqrt(result.smoothed_covariances[:, 2, 2])
    assert (np.diff(sigmas) > 0.0).all()


def test_one_identity_seen_by_two_sensors_from_the_first_moment_is_one_landmark() -> None:
    """Whichever sensor saw it, also where neither had a track of it before."""
    both = [
        Perceptions.from_arrays(
            200_000_000 * k,
            Kind.MARKER,
            np.array([5.0, 5.02, 7.0]),
            np.array([0.1, 0.1, -0.8]),
            np.tile(np.diag([0.02, 0.01]) ** 2, (3, 1, 1)),
            identities=np.array(["7", "7", "8"]),
        )
        for k in range(20)
    ]
    result = ran(Recording("two sensors", both, len(both)))
    assert sorted(each.semantics.identity for each in result.landmarks) == ["7", "8"]


def test_a_perception_taken_for_the_wrong_tree_is_of_none_in_the_end() -> None:
    recording, settings = small(odometry=True).recording, load_settings(None, [])
    tracker = tracker_of(recording, settings.tracker)
    smoother = Smoother(settings.smoother, recording.map_T_start)
    swapped: dict[int, IntArray] = {}
    pair = np.array([23, 27])
    for k, moment in enumerate(moments(recording, Perceiver(recording, settings), YawRateLog())):
        step = tracker.step(moment.perceptions, moment.odometry)
        two = np.flatnonzero(np.isin(step.landmark_ids, pair))
        # Twice in a row would be a thing that moves.
        if len(two) == 2 and k in {65, 71}:
            step.landmark_ids[two] = step.landmark_ids[two[::-1]]
            swapped[step.stamp_ns] = two
        smoother.add(step, moment.perceptions, moment.views)
    smoother.finish(lambda _: None)
    associations = smoother.associations()
    assert len(swapped) == 2
    assert all((associations[stamp_ns][two] == -1).all() for stamp_ns, two in swapped.items())
    left = [each for each in smoother.decisions if each.what is What.LEFT_OUT]
    assert any(str(each).endswith("sightings fit nothing") for each in left)
    share = np.mean([(ids >= 0).mean() for ids in associations.values() if len(ids)])
    assert share > 0.9


def test_a_landmark_of_a_pair_holds_what_fits_it_better_than_the_other(tmp_path: Path) -> None:
    """Pairs of trunks 0.3 m apart, as far off as the noise from 20 m: tracks slip between them."""
    rng = np.random.default_rng(0)
    trunks = rng.uniform(0.0, 44.0, (40, 2))
    angles = rng.uniform(0.0, 2.0 * np.pi, 40)
    beside = trunks + 0.3 * np.column_stack([np.cos(angles), np.sin(angles)])
    stems = tmp_path / "stems.csv"
    lines = [f"{x},{y},3.2\n" for x, y in np.vstack([trunks, beside]).tolist()]
    stems.write_text("x,y,mark\n" + "".join(lines))
    options = EightOptions(stem_map=stems, length_m=130.0, seed=1, odometry=True)
    source = read_eight("course:eight", options)
    result = ran(source.recording)
    truly = oracle(source, load_settings(None, [])).associations
    assert num_mixed(truly, result) == 0
    assert any(each.what is What.HANDED_OVER for each in result.decisions)


def test_what_a_run_keeps_is_no_garbage_until_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("semgraph.graph.smoother._KEPT_SCANS", 10)
    recording, settings = small(seed=1, lap_s=10.0).recording, load_settings(None, [])
    tracker = tracker_of(recording, settings.tracker)
    smoother = Smoother(settings.smoother, recording.map_T_start)
    for moment in moments(recording, Perceiver(recording, settings), YawRateLog()):
        step = tracker.step(moment.perceptions, moment.odometry)
        smoother.add(step, moment.perceptions, moment.views)
    assert gc.get_freeze_count() > 0
    smoother.finish(lambda _: None)
    assert gc.get_freeze_count() == 0
