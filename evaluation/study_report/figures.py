"""The charts over all seeds: intervals, box plots, ECDFs, errors over time, NEES, cost."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.consistency import bounds_of_mean
from evaluation.metrics import Direction, Metric
from evaluation.studies.trial import Outcome
from evaluation.study_report.chart import Chart, rows_chart
from evaluation.study_report.contents import CPU, Contents, capitalised, label_of, words_of
from evaluation.study_report.markup import Markup, element
from evaluation.study_report.scales import Scale, figure_text, scale_of
from semgraph.arrays import FloatArray

_NUM_TIMES: Final = 80
_SPREAD: Final = (0.1, 0.5, 0.9)


@dataclass(frozen=True, slots=True)
class Series:
    """An estimator's colour and dash, the same in the whole report."""

    name: str
    class_: str


def series_of(contents: Contents) -> tuple[Series, ...]:
    """A line for each estimator: lines that lie on each other differ in colour and in dash."""
    return tuple(
        Series(name, f"c{number % 5} d{number % 3}")
        for number, name in enumerate(contents.estimators)
    )


def figure(svg: Markup, caption: str, legend: Markup | None = None) -> Markup:
    """A chart with its caption, and its legend between."""
    return element("figure", svg, legend or Markup(), element("figcaption", caption))


def legend(lines: tuple[Series, ...]) -> Markup:
    """Which line is whose."""
    return element(
        "ul", *[element("li", swatch(each.class_), each.name) for each in lines], class_="legend"
    )


def swatch(class_: str) -> Markup:
    """A short piece of a line."""
    line = element("path", class_=f"line {class_}", d="M1 5h24")
    return element("svg", line, viewBox="0 0 26 10", width=26, height=10, aria_hidden="true")


def medians(contents: Contents, condition: str, metric: Metric) -> Markup:
    """Median and interval of each estimator, the best at the top."""
    ranked = contents.ranked(condition, metric)
    ends = np.array([[each.low, each.median, each.high] for each in ranked]).ravel()
    chart = rows_chart([each.estimator for each in ranked], _scale(metric, ends))
    told = []
    for row, each in enumerate(reversed(ranked)):
        if np.isfinite([each.low, each.high]).all():
            chart.box(each.low, each.high, row, "interval", 0.13)
        chart.dots(np.array([each.median]), np.array([float(row)]), "c0", 4.0)
        told.append(f"{each.estimator} {figure_text(each.median)}")
    title = f"{capitalised(words_of(metric))}, {condition}"
    return figure(
        chart.svg(title, "Medians from best to worst: " + ", ".join(reversed(told)) + "."),
        f"{title}: median (dot) and its 95 % interval (bar), best first.",
    )


def boxes(contents: Contents, condition: str, metric: Metric) -> Markup:
    """Quartiles, and whiskers to the last value within 1.5 times their distance."""
    found = [
        (each.estimator, contents.values(condition, each.estimator, metric.name))
        for each in contents.ranked(condition, metric)
    ]
    everything = np.concatenate([values for _, values in found])
    chart = rows_chart([name for name, _ in found], _scale(metric, everything))
    for row, (_, values) in enumerate(reversed(found)):
        _draw_box(chart, float(row), values)
    told = ", ".join(
        f"{name} {figure_text(float(low))} to {figure_text(float(high))}"
        for name, values in found
        for low, high in [np.quantile(values, (0.25, 0.75))]
    )
    title = f"Spread of {words_of(metric)}, {condition}"
    return figure(
        chart.svg(title, f"Middle halves: {told}."),
        f"{title}: box from quartile to quartile, line at the median, whiskers to 1.5 box "
        "lengths, dots beyond.",
    )


def ecdfs(contents: Contents, condition: str, metric: Metric) -> Markup:
    """Which share of the seeds stays below a value."""
    lines = series_of(contents)
    found = [(each, contents.values(condition, each.name, metric.name)) for each in lines]
    found = [(each, np.sort(values)) for each, values in found if len(values)]
    everything = np.concatenate([values for _, values in found])
    chart = Chart(_scale(metric, everything), Scale(0.0, 1.0, "share of the seeds"))
    for each, values in found:
        xs = np.repeat(values, 2)
        ys = np.repeat(np.arange(len(values) + 1) / len(values), 2)[1:-1]
        whole = np.concatenate([xs, [chart.x.high]]), np.concatenate([ys, [1.0]])
        chart.line(*whole, each.class_)
    worst = ", ".join(f"{each.name} {figure_text(values[-1])}" for each, values in found)
    title = f"Distribution of {words_of(metric)}, {condition}"
    return figure(
        chart.svg(title, f"The largest value of each: {worst}."),
        f"{title}: for each value, the share of the seeds that stay at or below it.",
        legend(tuple(each for each, _ in found)),
    )


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


