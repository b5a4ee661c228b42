"""An estimate judged against the truth: figures, errors over time, and what a page draws."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from evaluation.association import compare_associations
from evaluation.closures import compare_closures
from evaluation.consistency import gauge, pose_nees
from evaluation.estimators.estimate import Estimate
from evaluation.metrics import (
    Direction,
    Metric,
    Said,
    known_only,
    metrics_of,
    squares_of,
    trajectory_metrics,
)
from evaluation.oracle import true_rows
from evaluation.studies.trial import MAX_SAMPLES, Drawing, Series
from evaluation.trajectory import PathErrors, compare_path
from semgraph.arrays import FloatArray, IntArray
from sensors.truth import Source, TruePath, Truth

# Figures that the machine has a part in: two runs of one trial differ in these, and in no others.
OF_THE_MACHINE: Final = frozenset(
    {"latency_p50_ms", "latency_p99_ms", "latency_max_ms", "cpu_s", "peak_memory_mb"}
)
_QUANTILES: Final = {"p50": 0.5, "p99": 0.99, "max": 1.0}


def judge_estimate(estimate: Estimate, source: Source) -> tuple[Metric, ...]:
    """Every metric that the estimate and what is known of the truth allow; the others are absent.

    Those of path, map and covariances are of `metrics.judge`.
    """
    truth = source.truth
    said = Said(
        estimate.trajectory,
        estimate.covariances,
        estimate.landmarks if _makes_a_map(estimate) else None,
    )
    return known_only(
        [
            *metrics_of(said, truth),
            *_of_online(estimate, truth),
            *_of_associations(estimate, source),
            *squares_of("nis", estimate.nis, 2),
            *_of_closures(estimate, truth),
            *_of_latency(estimate),
        ]
    )


def series_of(estimate: Estimate, source: Source) -> Series | None:
    """Errors over time; None where the truth has no path, or they never meet."""
    path = source.truth.path
    errors = None if path is None else compare_path(estimate.trajectory, path)
    if path is None or errors is None:
        return None
    nees, kept = _nees(estimate, path, len(errors.rows)), np.flatnonzero(~errors.is_outlier)
    stamps_ns = path.stamps_ns[errors.rows]
    starts, ends = _stretches(len(kept))
    last = kept[ends]
    return Series(
        1e-9 * (stamps_ns[last] - stamps_ns[0]),
        np.maximum.reduceat(errors.distances[kept], starts),
        _largest_turns(errors, kept, starts),
        nees[last],
    )


def drawing_of(estimate: Estimate, source: Source) -> Drawing | None:
    """Paths and maps; None where the truth has no path, or they never meet."""
    truth = source.truth
    errors = None if truth.path is None else compare_path(estimate.trajectory, truth.path)
    if truth.path is None or errors is None:
        return None
    positions = estimate.trajectory.map_T_bases[:, :2]
    map_t_landmarks = [landmark.map_t_landmark for landmark in estimate.landmarks]
    return Drawing(
        _thinned(truth.path.world_t_reference),
        errors.world_T_map.transform(_thinned(positions)),
        np.zeros((0, 2)) if truth.landmarks is None else truth.landmarks.world_t_landmarks,
        errors.world_T_map.transform(np.array(map_t_landmarks).reshape(-1, 2)),
    )


def _makes_a_map(estimate: Estimate) -> bool:
    """An estimator that makes none takes nothing for a landmark of it either."""
    return bool(estimate.landmarks) or _associates(estimate)


def _associates(estimate: Estimate) -> bool:
    return any((ids >= 0).any() for ids in estimate.associations.values())


def _of_online(estimate: Estimate, truth: Truth) -> Iterator[Metric]:
    """What was known in time; of a filter that is its path."""
    if truth.path is not None and estimate.online is not None:
        yield from trajectory_metrics(estimate.online, truth.path, "online_")


def _of_associations(estimate: Estimate, source: Source) -> Iterator[Metric]:
    if not _associates(estimate):
        return
    pairs = compare_associations(estimate.associations, _true_associations(estimate, source))
    if pairs is not None:
        yield Metric("association_precision", pairs.precision, "", Direction.HIGHER)
        yield Metric("association_recall", pairs.recall, "", Direction.HIGHER)


def _true_associations(estimate: Estimate, source: Source) -> Mapping[int, IntArray]:
    """By stamp; of raw measurements the truth tells what is in sight, not what was found."""
    truth = source.truth
    if not source.recording.detectors:
        return truth.associations or {}
    if truth.path is None or truth.path.headings is None or truth.landmarks is None:
        return {}
    return true_rows(source, estimate.perceptions)


def _of_closures(estimate: Estimate, truth: Truth) -> Iterator[Metric]:
    """What works on all at once closes no loop in time."""
    is_online = len(estimate.step_seconds) > 0
    if truth.associations is None or not _associates(estimate) or not is_online:
        return
    closures = compare_closures(estimate.closed_at_ns, truth.associations)
    if closures is not None:
        yield Metric("loops_closed", closures.share_closed, "", Direction.HIGHER)
        closed = closures.delays_s[np.isfinite(closures.delays_s)]
        if len(closed):
            delay_s = float(np.median(closed))
            yield Metric("time_to_closure_s", delay_s, "s", Direction.LOWER)


def _of_latency(estimate: Estimate) -> Iterator[Metric]:
    if len(estimate.step_seconds):
        for name, share in _QUANTILES.items():
            latency_ms = 1e3 * float(np.quantile(estimate.step_seconds, share))
            yield Metric(f"latency_{name}_ms", latency_ms, "ms", Direction.LOWER)


def _nees(estimate: Estimate, path: TruePath, count: int) -> FloatArray:
    """(n,) at the compared times; NaN where no covariance is known."""
    world_T_map = gauge(estimate.trajectory, path)
    if world_T_map is None or not len(estimate.covariances):
        return np.full(count, np.nan)
    return pose_nees(estimate.trajectory, estimate.covariances, path, world_T_map)


def _stretches(count: int) -> tuple[IntArray, IntArray]:
    """First and last row of each of at most `MAX_SAMPLES` stretches."""
    bounds = np.unique(np.linspace(0, count, MAX_SAMPLES + 1).astype(np.int64))
    return bounds[:-1], bounds[1:] - 1


def _largest_turns(errors: PathErrors, kept: IntArray, starts: IntArray) -> FloatArray:
    """(k,) deg; NaN where the truth has no headings."""
    if errors.heading_errors is None:
        return np.full(len(starts), np.nan)
    degrees: FloatArray = np.degrees(np.abs(errors.heading_errors))
    return np.maximum.reduceat(degrees[kept], starts)


def _thinned(points: FloatArray) -> FloatArray:
    """At most `MAX_SAMPLES` of (n, 2), the first and the last among them."""
    rows = np.unique(np.linspace(0, len(points) - 1, MAX_SAMPLES).round().astype(np.int64))
    return points[rows]
