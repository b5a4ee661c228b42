"""Figures of localization in a known map: `semgraph bench localization`."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from evaluation.benches.bench import Figures, Section
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import each_seed
from evaluation.benches.localization_growth import growth
from evaluation.benches.localization_recordings import car_park, mrclam, wild_places
from evaluation.benches.localization_runs import Run, Trial, try_it, without
from evaluation.benches.localization_trials import SECONDS, MapErrors, Stand, mapped, perceive
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.known_map.fixed_map import FixedMap
from semgraph.known_map.pose_likelihood import LikelihoodSettings, PoseLikelihood
from semgraph.landmarks import Kind, Perceptions
from semgraph.localizer import Use
from semgraph.particle_filter import FilterSettings, ParticleFilter

LONGLEAF: Final = "stem_maps/longleaf.csv"
_BINS: Final = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0 + 1e-12)
# So few poses say nothing of a bin, nor many of so few drives: poses of one drive err alike.
_ENOUGH_IN_BIN: Final = 50
_ENOUGH_DRIVES: Final = 20
_FIRST_SCANS: Final = 8
_CARRIED_OFF_AT: Final = (100, 200)
_NOTICED_WITHIN: Final = 15
_FOUND_WITHIN: Final = 50
_SURE: Final = 0.9
_LOST: Final = 0.5
_FAR_M: Final = 1.0
# Fewer trees of the map are found in many places, and leave a pose open.
_ENOUGH_TREES: Final = 3
# The last leap of a drive of 105 scans is before its 100th.
_SINCE_LEAP: Final = 6
_SHARP: Final = Trial()
_PLAIN: Final = Trial(MapErrors(diameters=False))
_ROUGH: Final = Trial(MapErrors(sigma_m=0.5, missing=0.2, false=0.2))
_RADIUS: Final = Trial(num_scans=3, within_m=10.0)
_KIDNAPPED: Final = Trial(num_scans=300, carried_off_at=_CARRIED_OFF_AT)
_LEAPS: Final = Trial(num_scans=105, largest_step=(5.0, float(np.radians(60.0))))


def global_start(file: Path, trial: Trial, target: float, seeds: Sequence[int]) -> list[Row]:
    """After 10 m driven from an unknown start."""
    runs = each_seed(partial(try_it, file, trial), seeds)
    wrong = np.concatenate([run.is_confidently_wrong for run in runs])
    told = [run for run in runs if run.best_m[-1] <= 0.3 and run.best_turned[-1] <= _DEGREE]
    return [
        _share("within 0.3 m and 1 deg after 10 m", [run.is_right[-1] for run in runs], target),
        _share("the same, where true matches of that scan alone are", _last(told), target),
        _share("within 1 m after 10 m", [run.errors_m[-1] <= _FAR_M for run in runs], target),
        _at_most("poses confidently wrong", float(wrong.mean()), "", 0.005),
        _at_most("position error once found / rigid alignment's", ratio(runs), "", 1.15),
        calibration(runs),
    ]


_DEGREE: Final = float(np.radians(1.0))


def _last(runs: Sequence[Run]) -> list[bool]:
    return [bool(run.is_right[-1]) for run in runs]


def ratio(runs: Sequence[Run]) -> float:
    """RMSE of position by that of the true matches of each scan, where the robot is found."""
    own, best = [], []
    for run in runs:
        kept = (run.qualities > _SURE) & (run.errors_m < _FAR_M) & np.isfinite(run.best_m)
        own.append(run.errors_m[kept])
        best.append(run.best_m[kept])
    return float(_rms(np.concatenate(own)) / _rms(np.concatenate(best)))


def calibration(runs: Sequence[Run]) -> Row:
    """How far claimed and true shares of poses within 1 m lie apart, in the worst bin."""
    qualities = np.concatenate([run.qualities for run in runs])
    drives = np.repeat(np.arange(len(runs)), [len(run.qualities) for run in runs])
    is_near = np.concatenate([run.errors_m <= _FAR_M for run in runs])
    gaps = []
    for low, high in pairwise(_BINS):
        inside = (qualities >= low) & (qualities < high)
        is_enough = inside.sum() >= _ENOUGH_IN_BIN
        if is_enough and len(np.unique(drives[inside])) >= min(_ENOUGH_DRIVES, len(runs)):
            gaps.append(abs(float(qualities[inside].mean() - is_near[inside].mean())))
    return _at_most("quality off in the worst bin", max(gaps, default=np.nan), "", 0.05)


def pose_quality(file: Path, seeds: Sequence[int]) -> list[Row]:
    """Of the first scans of starts anywhere in good, plain and rough maps: where it is in doubt."""
    trials = [replace(each, num_scans=_FIRST_SCANS) for each in (_SHARP, _PLAIN, _ROUGH)]
    runs = [run for trial in trials for run in each_seed(partial(try_it, file, trial), seeds)]
    qualities = np.concatenate([run.qualities for run in runs])
    is_near = np.concatenate([run.errors_m <= _FAR_M for run in runs])
    brier = float(np.mean(np.square(qualities - is_near)))
    return [calibration(runs), _at_most("Brier score, a coin's is 0.25", brier, "", 0.25)]


def start_in_a_radius(file: Path, seeds: Sequence[int]) -> list[Row]:
    """From a circle of 10 m."""
    runs = each_seed(partial(try_it, file, _RADIUS), seeds)
    near = [bool(run.errors_m[-1] <= 0.3) for run in runs]
    told = [run for run in runs if run.num_true.max() >= _ENOUGH_TREES]
    return [
        _share("radius 10 m: within 0.3 m and 1 deg at the third scan", _last(runs), 0.99),
        _share("radius 10 m: within 0.3 m at the third scan", near, 0.99),
        _share("radius 10 m: the first, where a scan shows three trees or more", _last(told), 0.99),
    ]


def kidnappings(file: Path, seeds: Sequence[int]) -> list[Row]:
    """Carried off twice a drive of 60 m: noticed, found again; alarms while nothing is wrong."""
    runs = each_seed(partial(try_it, file, _KIDNAPPED), seeds)
    noticed, found = [], []
    for run in runs:
        for at in _CARRIED_OFF_AT:
            soon, later = slice(at, at + _NOTICED_WITHIN), slice(at, at + _FOUND_WITHIN)
            noticed.append(bool(((run.qualities < _LOST) | (run.errors_m < _FAR_M))[soon].any()))
            found.append(bool(((run.qualities > _SURE) & (run.errors_m < _FAR_M))[later].any()))
    both = [one and other for one, other in zip(noticed, found, strict=True)]
    hours = sum(len(run.errors_m) for run in runs) * SECONDS / 3600.0
    alarms = sum(false_alarms(run) for run in runs)
    return [
        _share("kidnappings noticed within 3 m and found within 10 m", both, 0.97),
        _share("kidnappings noticed within 3 m", noticed, 0.97),
        _share("kidnappings found again within 10 m", found, 0.97),
        _at_most("false alarms", alarms / hours, "1/h", 1.0),
    ]


def false_alarms(run: Run) -> int:
    """How often it thinks itself lost where it is not, having been sure before.

    Who is carried off and finds itself again in the same scan was right to doubt.
    """
    is_alarm = (run.qualities[1:] < _LOST) & (run.qualities[:-1] >= _LOST)
    is_alarm &= ~np.isin(np.arange(1, len(run.qualities)), _CARRIED_OFF_AT)
    return int((is_alarm & (run.errors_m[1:] < _FAR_M) & (run.errors_m[:-1] < _FAR_M)).sum())


def leaps(file: Path, seeds: Sequence[int]) -> list[Row]:
    """Without wheels, up to 5 m and 60 deg between two scans, every tenth one; five after."""
    shares = {}
    told = float("nan")
    for use in Use:
        runs = each_seed(partial(try_it, file, without(_LEAPS, use)), seeds)
        shares[use] = float(np.mean([run.errors_m[-1] < 0.3 for run in runs]))
        if use is Use.BOTH:
            enough = [run for run in runs if run.num_true[-_SINCE_LEAP:].max() >= _ENOUGH_TREES]
            told = float(np.mean([run.errors_m[-1] < 0.3 for run in enough]))
    better = max(shares[Use.FAST], shares[Use.PARTICLES])
    return [
        Row("leaps: both, within 0.3 m at the end", shares[Use.BOTH], "", Better.HIGHER, 0.98),
        Row("leaps: both, where a scan after shows three trees", told, "", Better.HIGHER, 0.98),
        Row("leaps: both, against the better alone", shares[Use.BOTH], "", Better.HIGHER, better),
        Row("leaps: fast alone", shares[Use.FAST], "", Better.HIGHER, 0.0),
        Row("leaps: particles alone", shares[Use.PARTICLES], "", Better.HIGHER, 0.0),
    ]


def speed(file: Path, seeds: Sequence[int]) -> list[Row]:
    """Processor time, on one core; of the first seed."""
    rng = np.random.default_rng(seeds[0])
    run = try_it(file, _SHARP, seeds[0])
    return [
        _at_most("100,000 poses x 10 perceptions x 500 landmarks", bulk_ms(rng), "ms", 25.0),
        _at_most("a scan, fast estimator, median", _ms(run.seconds[run.is_fast]), "ms", 2.0),
        _at_most("a scan, particles at one place, median", tracking_ms(file, rng), "ms", 2.0),
        *large_map(rng),
    ]


def bulk_ms(rng: np.random.Generator) -> float:
    """The best of five."""
    trees = _random_map(500, rng)
    model = PoseLikelihood(trees, LikelihoodSettings())
    perceptions = _ten(trees, rng)
    low, high = trees.bounds()
    poses = np.column_stack(
        [rng.uniform(low, high, (100_000, 2)), rng.uniform(-np.pi, np.pi, 100_000)]
    )
    model.log_likelihoods(model.see(perceptions), poses)
    return 1e3 * min(
        _timed(lambda: model.log_likelihoods(model.see(perceptions), poses)) for _ in range(5)
    )


def tracking_ms(file: Path, rng: np.random.Generator) -> float:
    """The particle filter's median, with all particles at one place."""
    stand = Stand.read(file)
    trees = mapped(stand, MapErrors(), rng).fixed_map
    particles = ParticleFilter(PoseLikelihood(trees, LikelihoodSettings()), FilterSettings(), rng)
    pose = Pose2(100.0, 100.0, 0.3)
    particles.start_at(UncertainPose2(pose, np.diag([0.05, 0.05, 0.01]) ** 2))
    motion = UncertainPose2(Pose2(), np.diag([0.01, 0.01, 0.003]) ** 2)
    seconds = []
    for k in range(50):
        seen, _ = perceive(stand, pose, k, rng)
        seconds.append(_timed(partial(particles.step, seen, motion)))
    return _ms(np.array(seconds))


