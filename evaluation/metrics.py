"""A run judged against the truth, as named figures with unit and direction."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np

from evaluation.alignment import Alignment
from evaluation.consistency import gauge, landmark_nees, observed_coverage, pose_nees
from evaluation.landmarks import MapErrors, compare_map, suspected_duplicates
from evaluation.rotation import turn_rates
from evaluation.trajectory import (
    PathErrors,
    compare_path,
    frame_errors,
    relative_errors,
    rmse,
)
from semgraph.arrays import FloatArray
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2
from semgraph.landmarks import Landmark
from semgraph.results import LOOP_CLOSED, RunResult
from semgraph.smoothed import Online
from sensors.truth import TruePath, Truth

RELATIVE_LENGTHS_M = (10, 50, 100)


class Direction(Enum):
    """Which way a metric gets better."""

    LOWER = "lower"
    HIGHER = "higher"
    EXPECTED = "near the expected value"
    NEITHER = "neither"


@dataclass(frozen=True, slots=True)
class Metric:
    """A named figure; `unit` is empty for counts, `expected` is what an honest run has."""

    name: str
    value: float
    unit: str
    better: Direction
    expected: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Said:
    """What is judged of an estimator.

    Attributes:
        trajectory: its path.
        covariances: (n, 3, 3) of its poses, each in its own frame; none, or NaN where unknown.
        landmarks: its map; None where it makes none.
    """

    trajectory: Trajectory
    covariances: FloatArray
    landmarks: tuple[Landmark, ...] | None


def judge(result: RunResult, truth: Truth) -> tuple[Metric, ...]:
    """Every metric that the run and what is known of the truth allow; the others are absent.

    `trajectory_rmse_m` is after rigid alignment. If the truth has outliers, the alignment is the
    robust one and it leaves out the fixes that jump (`alignment.reference_outliers`); their number
    and the RMSE over all fixes stand beside it. `..._unaligned_m` takes the map's frame for the
    world's, `..._origin_m` lays the first pose onto the first.
    """
    said = Said(result.smoothed, result.smoothed_covariances, result.landmarks)
    metrics = [*metrics_of(said, truth)]
    if truth.path is not None:
        metrics += trajectory_metrics(result.fast, truth.path, "fast_")
        if result.online is not None:
            metrics += trajectory_metrics(result.online.trajectory, truth.path, "online_")
    metrics += _of_fast_map(result, truth)
    metrics += _of_rotation(result)
    metrics += _of_run(result)
    return known_only(metrics)


def known_only(metrics: Iterable[Metric]) -> tuple[Metric, ...]:
    """Those with a value."""
    return tuple(metric for metric in metrics if np.isfinite(metric.value))


def metrics_of(said: Said, truth: Truth) -> Iterator[Metric]:
    """Of path, map and covariances, all that the truth allows."""
    world_T_map = path_alignment(said.trajectory, truth)
    if truth.path is not None:
        yield from trajectory_metrics(said.trajectory, truth.path, "")
        yield from _of_poses(said, truth.path)
    if said.landmarks is None:
        return
    matched = compare_map(said.landmarks, truth, world_T_map)
    yield from _of_map(said.landmarks, matched)
    if matched is None or world_T_map is None or not len(matched.map_rows):
        return
    yield metres("map_rmse_path_aligned_m", rmse(matched.path_errors))
    of_landmarks = _landmark_squares(said.trajectory, said.landmarks, truth, matched)
    yield from squares_of("landmark_nees", of_landmarks, 2)


def path_alignment(estimate: Trajectory, truth: Truth) -> Pose2 | None:
    """world_T_map that lays an estimated path onto the true one; None where they never meet."""
    if truth.path is None:
        return None
    errors = compare_path(estimate, truth.path)
    return None if errors is None else errors.world_T_map


def trajectory_metrics(estimate: Trajectory, truth: TruePath, prefix: str) -> Iterator[Metric]:
    """Absolute and relative errors of a path, their names beginning with the prefix."""
    rigid = compare_path(estimate, truth, Alignment.RIGID)
    if rigid is None:
        return
    kept = ~rigid.is_outlier
    yield metres(f"{prefix}trajectory_rmse_m", rmse(rigid.errors[kept]))
    yield metres(f"{prefix}trajectory_median_m", float(np.median(rigid.distances)))
    yield metres(f"{prefix}trajectory_max_m", float(rigid.distances[kept].max()))
    if truth.has_outliers:
        yield metres(f"{prefix}trajectory_rmse_all_m", rmse(rigid.errors))
        yield _count(f"{prefix}reference_outliers", int(rigid.is_outlier.sum()))
    yield from _unaligned(estimate, truth, rigid, prefix)
    yield _count(f"{prefix}reference_compared", len(rigid.rows))
    yield _count(f"{prefix}reference_left_out", rigid.num_left_out)
    yield from _headings(rigid, prefix)
    a_frame = frame_errors(estimate, truth)
    if a_frame is not None:
        yield metres(f"{prefix}relative_frame_translation_rmse_m", a_frame.translation_rmse_m)
        degrees = float(np.degrees(a_frame.heading_rmse))
        yield Metric(f"{prefix}relative_frame_heading_rmse_deg", degrees, "deg", Direction.LOWER)
    for relative in relative_errors(estimate, truth, RELATIVE_LENGTHS_M):
        name = f"{prefix}relative_{relative.length_m:g}m"
        yield metres(f"{name}_translation_rmse_m", relative.translation_rmse_m)
        degrees = float(np.degrees(relative.heading_rmse))
        yield Metric(f"{name}_heading_rmse_deg", degrees, "deg", Direction.LOWER)


def _unaligned(
    estimate: Trajectory, truth: TruePath, rigid: PathErrors, prefix: str
) -> Iterator[Metric]:
    kept = ~rigid.is_outlier
    as_it_is = compare_path(estimate, truth, Alignment.NONE)
    if as_it_is is not None:
        yield metres(f"{prefix}trajectory_rmse_unaligned_m", rmse(as_it_is.errors[kept]))
    from_start = compare_path(estimate, truth, Alignment.ORIGIN)
    if from_start is not None and truth.headings is not None:
        yield metres(f"{prefix}trajectory_rmse_origin_m", rmse(from_start.errors[kept]))
        drift_m = float(from_start.distances.max())
        yield metres(f"{prefix}trajectory_max_origin_m", drift_m)


def _headings(rigid: PathErrors, prefix: str) -> Iterator[Metric]:
    if rigid.heading_errors is not None:
        degrees = float(np.degrees(rmse(rigid.heading_errors)))
        yield Metric(f"{prefix}heading_rmse_deg", degrees, "deg", Direction.LOWER)


def _of_map(landmarks: tuple[Landmark, ...], matched: MapErrors | None) -> Iterator[Metric]:
    yield _count("landmarks_confirmed", len(landmarks))
    if matched is not None:
        if len(matched.map_rows) >= 2:
            yield metres("map_rmse_m", rmse(matched.errors))
        if len(matched.diameter_errors_m):
            yield metres("diameter_rmse_m", rmse(matched.diameter_errors_m))
            bias_m = float(matched.diameter_errors_m.mean())
            yield Metric("diameter_bias_m", bias_m, "m", Direction.EXPECTED, 0.0)
        yield Metric("landmarks_found", len(matched.map_rows), "", Direction.HIGHER)
        yield _count("landmarks_missed", len(matched.missed), Direction.LOWER)
        yield _count("landmarks_false", len(matched.false), Direction.LOWER)
        yield _count("landmarks_duplicate", len(matched.duplicates), Direction.LOWER)
        yield from _shares(matched, len(landmarks))
    num_suspected = len(suspected_duplicates(landmarks))
    yield _count("landmarks_suspected_duplicate", num_suspected, Direction.LOWER)


def _shares(matched: MapErrors, num_landmarks: int) -> Iterator[Metric]:
    """How much of the map is right, and how much of what had to be found, or was, is in it."""
    num_found, num_missed = len(matched.map_rows), len(matched.missed)
    if num_landmarks:
        yield Metric("map_precision", num_found / num_landmarks, "", Direction.HIGHER)
    if num_found + num_missed:
        yield Metric("map_recall", num_found / (num_found + num_missed), "", Direction.HIGHER)


def _of_fast_map(result: RunResult, truth: Truth) -> Iterator[Metric]:
    matched = compare_map(result.fast_landmarks, truth, path_alignment(result.fast, truth))
    if matched is not None and len(matched.map_rows) >= 2:
        yield metres("fast_map_rmse_m", rmse(matched.errors))


def _of_poses(said: Said, path: TruePath) -> Iterator[Metric]:
    world_T_map = gauge(said.trajectory, path)
    if world_T_map is None or not len(said.covariances):
        return
    dof = 2 if path.headings is None else 3
    squares = pose_nees(said.trajectory, said.covariances, path, world_T_map)
    yield from squares_of("nees", squares, dof)
    # Errors along a run are no independent samples, the last ones of several runs are.
    yield Metric("nees_last", float(squares[-1]), "", Direction.EXPECTED, float(dof))


def _landmark_squares(
    trajectory: Trajectory, landmarks: tuple[Landmark, ...], truth: Truth, matched: MapErrors
) -> FloatArray:
    """(k,) NEES of the matched landmarks; none where the path and the true one never meet."""
    world_T_map = None if truth.path is None else gauge(trajectory, truth.path)
    if world_T_map is None or truth.landmarks is None:
        return np.zeros(0)
    return landmark_nees(landmarks, truth.landmarks, matched, world_T_map)


def squares_of(name: str, squares: FloatArray, dof: int) -> Iterator[Metric]:
    """The mean of normalised squares (n,), and the share within the 95 % bound."""
    known = squares[~np.isnan(squares)]
    if len(known):
        yield Metric(f"{name}_mean", float(known.mean()), "", Direction.EXPECTED, float(dof))
        share = observed_coverage(known, dof)
        yield Metric(f"{name}_coverage", share, "", Direction.EXPECTED, 0.95)


def _of_rotation(result: RunResult) -> Iterator[Metric]:
    for prefix, estimate in (("", result.smoothed), ("fast_", result.fast)):
        rates = turn_rates(estimate, result.imu)
        if rates is not None:
            yield Metric(f"{prefix}yaw_rate_rms_rad_s", rates.rms, "rad/s", Direction.LOWER)


def _of_run(result: RunResult) -> Iterator[Metric]:
    if result.wall_seconds > 0.0:
        rate = result.num_scans / result.wall_seconds
        yield Metric("scans_per_second", rate, "1/s", Direction.HIGHER)
    if len(result.fast_seconds):
        for name, share in (("median", 0.5), ("p99", 0.99)):
            latency_ms = 1e3 * float(np.quantile(result.fast_seconds, share))
            yield Metric(f"fast_latency_{name}_ms", latency_ms, "ms", Direction.LOWER)
    if result.online is not None:
        yield from _of_online(result.online)
    closures = [event for event in result.events if event.lower().startswith(LOOP_CLOSED)]
    yield _count("num_loop_closures", len(closures))


def _of_online(online: Online) -> Iterator[Metric]:
    if len(online.delays_s):
        for name, share in (("median", 0.5), ("p99", 0.99), ("max", 1.0)):
            delay_s = float(np.quantile(online.delays_s, share))
            yield Metric(f"online_delay_{name}_s", delay_s, "s", Direction.LOWER)
    yield _count("online_lag_max_scans", int(online.lags.max(initial=0)), Direction.LOWER)
    yield _count("online_restarts", online.num_restarts, Direction.LOWER)


def metres(name: str, value: float) -> Metric:
    """A length; the smaller, the better."""
    return Metric(name, value, "m", Direction.LOWER)


def _count(name: str, value: int, better: Direction = Direction.NEITHER) -> Metric:
    return Metric(name, float(value), "", better)