def nees(contents: Contents, condition: str) -> Markup | None:
    """The mean over the seeds of each estimator's NEES, with the bounds of chance."""
    metric = contents.metrics.get("nees_last")
    if metric is None or metric.expected is None:
        return None
    ranked = contents.ranked(condition, metric)
    found = [
        (each.estimator, contents.values(condition, each.estimator, metric.name)) for each in ranked
    ]
    if not found:
        return None
    means = {name: float(values.mean()) for name, values in found}
    dof = round(metric.expected)
    bounds = {name: bounds_of_mean(dof, len(values)) for name, values in found}
    seen = np.concatenate([values for _, values in found]).clip(min=0.1)
    ends = np.array([*seen, *[end for pair in bounds.values() for end in pair]])
    x = scale_of(ends, "NEES of the last pose", logarithmic=True)
    chart = rows_chart([name for name, _ in found], x)
    for row, (name, values) in enumerate(reversed(found)):
        chart.box(*bounds[name], row, "allowed", 0.34)
        chart.dots(values, np.full(len(values), row - 0.2), "c0 faint", 1.6)
        chart.dots(np.array([means[name]]), np.array([row + 0.08]), "c0", 4.0)
    chart.upright(float(dof), "expected")
    told = ", ".join(f"{name} {figure_text(mean)}" for name, mean in means.items())
    title = f"Consistency, {condition}"
    return figure(
        chart.svg(title, f"Mean NEES, {dof} is honest: {told}."),
        f"{title}: NEES of each run's last pose (small dots) and its mean (large). Honest "
        f"covariances have {dof} and stay within the shaded 95 % bounds; further right an "
        "estimator is too sure of itself. Poses along one run are not independent, the last ones "
        "of several runs are.",
    )


def nees_over_time(contents: Contents, condition: str) -> Markup | None:
    """The mean NEES over the seeds at each time, of all that have covariances."""
    found = [(each, _nees_curve(contents, condition, each.name)) for each in series_of(contents)]
    drawn = [(each, *curve) for each, curve in found if curve is not None]
    metric = contents.metrics.get("nees_mean")
    if not drawn or metric is None or metric.expected is None:
        return None
    dof, num_runs = round(metric.expected), min(n for *_, n in drawn)
    low, high = bounds_of_mean(dof, num_runs)
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


def cost_over_accuracy(contents: Contents, condition: str, metric: Metric) -> Markup | None:
    """CPU time and error of each estimator, medians with quartiles."""
    found = []
    for each in contents.estimators:
        costs = contents.values(condition, each, CPU.name)
        errors = contents.values(condition, each, metric.name)
        if len(errors) and (costs > 0.0).any():
            found.append((each, np.quantile(costs, _QUARTILES), np.quantile(errors, _QUARTILES)))
    if not found:
        return None
    x = scale_of(np.array([cost for _, cost, _ in found]), "CPU time (s)", logarithmic=True)
    x = Scale(x.low, x.high * (x.high / x.low) ** 0.25, x.label, x.logarithmic)
    y = _scale(metric, np.array([error for *_, error in found]).ravel())
    chart = Chart(x, y)
    for _, cost, error in found:
        chart.line(cost, np.repeat(error[1], 3), "c0 thin")
        chart.line(np.repeat(cost[1], 3), error, "c0 thin")
        chart.dots(cost[1:2], error[1:2], "c0", 4.0)
    chart.labels([(float(cost[1]), float(error[1]), name) for name, cost, error in found])
    told = ", ".join(
        f"{name} {figure_text(float(cost[1]))} s for {figure_text(float(error[1]))} {metric.unit}"
        for name, cost, error in found
    )
    title = f"Cost over accuracy, {condition}"
    better = "up" if metric.better is Direction.HIGHER else "down"
    return figure(
        chart.svg(title, f"Medians: {told}."),
        f"{title}: medians with quartiles; left is cheaper, {better} is more accurate.",
    )


def across_conditions(contents: Contents, metric: Metric) -> Markup | None:
    """The median of each estimator under each condition, where there are three or more."""
    conditions = contents.conditions
    if len(conditions) < 3:
        return None
    places = np.arange(len(conditions), dtype=float)
    found = []
    for each in series_of(contents):
        its = [contents.summary(condition, each.name, metric.name) for condition in conditions]
        found.append((each, np.array([one.median if one else np.nan for one in its])))
    found = [(each, values) for each, values in found if np.isfinite(values).any()]
    everything = np.concatenate([values for _, values in found])
    chart = rows_chart(conditions, _scale(metric, everything), 34.0)
    for each, values in found:
        chart.line(values, places[::-1], each.class_)
        chart.dots(values, places[::-1], each.class_, 3.0)
    title = f"{capitalised(words_of(metric))} under each condition"
    told = "; ".join(
        f"{each.name} " + ", ".join(figure_text(float(value)) for value in values)
        for each, values in found
    )
    return figure(
        chart.svg(title, f"Medians, in the order of the conditions: {told}."),
        f"{title}: medians over the seeds, from the top as in the study's file.",
        legend(tuple(each for each, _ in found)),
    )


_QUARTILES: Final = (0.25, 0.5, 0.75)


def _scale(metric: Metric, values: FloatArray) -> Scale:
    """By powers of ten where all is above zero and spreads over more than a factor of five."""
    kept = values[np.isfinite(values)]
    spreads = len(kept) > 0 and kept.min() > 0.0 and kept.max() > 5.0 * kept.min()
    return scale_of(values, label_of(metric), logarithmic=bool(spreads))


def _draw_box(chart: Chart, row: float, values: FloatArray) -> None:
    low, middle, high = np.quantile(values, _QUARTILES)
    reach = 1.5 * (high - low)
    inside = values[(values >= low - reach) & (values <= high + reach)]
    at = np.full(2, row)
    chart.line(np.array([inside.min(), low]), at, "c0 thin")
    chart.line(np.array([high, inside.max()]), at, "c0 thin")
    chart.box(float(low), float(high), row, "box")
    chart.line(np.array([middle, middle]), np.array([row - 0.28, row + 0.28]), "c0")
    outside = values[(values < low - reach) | (values > high + reach)]
    if len(outside):
        chart.dots(outside, np.full(len(outside), row), "c0", 1.6)


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
