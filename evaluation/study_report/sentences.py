"""What a study says, in sentences: what won, by how much, and where no difference can be shown."""

from collections import Counter
from typing import Final

import numpy as np

from evaluation.metrics import Direction, Metric
from evaluation.studies.comparison import (
    CONFIDENCE,
    MIN_FOR_INTERVAL,
    Difference,
    Summary,
    winner,
)
from evaluation.study_report.contents import TOLD_MORE, Contents, capitalised, words_of
from evaluation.study_report.markup import Markup, element, joined
from evaluation.study_report.scales import figure_text, figure_texts

_SMALLEST_P: Final = 0.001
# From so many conditions on, each is told in a sentence or two.
_MANY: Final = 3


def summary(contents: Contents) -> list[Markup]:
    """Paragraphs: how much there is, what was best under each condition, what failed."""
    told = [element("p", joined(_extent(contents)))]
    primary = contents.primary
    if primary is None:
        return [*told, element("p", "Nothing was measured: no trial finished with a figure.")]
    is_short = len(contents.conditions) >= _MANY
    for condition in contents.conditions:
        told += ranking(contents, condition, primary, is_short=is_short)
    told.append(_power(contents, primary))
    others = _leads if is_short else _others
    told += [others(contents, metric) for metric in contents.headlines[1:]]
    return [each for each in told if each]


def ranking(
    contents: Contents, condition: str, metric: Metric, *, is_short: bool = False
) -> list[Markup]:
    """The best estimator, and what it has over each of the others; folded away if to be short."""
    ranked = list(contents.contenders(condition, metric))
    if not ranked:
        return [element("p", f"{condition}: no estimator has a {words_of(metric)}.")]
    best, rest = ranked[0], ranked[1:]
    where = element("strong", condition)
    opening = joined(
        [where, ": ", _code(best.estimator), f" has the {_superlative(metric)} median ",
         f"{words_of(metric)}, {with_interval(best)}."]
    )  # fmt: skip
    more = _told_more(contents, condition, metric)
    if not rest:
        return [element("p", opening), more]
    lines = [_against(contents, best, each) for each in rest]
    return [
        element("p", opening, " ", _in_short(contents, best, rest)),
        element("details", element("summary", "By how much"), element("ul", *lines), more)
        if is_short
        else joined([element("ul", *lines), more]),
    ]


def with_interval(summary: Summary) -> str:
    """The median with unit, interval and number of seeds."""
    value = _valued(summary.median, summary.unit)
    seeds = f"{summary.n} seed" + "s" * (summary.n != 1)
    if not np.isfinite([summary.low, summary.high]).all():
        return f"{value} ({seeds}, too few for an interval)"
    return f"{value} (95 % interval {span(summary.low, summary.high)}, {seeds})"


def span(low: float, high: float) -> str:
    """Both ends of an interval."""
    return " to ".join(figure_texts(low, high))


def p_text(p: float) -> str:
    """A p-value as one reads it."""
    if np.isnan(p):
        return "p unknown"
    return f"p < {_SMALLEST_P:g}" if p < _SMALLEST_P else f"p = {p:.2g}"


def difference_of(
    contents: Contents, condition: str, metric: str, first: str, second: str
) -> Difference | None:
    """The difference of two estimators, whichever is named first in the study."""
    pair = {first, second}
    return next(
        (
            each
            for each in contents.differences
            if each.condition == condition
            and each.metric == metric
            and {each.first, each.second} == pair
        ),
        None,
    )


def compared(contents: Contents, condition: str, metric: Metric, one: str, other: str) -> Markup:
    """A sentence on two estimators: which is better and by how much, or that none can be shown."""
    found = difference_of(contents, condition, metric.name, one, other)
    if found is None:
        return joined(["No seed has a ", words_of(metric), " of both ", _code(one), " and ",
                       _code(other), "."])  # fmt: skip
    won = winner(found)
    evidence = f"{found.n} paired seeds, {p_text(found.p_adjusted)} after Holm"
    if found.n < MIN_FOR_INTERVAL:
        evidence = f"only {found.n} paired seeds"
    if won is None:
        between = f" ({_signed(found)}; {evidence})."
        return joined(
            ["Between ", _code(one), " and ", _code(other), " no difference in ", words_of(metric),
             " can be shown", between]
        )  # fmt: skip
    loser = found.second if won == found.first else found.first
    return joined(
        [_code(won), " is better than ", _code(loser), f" in {words_of(metric)} by ",
         f"{_size(found)} ({evidence})."]
    )  # fmt: skip


