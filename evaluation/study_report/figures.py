"""The charts over all seeds: intervals, box plots, ECDFs, NEES, cost over accuracy."""

from typing import Final

import numpy as np

from evaluation.consistency import bounds_of_mean
from evaluation.metrics import Direction, Metric
from evaluation.study_report.chart import Chart, rows_chart
from evaluation.study_report.contents import CPU, Contents, capitalised, label_of, words_of
from evaluation.study_report.legends import figure, legend, series_of
from evaluation.study_report.markup import Markup
from evaluation.study_report.scales import Scale, figure_text, scale_of
from semgraph.arrays import FloatArray

_QUARTILES: Final = (0.25, 0.5, 0.75)


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


def nees(contents: Contents, condition: str) -> Markup | None:
    """The mean over the seeds of each estimator's NEES, with the bounds of chance."""
    metric = contents.metrics.get("nees_last")
    expected = contents.expected(condition, "nees_last")
    if metric is None or expected is None:
        return None
    ranked = contents.ranked(condition, metric)
    found = [
        (each.estimator, contents.values(condition, each.estimator, metric.name)) for each in ranked
    ]
    if not found:
        return None
    means = {name: float(values.mean()) for name, values in found}
    dof = round(expected)
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
    names_room = (x.high / x.low) ** 0.25 if x.logarithmic else 1.25
    x = Scale(x.low, x.high * names_room, x.label, x.logarithmic)
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
    """The median of each estimator under each condition, where three or more have a contest."""
    conditions = contents.conditions
    if len(contents.contests(metric)) < 3:
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