def large_map(rng: np.random.Generator) -> list[Row]:
    """A start anywhere among 20,000 trees."""
    trees = _random_map(20_000, rng)
    perceptions = _ten(trees, rng)
    made: list[ParticleFilter] = []

    def prepare() -> None:
        model = PoseLikelihood(trees, LikelihoodSettings())
        made.append(ParticleFilter(model, FilterSettings(), rng))

    before = _timed(prepare)
    still = UncertainPose2(Pose2(), np.zeros((3, 3)))
    first = _timed(lambda: made[0].step(perceptions, still))
    return [
        _at_most("global start on 20,000 landmarks, all in all", before + first, "s", 1.0),
        _at_most("of that preparing the map", before, "s", 1.0),
    ]


def _random_map(count: int, rng: np.random.Generator) -> FixedMap:
    """Trees as dense as longleaf's."""
    size_m = float(np.sqrt(count / 0.0146))
    diameters_m = 0.3 * np.exp(0.4 * rng.standard_normal(count))
    return FixedMap(
        rng.uniform(0.0, size_m, (count, 2)),
        np.tile(0.01 * np.eye(2), (count, 1, 1)),
        np.full(count, int(Kind.TREE)),
        diameters_m,
        0.05 * diameters_m,
        np.full(count, "", dtype=np.str_),
    )


