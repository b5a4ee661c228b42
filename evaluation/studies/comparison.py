"""Estimators of a study compared on the same measurements: intervals, tests, and what is left out.

Intervals are percentile bootstraps over the seeds. There is none below six values: even from
the smallest to the largest value then covers the median less often than 95 %.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np
from scipy.stats import rankdata, wilcoxon

from evaluation.metrics import Direction, Metric
from evaluation.studies.trial import Outcome, Status
from semgraph.arrays import FloatArray, IntArray

ORACLE: Final = "oracle"
CONFIDENCE: Final = 0.95
MIN_FOR_INTERVAL: Final = 6
_NUM_RESAMPLES: Final = 2000
_MOST_EXACT: Final = 50


@dataclass(frozen=True, slots=True)
class Summary:
    """A metric of one estimator under one condition, over the seeds.

    Attributes:
        n: trials with a value; with `failures` and `absent` all there are.
        failures: trials that did not finish.
        absent: trials that finished without this metric, or with no finite value.
        low, high: the interval of the median; NaN below `MIN_FOR_INTERVAL` values.
        mean_low, mean_high: the interval of the mean, likewise.
        oracle_ratio: median of the value over that of the oracle on the same measurements, of
            metrics that are better lower; NaN where there is no pair, or the oracle's are 0.
        oracle_low, oracle_high: the ratio's interval.
        num_oracle: pairs in the ratio.
    """

    condition: str
    estimator: str
    metric: str
    unit: str
    better: Direction
    expected: float | None
    n: int
    failures: int
    absent: int
    median: float
    low: float
    high: float
    mean: float
    mean_low: float
    mean_high: float
    oracle_ratio: float
    oracle_low: float
    oracle_high: float
    num_oracle: int


@dataclass(frozen=True, slots=True)
class Difference:
    """A metric of two estimators under one condition, on the same measurements.

    Attributes:
        n: seeds for which both have a value; a difference of none is not told.
        left_out: seeds for which one of them has none, as it failed or lacks the metric.
        median: of first minus second; where a value is expected, of the distances from it.
        low, high: the median's interval; NaN below `MIN_FOR_INTERVAL` pairs.
        p: of Wilcoxon's signed ranks, two-sided.
        p_adjusted: after Holm, over all differences in this metric in the study.
    """

    condition: str
    metric: str
    unit: str
    better: Direction
    first: str
    second: str
    n: int
    left_out: int
    median: float
    low: float
    high: float
    p: float
    p_adjusted: float


def summaries(outcomes: Sequence[Outcome], rng: np.random.Generator) -> tuple[Summary, ...]:
    """Each metric of each estimator under each condition, in the order of first appearance.

    An estimator of which all trials finished without a metric is not told for that metric.
    """
    resampling = _Resampling(rng)
    return tuple(
        _summary(table, metric, estimator, resampling)
        for table in _tables(outcomes)
        for metric in table.metrics
        for estimator in table.estimators
        if np.isfinite(table.column(metric, estimator)).any() or table.failures(estimator)
    )


def differences(outcomes: Sequence[Outcome], rng: np.random.Generator) -> tuple[Difference, ...]:
    """Each two estimators under each condition, in each metric that can be better or worse."""
    resampling = _Resampling(rng)
    found = [
        difference
        for table in _tables(outcomes)
        for metric in table.metrics
        if metric.better is not Direction.NEITHER
        for difference in _of_pairs(table, metric, resampling)
    ]
    return tuple(_adjusted(found))


def winner(difference: Difference) -> str | None:
    """The better estimator of the two, None where chance may have made the difference.

    Ranks and the median may point to opposite sides, as where one estimator is a little better on
    most seeds and lost on the others: where the median's interval is on both sides of 0, neither
    is better.
    """
    if not difference.p_adjusted <= 1.0 - CONFIDENCE or difference.median == 0.0:
        return None
    if difference.low * difference.high < 0.0:
        return None
    is_first_lower = difference.median < 0.0
    is_lower_better = difference.better is not Direction.HIGHER
    return difference.first if is_first_lower is is_lower_better else difference.second


class _Table:
    """The outcomes under one condition: rows are seeds, and columns estimators."""

    def __init__(self, condition: str, outcomes: Sequence[Outcome]) -> None:
        self.condition = condition
        self.estimators = tuple(dict.fromkeys(each.trial.estimator for each in outcomes))
        self.metrics = tuple(
            {metric.name: metric for each in outcomes for metric in each.metrics}.values()
        )
        self._seeds = sorted({each.trial.seed for each in outcomes})
        row = {seed: k for k, seed in enumerate(self._seeds)}
        self._num_failures = dict.fromkeys(self.estimators, 0)
        self._is_there = {name: np.zeros(len(row), dtype=bool) for name in self.estimators}
        self._columns: dict[tuple[str, str], FloatArray] = {}
        for each in outcomes:
            estimator, k = each.trial.estimator, row[each.trial.seed]
            self._is_there[estimator][k] = True
            self._num_failures[estimator] += each.status is not Status.FINISHED
            for name, value in each.values.items():
                self._columns.setdefault((name, estimator), self._unknown())[k] = value

    def _unknown(self) -> FloatArray:
        return np.full(len(self._seeds), np.nan)

    def column(self, metric: Metric, estimator: str) -> FloatArray:
        """(seeds,) values, NaN where there is none."""
        known = self._columns.get((metric.name, estimator))
        return self._unknown() if known is None else np.where(np.isfinite(known), known, np.nan)

    def failures(self, estimator: str) -> int:
        """How many of its trials did not finish."""
        return self._num_failures[estimator]

    def num_trials(self, estimator: str) -> int:
        """How many trials it has."""
        return int(self._is_there[estimator].sum())

    def num_pairs(self, first: str, second: str) -> int:
        """For how many seeds there is a trial of both."""
        return int((self._is_there[first] & self._is_there[second]).sum())


def _tables(outcomes: Sequence[Outcome]) -> Iterator[_Table]:
    by_condition: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        by_condition.setdefault(outcome.trial.condition, []).append(outcome)
    for condition, its in by_condition.items():
        yield _Table(condition, its)


class _Resampling:
    """Bootstrap resamples as ranks: one drawing serves all columns of one length.

    The median of a resample of sorted values stands at the resample's median rank, so neither
    median nor mean has to draw again.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._drawn: dict[int, tuple[IntArray, FloatArray]] = {}

    def intervals(self, values: FloatArray) -> tuple[float, float, float, float]:
        """Low and high of the median, low and high of the mean, of finite values."""
        if len(values) < MIN_FOR_INTERVAL:
            return (np.nan,) * 4
        middles, weights = self._of_length(len(values))
        ordered = np.sort(values)
        tails = ((1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0)
        low, high = np.quantile(ordered[middles].mean(axis=1), tails)
        mean_low, mean_high = np.quantile(weights @ ordered, tails)
        return float(low), float(high), float(mean_low), float(mean_high)

    def _of_length(self, n: int) -> tuple[IntArray, FloatArray]:
        """(resamples, 2) ranks in the middle, and (resamples, n) weights of the ranks."""
        if n not in self._drawn:
            ranks = self._rng.integers(0, n, (_NUM_RESAMPLES, n))
            ranks.sort(axis=1)
            middles = ranks[:, [(n - 1) // 2, n // 2]]
            cells = ranks + n * np.arange(_NUM_RESAMPLES)[:, None]
            counts = np.bincount(cells.ravel(), minlength=n * _NUM_RESAMPLES)
            self._drawn[n] = middles, counts.reshape(_NUM_RESAMPLES, n) / n
        return self._drawn[n]


def _summary(table: _Table, metric: Metric, estimator: str, resampling: _Resampling) -> Summary:
    column = table.column(metric, estimator)
    values = column[np.isfinite(column)]
    n, failures = len(values), table.failures(estimator)
    low, high, mean_low, mean_high = resampling.intervals(values)
    ratios = _oracle_ratios(table, metric, column)
    ratio_low, ratio_high, _, _ = resampling.intervals(ratios)
    return Summary(
        condition=table.condition,
        estimator=estimator,
        metric=metric.name,
        unit=metric.unit,
        better=metric.better,
        expected=metric.expected,
        n=n,
        failures=failures,
        absent=table.num_trials(estimator) - n - failures,
        median=_median(values),
        low=low,
        high=high,
        mean=float(values.mean()) if n else np.nan,
        mean_low=mean_low,
        mean_high=mean_high,
        oracle_ratio=_median(ratios),
        oracle_low=ratio_low,
        oracle_high=ratio_high,
        num_oracle=len(ratios),
    )


def _oracle_ratios(table: _Table, metric: Metric, column: FloatArray) -> FloatArray:
    """(pairs,) of a column over the oracle's, where that can be told."""
    if metric.better is not Direction.LOWER or ORACLE not in table.estimators:
        return np.empty(0)
    best = table.column(metric, ORACLE)
    is_pair = np.isfinite(column) & (best > 0.0)
    return np.asarray(column[is_pair] / best[is_pair])


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else np.nan


def _of_pairs(table: _Table, metric: Metric, resampling: _Resampling) -> Iterator[Difference]:
    for first, second in combinations(table.estimators, 2):
        gaps = _judged(table, metric, first) - _judged(table, metric, second)
        gaps = gaps[np.isfinite(gaps)]
        if not len(gaps):
            continue
        low, high, _, _ = resampling.intervals(gaps)
        yield Difference(
            condition=table.condition,
            metric=metric.name,
            unit=metric.unit,
            better=metric.better,
            first=first,
            second=second,
            n=len(gaps),
            left_out=table.num_pairs(first, second) - len(gaps),
            median=_median(gaps),
            low=low,
            high=high,
            p=_p_value(gaps),
            p_adjusted=np.nan,
        )


def _judged(table: _Table, metric: Metric, estimator: str) -> FloatArray:
    """(seeds,) the column, or how far it is from what is expected."""
    column = table.column(metric, estimator)
    return column if metric.expected is None else np.abs(column - metric.expected)


def _p_value(gaps: FloatArray) -> float:
    """Of gaps as far from 0 as these, or further, if none of the two were better."""
    gaps = gaps[gaps != 0.0]
    if not len(gaps):
        return 1.0
    return _exact_p_value(gaps) if len(gaps) <= _MOST_EXACT else float(wilcoxon(gaps).pvalue)


def _exact_p_value(gaps: FloatArray) -> float:
    """Among all signs of the ranks, of which equal ones share the mean, the share as extreme.

    scipy counts them only without ties; with ties it tries each for up to 13 gaps, half a second a
    test, and takes the normal law for more.
    """
    doubled = np.rint(2.0 * rankdata(np.abs(gaps))).astype(np.int64)
    shares = np.zeros(int(doubled.sum()) + 1)
    shares[0] = 1.0
    for rank in doubled.tolist():
        shares[rank:] += shares[:-rank].copy()
        shares *= 0.5
    above = int(doubled[gaps > 0.0].sum())
    extreme = min(above, len(shares) - 1 - above)
    return min(1.0, 2.0 * float(shares[: extreme + 1].sum()))


def _adjusted(found: Sequence[Difference]) -> Iterator[Difference]:
    """Holm's step-down in each metric: the k-th smallest p counts times those not yet passed."""
    by_metric: dict[str, list[int]] = {}
    for k, difference in enumerate(found):
        by_metric.setdefault(difference.metric, []).append(k)
    adjusted = np.empty(len(found))
    for members in by_metric.values():
        p_values = np.array([found[k].p for k in members])
        order = np.argsort(p_values)
        steps = p_values[order] * np.arange(len(members), 0, -1)
        adjusted[np.array(members)[order]] = np.minimum(np.maximum.accumulate(steps), 1.0)
    for difference, value in zip(found, adjusted, strict=True):
        yield replace(difference, p_adjusted=float(value))
