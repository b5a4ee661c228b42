"""The charts over time: errors and NEES, over all seeds."""

from typing import Final

import numpy as np

from evaluation.consistency import bounds_of_mean
from evaluation.studies.trial import Outcome
from evaluation.study_report.chart import Chart
from evaluation.study_report.contents import Contents
from evaluation.study_report.legends import figure, legend, series_of
from evaluation.study_report.markup import Markup
from evaluation.study_report.scales import Scale, figure_text, scale_of
from semgraph.arrays import FloatArray

# The first pose is where it is said to be, and its NEES 1e-40: the axis is for what follows.
LEAST_NEES: Final = 0.01
_NUM_TIMES: Final = 80


def errors_over_time(contents: Contents, condition: str) -> Markup | None:
    """The median over the seeds of the position's error at each time."""
    found = [(each, _over_time(contents, condition, each.name)) for each in series_of(contents)]
    drawn = [(each, *curve) for each, curve in found if curve is not None]
    if not drawn:
        return None
    everything = np.concatenate([medians for _, _, medians in drawn])
    last_s = max(float(times[-1]) for _, times, _ in drawn)
    y = scale_of(everything, "position error (m)", logarithmic=True)
    chart = Chart(Scale(0.0, last_s, "time since the start (s)"), y)
    for each, times, over_seeds in drawn:
        chart.line(times, over_seeds, each.class_)
    ends = ", ".join(f"{each.name} {figure_text(float(ys[-1]))} m" for each, _, ys in drawn)
    title = f"Error over time, {condition}"
    return figure(
        chart.svg(title, f"At the end: {ends}."),
        f"{title}: median over the seeds of the position's error after rigid alignment.",
        legend(tuple(each for each, *_ in drawn)),
    )


def nees_over_time(contents: Contents, condition: str) -> Markup | None:
    """The mean NEES over the seeds at each time, of all that have covariances."""
    found = [(each, _nees_curve(contents, condition, each.name)) for each in series_of(contents)]
    drawn = [(each, *curve) for each, curve in found if curve is not None]
    expected = contents.expected(condition, "nees_mean")
    if not drawn or expected is None:
        return None
    dof, num_runs = round(expected), min(n for *_, n in drawn)
    low, high = bounds_of_mean(dof, num_runs)
    drawn = [(each, times, np.maximum(ys, LEAST_NEES), n) for each, times, ys, n in drawn]
    everything = np.concatenate([*[means for _, _, means, _ in drawn], [low, high]])
    last_s = max(float(times[-1]) for _, times, _, _ in drawn)
    y = scale_of(everything, "NEES of the pose", logarithmic=True)
    chart = Chart(Scale(0.0, last_s, "time since the start (s)"), y)
    ends = np.array([0.0, last_s])
    chart.band(ends, np.full(2, low), np.full(2, high), "allowed")
    for each, times, means, _ in drawn:
        chart.line(times, means, each.class_)
    told = ", ".join(f"{each.name} {figure_text(float(ys[-1]))}" for each, _, ys, _ in drawn)
    title = f"NEES over time, {condition}"
    return figure(
        chart.svg(title, f"At the end: {told}. Bounds {low:.2f} to {high:.2f}."),
        f"{title}: mean over the seeds at each time; shaded, where 95 % of such means of "
        f"{num_runs} honest runs lie.",
        legend(tuple(each for each, *_ in drawn)),
    )


def _over_time(
    contents: Contents, condition: str, estimator: str
) -> tuple[FloatArray, FloatArray] | None:
    its = [each for each in contents.finished(condition, estimator) if each.series is not None]
    if not its:
        return None
    times, values = on_one_clock(its, "position_errors_m")
    with np.errstate(all="ignore"):
        return times, _median_of_known(values)


def _nees_curve(
    contents: Contents, condition: str, estimator: str
) -> tuple[FloatArray, FloatArray, int] | None:
    its = [
        each
        for each in contents.finished(condition, estimator)
        if each.series is not None and np.isfinite(each.series.nees).any()
    ]
    if not its:
        return None
    times, values = on_one_clock(its, "nees")
    known = np.isfinite(values)
    counts = known.sum(axis=0)
    sums = np.where(known, values, 0.0).sum(axis=0)
    return times, np.where(counts > 0, sums / np.maximum(counts, 1), np.nan), len(its)


def on_one_clock(outcomes: list[Outcome], name: str) -> tuple[FloatArray, FloatArray]:
    """Times (m,) and values (n, m) of all series, each value that of the sample at or after."""
    series = [each.series for each in outcomes if each.series is not None]
    last_s = max((float(one.times_s[-1]) for one in series if len(one.times_s)), default=0.0)
    times = np.linspace(0.0, last_s, _NUM_TIMES)
    values = np.full((len(series), _NUM_TIMES), np.nan)
    for row, one in enumerate(series):
        at = np.searchsorted(one.times_s, times)
        inside = at < len(one.times_s)
        values[row, inside] = getattr(one, name)[at[inside]]
    return times, values


def _median_of_known(values: FloatArray) -> FloatArray:
    known = np.isfinite(values).any(axis=0)
    found = np.full(values.shape[1], np.nan)
    found[known] = np.nanmedian(values[:, known], axis=0)
    return found