def _ten(trees: FixedMap, rng: np.random.Generator) -> Perceptions:
    """The ten nearest trees, from the middle of the map."""
    stand = Stand(trees.map_t_landmarks, trees.diameters_m)
    middle = trees.map_t_landmarks.mean(axis=0)
    seen, _ = perceive(stand, Pose2(float(middle[0]), float(middle[1]), 0.4), 0, rng)
    return seen.select(np.argsort(seen.ranges_m)[:10])


def _timed(work: Callable[[], object]) -> float:
    before = time.process_time()
    work()
    return time.process_time() - before


def _ms(seconds: FloatArray) -> float:
    return float(1e3 * np.median(seconds)) if len(seconds) else float("nan")


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def _share(name: str, each: Sequence[object], target: float) -> Row:
    share = float(np.mean([bool(one) for one in each])) if len(each) else float("nan")
    return Row(name, share, "", Better.HIGHER, target)


def _at_most(name: str, value: float, unit: str, target: float) -> Row:
    return Row(name, value, unit, Better.LOWER, target)


def sections(data: Path | None) -> tuple[Section, ...]:
    """All; what needs a recording is left out where `data` has none."""

    def of(figures: Callable[[Path, Sequence[int]], list[Row]], name: str) -> Figures:
        def with_data(seeds: Sequence[int]) -> list[Row]:
            if data is None:
                raise InputError(f"expected --data DIR with {name}")
            return figures(data / name, seeds)

        return with_data

    def start(trial: Trial, target: float) -> Figures:
        def figures(file: Path, seeds: Sequence[int]) -> list[Row]:
            return global_start(file, trial, target, seeds)

        return of(figures, LONGLEAF)

    def grown(trial: Trial, target: float) -> Figures:
        def figures(file: Path, seeds: Sequence[int]) -> list[Row]:
            return growth(file, trial, target, seeds)

        return of(figures, LONGLEAF)

    return (
        Section("speed", (of(speed, LONGLEAF),), 1.0),
        Section("global start", (start(_SHARP, 0.98),), 5.0),
        Section("global start, no diameters", (start(_PLAIN, 0.95),), 7.0),
        Section(
            "global start, map errs 0.5 m, 20 % wrong",
            (start(_ROUGH, 0.9), grown(_ROUGH, 0.9)),
            12.0,
        ),
        Section("pose quality", (of(pose_quality, LONGLEAF),), 6.0),
        Section("start in a radius", (of(start_in_a_radius, LONGLEAF),), 2.0),
        Section("kidnappings", (of(kidnappings, LONGLEAF),), 15.0),
        Section("leaps", (of(leaps, LONGLEAF),), 20.0),
        Section("car park, beacons as map", (of(car_park, "car_park"),), 2.0),
        Section("MRCLAM, no identities", (of(mrclam, "mrclam6"),), 8.0),
        Section("Wild-Places, single frames", (of(wild_places, "wild_v03"),), 30.0),
    )
