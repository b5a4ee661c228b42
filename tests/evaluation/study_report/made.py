"""Outcomes of a study that never ran, of any size, by a seeded generator."""

from functools import cache

import numpy as np

from evaluation.metrics import Direction, Metric
from evaluation.studies.comparison import differences, summaries
from evaluation.studies.trial import MAX_SAMPLES, Drawing, Outcome, Series, Status, Trial
from evaluation.study_report.contents import Contents
from evaluation.study_report.page import page

# Estimator, how far off it is in m, how much too sure, CPU in s.
ESTIMATORS = (
    ("dead-reckoning", 1.2, 1.0, 0.05),
    ("paper", 0.06, np.nan, 0.3),
    ("fast", 0.021, 2.0, 0.5),
    ("particle-filter", 0.05, 1.3, 4.0),
    ("smoothed", 0.0122, 1.1, 2.5),
    ("refined", 0.0121, 1.0, 3.5),
    ("oracle", 0.0115, 1.0, 1.5),
    ("ekf-slam", 0.014, 1.6, 6.0),
    ("plain-isam2", 0.03, 4.0, 3.0),
)


def outcomes(
    num_seeds: int,
    conditions: tuple[str, ...] = ("paper's course",),
    *,
    num_failed: int = 0,
    num_landmarks: int = 120,
    study: str = "paper",
) -> tuple[Outcome, ...]:
    made = []
    for condition in conditions:
        for seed in range(1, num_seeds + 1):
            rng = np.random.default_rng([seed, len(condition)])
            course = _course(rng, num_landmarks)
            luck = float(np.exp(rng.normal(0.0, 0.25)))
            for row in ESTIMATORS:
                trial = Trial(study, condition, "course:perceptions", (("rows", "true"),), (),
                              row[0], seed)  # fmt: skip
                made.append(_outcome(trial, row, luck, course, rng))
    return tuple(_failed(each) if k < num_failed else each for k, each in enumerate(made))


@cache
def two_thousand() -> tuple[tuple[Outcome, ...], str]:
    """The outcomes of 2,007 trials, and their page."""
    made = outcomes(223, num_failed=1)
    return made, page(contents(made))


def contents(made: tuple[Outcome, ...]) -> Contents:
    rng = np.random.default_rng(1)
    return Contents(
        name="paper",
        what="How far does the fast estimator drift?",
        settings='name = "paper"\nseeds = "1-100"\n',
        num_planned=len(made),
        run_again="semgraph study paper",
        one_again="semgraph study paper --only {id}",
        outcomes=made,
        summaries=summaries(made, rng),
        differences=differences(made, rng),
    )


def _course(rng: np.random.Generator, num_landmarks: int) -> tuple[np.ndarray, np.ndarray]:
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    path = 25.0 * np.column_stack([np.sin(turn), 1.0 - np.cos(turn)])
    at = rng.uniform(0.0, 2.0 * np.pi, num_landmarks)
    away = 25.0 + rng.choice([-6.0, 6.0], num_landmarks) + rng.normal(0.0, 1.5, num_landmarks)
    landmarks = np.column_stack([away * np.sin(at), 25.0 - away * np.cos(at)])
    return path, landmarks


def _outcome(
    trial: Trial,
    row: tuple[str, float, float, float],
    luck: float,
    course: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
) -> Outcome:
    _, error_m, too_sure, cpu_s = row
    ate_m = error_m * luck * float(np.exp(rng.normal(0.0, 0.08)))
    times_s = np.linspace(0.0, 46.0, MAX_SAMPLES)
    shape = np.sin(np.pi * times_s / 46.0) * 1.4 + 0.3
    errors_m = ate_m * shape * np.exp(rng.normal(0.0, 0.2, MAX_SAMPLES))
    nees = too_sure * rng.chisquare(3, MAX_SAMPLES)
    headings_deg = np.abs(rng.normal(0.0, 4.0 * ate_m, MAX_SAMPLES))
    path, landmarks = course
    estimated = path[np.linspace(0, len(path) - 1, MAX_SAMPLES).astype(int)]
    metrics = [
        Metric("trajectory_rmse_m", ate_m, "m", Direction.LOWER),
        Metric("heading_rmse_deg", 4.0 * ate_m, "deg", Direction.LOWER),
        Metric("trajectory_max_origin_m", 7.0 * ate_m, "m", Direction.LOWER),
        Metric("cpu_s", cpu_s * luck, "s", Direction.LOWER),
    ]
    if np.isfinite(too_sure):
        metrics.append(Metric("nees_mean", float(nees.mean()), "", Direction.EXPECTED, 3.0))
        metrics.append(Metric("nees_last", float(nees[-1]), "", Direction.EXPECTED, 3.0))
    if trial.estimator in ("paper", "fast", "smoothed"):
        metrics.append(Metric("time_to_closure_s", rng.uniform(0.1, 0.6), "s", Direction.LOWER))
        metrics.append(Metric("loops_closed", 1.0, "", Direction.HIGHER))
    is_mapping = trial.estimator != "dead-reckoning"
    if is_mapping:
        metrics.append(Metric("map_rmse_m", 0.7 * ate_m, "m", Direction.LOWER))
        metrics.append(Metric("map_recall", 1.0, "", Direction.HIGHER))
    mapped = landmarks + rng.normal(0.0, ate_m, landmarks.shape)
    return Outcome(
        trial,
        Status.FINISHED,
        metrics=tuple(metrics),
        wall_s=1.1 * cpu_s,
        cpu_s=cpu_s * luck,
        peak_memory_bytes=180_000_000,
        series=Series(times_s, errors_m, headings_deg, nees),
        drawing=Drawing(
            path,
            estimated + rng.normal(0.0, ate_m, estimated.shape),
            landmarks,
            mapped if is_mapping else np.empty((0, 2)),
        ),
        versions=(("semgraph", "0.1.0"), ("numpy", "2.4.6")),
    )


def _failed(outcome: Outcome) -> Outcome:
    return Outcome(outcome.trial, Status.TIMED_OUT, "took longer than 60 s", wall_s=60.0)