def _extent(contents: Contents) -> list[str]:
    num_failed, num = len(contents.failed), len(contents.outcomes)
    seeds = len({each.trial.seed for each in contents.outcomes})
    parts = [
        f"{num} trials: {_counted(len(contents.estimators), 'estimator')} under "
        f"{_counted(len(contents.conditions), 'condition')} with {_counted(seeds, 'seed')}. "
    ]
    if num < contents.num_planned:
        missing = f"The study is not finished: {contents.num_planned - num} trials have not run. "
        parts.append(element("strong", missing))
    if not num_failed:
        return [*parts, "All that ran finished."]
    by_kind = Counter((each.trial.estimator, each.status.value) for each in contents.failed)
    told = ", ".join(f"{count} of {name} ({how})" for (name, how), count in by_kind.most_common(6))
    more = " and others" if len(by_kind) > 6 else ""
    return [
        *parts,
        element("strong", f"{num_failed} did not finish"),
        f": {told}{more}. Comparisons leave their seeds out, so read them with the ",
        element("a", "failures", href="#failures"),
        " in mind.",
    ]


def _in_short(contents: Contents, best: Summary, rest: list[Summary]) -> str:
    """Whether the first place is more than chance."""
    beaten: list[str] = []
    undecided: list[str] = []
    for each in rest:
        found = difference_of(contents, best.condition, best.metric, best.estimator, each.estimator)
        won = found is not None and winner(found) == best.estimator
        (beaten if won else undecided).append(each.estimator)
    if not undecided:
        return "That is better than each of the others beyond what chance explains:"
    if not beaten:
        return "No difference from any of the others can be shown:"
    return (
        f"It is shown to be better than {_listed(beaten)}; "
        f"from {_listed(undecided)} no difference in its favour can be shown:"
    )


def _told_more(contents: Contents, condition: str, metric: Metric) -> Markup:
    """The medians of those that know more than the measurements, as what to compare with."""
    found = [
        f"{each.estimator} ({TOLD_MORE[each.estimator]}) {_valued(each.median, each.unit)}"
        for each in contents.ranked(condition, metric)
        if each.estimator in TOLD_MORE
    ]
    words = f"Not ranked, as they are told more than the measurements: {', '.join(found)}."
    return element("p", words, class_="note") if found else Markup()


def _power(contents: Contents, metric: Metric) -> Markup:
    """That there are too few seeds to show any difference, where that is so."""
    family = [each for each in contents.differences if each.metric == metric.name]
    most = max((each.n for each in family), default=0)
    smallest = min(1.0, len(family) * 0.5 ** (most - 1))
    if not family or smallest <= 1.0 - CONFIDENCE:
        return Markup()
    words = (
        f"With {_counted(most, 'seed')} and {len(family)} comparisons even the clearest difference "
        f"has p = {smallest:.2g} after Holm: to show any, there must be more seeds."
    )
    return element("p", words, class_="note")


def _against(contents: Contents, best: Summary, other: Summary) -> Markup:
    found = difference_of(contents, best.condition, best.metric, best.estimator, other.estimator)
    median = _valued(other.median, other.unit)
    opening = [_code(other.estimator), f": {median}, "]
    if found is None:
        return element("li", joined([*opening, "no seed in common."]))
    won = winner(found)
    if won == best.estimator:
        ratio = _ratio(best, other)
        words = f"{_worse(best.better)} by {_size(found)}{ratio}; {p_text(found.p_adjusted)}."
    elif won == other.estimator:
        words = (
            f"yet on the same seeds {_better(best.better)} by {_size(found)}; "
            f"{p_text(found.p_adjusted)}."
        )
    elif found.n < MIN_FOR_INTERVAL:
        words = f"no difference can be shown with {_counted(found.n, 'paired seed')}."
    else:
        words = f"no difference can be shown ({_signed(found)}; {p_text(found.p_adjusted)})."
    return element("li", joined([*opening, words]))


