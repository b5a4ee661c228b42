"""The tables: figures with intervals, differences, failures, all trials, and terms."""

from typing import Final

import numpy as np

from evaluation.metrics import Direction, Metric
from evaluation.studies.comparison import Summary, winner
from evaluation.studies.trial import Outcome, Status
from evaluation.study_report.contents import Contents, label_of, words_of
from evaluation.study_report.markup import Markup, element, joined
from evaluation.study_report.paired import alike
from evaluation.study_report.scales import MINUS, UNKNOWN, figure_text, figure_texts
from evaluation.study_report.wording import p_text

_ARROWS: Final = {Direction.LOWER: " ↓", Direction.HIGHER: " ↑"}


def table(caption: str, columns: list[str], rows: list[list[str]]) -> Markup:
    """A table whose first column names the rows; it scrolls where it is too wide."""
    head = element("tr", *[element("th", name, scope="col") for name in columns])
    body = [
        element("tr", element("th", cells[0], scope="row"), *map(_cell, cells[1:]))
        for cells in rows
    ]
    whole = element(
        "table",
        element("caption", element("span", caption)),
        element("thead", head),
        element("tbody", *body),
    )
    return element("div", whole, class_="scroll", tabindex=0, role="region", aria_label=caption)


def headline_table(contents: Contents, condition: str) -> Markup:
    """Estimators as rows, what is judged first as columns."""
    metrics = contents.headlines
    best = {each.name: alike(contents, condition, each) for each in metrics}
    rows = []
    for estimator in contents.estimators_of(condition):
        cells = [estimator]
        for metric in metrics:
            found = contents.summary(condition, estimator, metric.name)
            is_best = found is not None and estimator in best[metric.name]
            cells.append(_median_cell(found, "best" if is_best else None))
        found = contents.summary(condition, estimator, metrics[0].name)
        cells.append(_ratio_cell(found))
        rows.append(cells)
    columns = [
        "estimator",
        *[_heading(contents, condition, each) for each in metrics],
        "first column / oracle's",
    ]
    return table(
        f"{condition}: medians over the seeds, 95 % intervals below; ↓ lower is better, ↑ higher. "
        "Bold: the best that is told nothing but the measurements, and those from which no "
        "difference can be shown.",
        columns,
        rows,
    )


def all_metrics_table(contents: Contents, condition: str) -> Markup:
    """Metrics as rows, estimators as columns."""
    rows = []
    for metric in contents.metrics.values():
        found = [
            contents.summary(condition, each, metric.name)
            for each in contents.estimators_of(condition)
        ]
        if any(each is not None for each in found):
            rows.append(
                [
                    _heading(contents, condition, metric),
                    *[_median_cell(each, None) for each in found],
                ]
            )
    columns = ["metric", *contents.estimators_of(condition)]
    return table(f"{condition}: every metric, medians and 95 % intervals", columns, rows)


def difference_table(contents: Contents, condition: str, metric: Metric) -> Markup:
    """Each two estimators on the same seeds."""
    rows = [
        [
            f"{each.first} {MINUS} {each.second}",
            _value(each.median, each.low, each.high),
            str(each.n) + (f" ({each.left_out} left out)" if each.left_out else ""),
            p_text(each.p),
            p_text(each.p_adjusted),
            element("span", winner(each) or "none can be shown"),
        ]
        for each in contents.differences
        if each.condition == condition and each.metric == metric.name
    ]
    columns = ["estimators", f"difference ({metric.unit})" if metric.unit else "difference",
               "paired seeds", "Wilcoxon", "after Holm", "better"]  # fmt: skip
    caption = f"{condition}: paired differences in {words_of(metric)}, median and 95 % interval"
    return table(caption, columns, rows)


def failure_table(contents: Contents) -> Markup:
    """What did not finish, why, and how to run it alone."""
    if not contents.failed:
        return element("p", "None: every trial finished.")
    rows = [
        [
            each.trial.estimator,
            _words(each.trial.condition),
            str(each.trial.seed),
            _words(each.status.value),
            _words(each.reason),
            element("code", contents.one_again.replace("{id}", each.trial.id)),
        ]
        for each in contents.failed
    ]
    columns = ["estimator", "condition", "seed", "status", "reason", "run it alone"]
    return table("Trials that did not finish", columns, rows)


def trial_table(contents: Contents, condition: str) -> Markup:
    """A row for each seed, and a link to each trial's page."""
    metric = contents.primary
    by_seed: dict[int, dict[str, Outcome]] = {}
    for each in contents.outcomes:
        if each.trial.condition == condition:
            by_seed.setdefault(each.trial.seed, {})[each.trial.estimator] = each
    rows = [
        [str(seed), *[_link(its.get(name), metric) for name in contents.estimators_of(condition)]]
        for seed, its in sorted(by_seed.items())
    ]
    what = f", {label_of(metric)}" if metric else ""
    columns = ["seed", *contents.estimators_of(condition)]
    return table(f"{condition}{what}: each value leads to its trial's page", columns, rows)


def _link(outcome: Outcome | None, metric: Metric | None) -> str:
    if outcome is None:
        return ""
    value = outcome.values.get(metric.name, np.nan) if metric else np.nan
    text = figure_text(value) if np.isfinite(value) else "no value"
    if outcome.status is not Status.FINISHED:
        text = outcome.status.value
    return element("a", text, href=f"#trial-{outcome.trial.id}")


def _median_cell(summary: Summary | None, class_: str | None) -> Markup:
    if summary is None:
        return element("td", UNKNOWN)
    return element("td", _value(summary.median, summary.low, summary.high), class_=class_)


def _ratio_cell(summary: Summary | None) -> Markup:
    if summary is None or not np.isfinite(summary.oracle_ratio):
        return element("td", UNKNOWN)
    value = _value(summary.oracle_ratio, summary.oracle_low, summary.oracle_high)
    return element("td", value)


def _value(median: float, low: float, high: float) -> Markup:
    if not np.isfinite([low, high]).all():
        return element("span", figure_text(median))
    shown, *ends = figure_texts(median, low, high)
    return joined([shown, element("small", " to ".join(ends))])


def _heading(contents: Contents, condition: str, metric: Metric) -> str:
    expected = contents.expected(condition, metric.name)
    told = f", expected {expected:g}" if expected is not None else ""
    return label_of(metric) + told + _ARROWS.get(metric.better, "")


def _cell(content: str) -> Markup:
    if isinstance(content, Markup) and content.startswith("<td"):
        return content
    return element("td", content)


def _words(text: str) -> Markup:
    return element("td", text, class_="words")
