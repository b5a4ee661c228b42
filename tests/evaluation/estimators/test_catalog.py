"""Every estimator by its name: on a short course, and on recordings that are hardly any."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from evaluation.estimators.catalog import ESTIMATORS, estimator
from evaluation.estimators.estimate import Estimate
from evaluation.trajectory import compare_path, rmse
from semgraph.errors import InputError, SemgraphError
from semgraph.landmarks import Kind, Perceptions, concatenate
from semgraph.settings import Settings
from sensors.measurements import Measurement, WheelOdometry
from sensors.truth import Source, Truth
from tests.evaluation.estimators.short_course import estimated, short_course

SEEDS = (1, 2)
NAMES = tuple(ESTIMATORS)
WITH_MAP = tuple(name for name, entry in ESTIMATORS.items() if entry.maps)


def aligned_rmse_m(name: str, seed: int) -> float:
    path = short_course(seed).truth.path
    assert path is not None
    errors = compare_path(estimated(name, seed).trajectory, path)
    assert errors is not None
    return rmse(errors.errors)


@pytest.mark.parametrize("name", NAMES)
def test_an_estimate_is_whole(name: str) -> None:
    source, estimate = short_course(1), estimated(name, 1)
    n = source.recording.num_scans
    assert len(estimate.trajectory) == n
    assert estimate.covariances.shape in ((n, 3, 3), (0, 3, 3))
    assert estimate.step_seconds.shape in ((n,), (0,))
    assert (estimate.step_seconds >= 0.0).all()
    assert (estimate.online is not None) == (len(estimate.step_seconds) > 0)
    stamps_ns = set(estimate.trajectory.stamps_ns.tolist())
    assert estimate.associations.keys() == stamps_ns or not estimate.associations
    assert bool(estimate.landmarks) is ESTIMATORS[name].maps
    known = source.truth.associations
    assert known is not None
    for stamp_ns, landmark_ids in estimate.associations.items():
        assert len(landmark_ids) == len(known[stamp_ns])
        seen = landmark_ids[landmark_ids >= 0]
        assert name == "paper" or len(np.unique(seen)) == len(seen)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "dead-reckoning"])
def test_landmarks_beat_the_wheels_alone(name: str) -> None:
    for seed in SEEDS:
        assert aligned_rmse_m(name, seed) < 0.6 * aligned_rmse_m("dead-reckoning", seed)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "oracle"])
def test_none_is_better_than_the_oracle_on_average(name: str) -> None:
    ours, best = (
        np.mean([aligned_rmse_m(each, seed) for seed in SEEDS]) for each in (name, "oracle")
    )
    assert best <= 1.02 * ours


@pytest.mark.parametrize("name", WITH_MAP)
def test_most_trees_are_in_the_map_once(name: str) -> None:
    landmarks = estimated(name, 1).landmarks
    assert 36 <= len(landmarks) <= 44


def test_the_same_twice() -> None:
    for name in ("combined", "ekf-slam", "plain-isam2"):
        again = estimator(name)(short_course(1), Settings(), np.random.default_rng(1))
        np.testing.assert_array_equal(
            again.trajectory.map_T_bases, estimated(name, 1).trajectory.map_T_bases
        )


def test_an_unknown_name_gets_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'ekf-slam'"):
        estimator("ekfslam")


def scans(source: Source) -> list[Perceptions]:
    return [each for each in source.recording.measurements if isinstance(each, Perceptions)]


def nothing(source: Source) -> list[Measurement]:
    return []


def wheels_only(source: Source) -> list[Measurement]:
    return [each for each in source.recording.measurements if isinstance(each, WheelOdometry)]


def nothing_seen(source: Source) -> list[Measurement]:
    return [
        each.select(np.zeros(0, dtype=np.int64)) if isinstance(each, Perceptions) else each
        for each in first_scans(source, 30)
    ]


def first_scans(source: Source, count: int) -> list[Measurement]:
    last_ns = scans(source)[count - 1].stamp_ns
    return [each for each in source.recording.measurements if each.stamp_ns <= last_ns]


def one_perception(source: Source) -> list[Measurement]:
    some = first_scans(source, 30)
    return [
        each.select(np.arange(1 if each.stamp_ns == some[-1].stamp_ns else 0))
        if isinstance(each, Perceptions)
        else each
        for each in some
    ]


def twice_at_each_time(source: Source) -> list[Measurement]:
    doubled: list[Measurement] = []
    for each in first_scans(source, 30):
        doubled += [each, each] if isinstance(each, Perceptions) else [each]
    return doubled


def out_of_order(source: Source) -> list[Measurement]:
    some = first_scans(source, 30)
    return [*some[:30], *some[10:14], *some[30:]]


def seen_by_turns(source: Source) -> list[Measurement]:
    return [
        each.select(np.arange(len(each) if k // 10 % 2 else 0))
        if isinstance(each, Perceptions)
        else each
        for k, each in enumerate(first_scans(source, 60))
    ]


def right_at_the_robot(source: Source) -> list[Measurement]:
    near = [np.array([1e-3]), np.array([3.1]), np.array([[[1e-6, 0.0], [0.0, 1.0]]])]
    made: list[Measurement] = []
    for each in first_scans(source, 30):
        at_hand = Perceptions.from_arrays(each.stamp_ns, Kind.ROCK, *near)
        if isinstance(each, Perceptions):
            made.append(concatenate(each.stamp_ns, [each, at_hand]))
        else:
            made.append(each)
    return made


BATTERY: dict[str, Callable[[Source], list[Measurement]]] = {
    "no measurement": nothing,
    "wheels only": wheels_only,
    "nothing seen": nothing_seen,
    "one scan": lambda source: first_scans(source, 1),
    "two scans": lambda source: first_scans(source, 2),
    "one perception": one_perception,
    "twice at each time": twice_at_each_time,
    "out of order": out_of_order,
    "seen by turns": seen_by_turns,
    "right at the robot": right_at_the_robot,
}


@pytest.mark.parametrize(
    ("case", "wheels"),
    [(case, "with wheels") for case in BATTERY]
    + [(case, "without") for case in ("nothing seen", "one perception", "seen by turns")],
)
@pytest.mark.parametrize("name", NAMES)
def test_a_reason_or_an_estimate(name: str, case: str, wheels: str) -> None:
    source, noise = short_course(1), short_course(1).recording.odometry_noise
    measurements = BATTERY[case](source)
    if wheels == "without":
        measurements = [each for each in measurements if not isinstance(each, WheelOdometry)]
        noise = None
    recording = replace(source.recording, measurements=tuple(measurements), odometry_noise=noise)
    num_times = len({each.stamp_ns for each in measurements if isinstance(each, Perceptions)})
    run, rng = estimator(name), np.random.default_rng(0)
    if num_times == 0 or (name == "dead-reckoning" and noise is None):
        with pytest.raises(SemgraphError, match=r"^[^\n]*expected[^\n]*$"):
            run(replace(source, recording=recording), Settings(), rng)
    else:
        check(run(replace(source, recording=recording), Settings(), rng), num_times)


def check(estimate: Estimate, num_times: int) -> None:
    assert len(estimate.trajectory) == num_times > 0
    known = estimate.covariances[~np.isnan(estimate.covariances).all(axis=(1, 2))]
    assert np.isfinite(known).all()
    assert (np.linalg.eigvalsh(known) > -1e-12).all()


@pytest.mark.parametrize("name", ["oracle", "particle-filter", "combined"])
def test_without_truth_there_is_nothing_to_give(name: str) -> None:
    source = Source(short_course(1).recording, Truth())
    with pytest.raises(InputError, match="true poses and landmarks"):
        estimator(name)(source, Settings(), np.random.default_rng(0))