def _others(contents: Contents, metric: Metric) -> Markup:
    """Who leads in a further metric, in one sentence a condition."""
    leaders = [_leaders(contents, condition, metric) for condition in contents.conditions]
    leaders = [each for each in leaders if each]
    if not leaders:
        return Markup()
    expected = f", nearest to {metric.expected:g}" if metric.expected is not None else ""
    opening = element("strong", capitalised(words_of(metric)) + expected)
    return element("p", opening, ": ", "; ".join(leaders), ".")


def _leads(contents: Contents, metric: Metric) -> Markup:
    """Under how many conditions each is shown to lead."""
    judged = [each for each in contents.conditions if len(contents.contenders(each, metric)) > 1]
    if not judged:
        return Markup()
    leaders = [alike(contents, condition, metric) for condition in judged]
    alone = Counter(tied[0] for tied in leaders if len(tied) == 1)
    words = [f"{name} under {count}" for name, count in alone.most_common()]
    num_open = len(judged) - alone.total()
    if num_open:
        words.append(f"under {num_open} nobody is shown to lead")
    expected = f", nearest to {metric.expected:g}" if metric.expected is not None else ""
    opening = element("strong", capitalised(words_of(metric)) + expected)
    told = f", first of {_counted(len(judged), 'condition')}: {'; '.join(words)}."
    return element("p", opening, told)


def _leaders(contents: Contents, condition: str, metric: Metric) -> str:
    """The best, with all from which it is not shown to differ, and the first behind them."""
    ranked = list(contents.contenders(condition, metric))
    if len(ranked) < 2:
        return ""
    tied = alike(contents, condition, metric)
    best = ranked[0]
    where = f"{condition}: " if len(contents.conditions) > 1 else ""
    value = _valued(best.median, best.unit)
    behind = next((each for each in ranked if each.estimator not in tied), None)
    if len(tied) == len(ranked):
        ends = span(best.median, ranked[-1].median)
        words = f"(medians {ends} {best.unit}".rstrip()
        return f"{where}between {_listed(tied)} no difference can be shown {words})"
    first = (
        f"{best.estimator}, {value}"
        if len(tied) == 1
        else f"{best.estimator}, {value}, from which {_listed(tied[1:])} cannot be told apart"
    )
    if behind is None:
        return where + first
    return f"{where}{first}; the next is {behind.estimator}, {_valued(behind.median, behind.unit)}"


def alike(contents: Contents, condition: str, metric: Metric) -> list[str]:
    """The best contender, and those that are not shown to differ from it, by their medians."""
    ranked = [each.estimator for each in contents.contenders(condition, metric)]
    found = {
        name: difference_of(contents, condition, metric.name, ranked[0], name)
        for name in ranked[1:]
    }
    return [
        name
        for name in ranked
        if (difference := found.get(name)) is None or winner(difference) is None
    ]


def _size(difference: Difference) -> str:
    """How large the median difference is, with its interval, without its sign."""
    ends = sorted((abs(difference.low), abs(difference.high)))
    value = _valued(abs(difference.median), difference.unit)
    if not np.isfinite(ends).all() or difference.low * difference.high < 0.0:
        return value
    return f"{value} ({span(*ends)})"


def _signed(difference: Difference) -> str:
    if not np.isfinite([difference.low, difference.high]).all():
        return f"median difference {_valued(difference.median, difference.unit)}"
    median, low, high = figure_texts(difference.median, difference.low, difference.high)
    return f"median difference {f'{median} {difference.unit}'.strip()}, {low} to {high}"


def _ratio(best: Summary, other: Summary) -> str:
    """How many times as much, where that says something."""
    if best.expected is not None or best.better is not Direction.LOWER or not best.median > 0.0:
        return ""
    ratio = other.median / best.median
    return f", {figure_text(ratio)} times as much" if ratio >= 1.2 else ""


def _superlative(metric: Metric) -> str:
    if metric.expected is not None:
        return f"most honest (nearest to {metric.expected:g})"
    return "highest" if metric.better is Direction.HIGHER else "lowest"


def _worse(better: Direction) -> str:
    return {Direction.LOWER: "more", Direction.HIGHER: "less"}.get(better, "further off")


def _better(better: Direction) -> str:
    return {Direction.LOWER: "less", Direction.HIGHER: "more"}.get(better, "nearer")


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" + "s" * (number != 1)


def _valued(value: float, unit: str) -> str:
    return f"{figure_text(value)} {unit}".strip()


def _code(name: str) -> Markup:
    return element("code", name)
