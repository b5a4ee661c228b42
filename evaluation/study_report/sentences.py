"""What a study says, in sentences: what won, by how much, and where no difference can be shown."""

from collections import Counter
from typing import Final

from evaluation.metrics import Direction, Metric
from evaluation.studies.comparison import CONFIDENCE, MIN_FOR_INTERVAL, Summary, winner
from evaluation.studies.versions import mixed_versions
from evaluation.study_report.contents import (
    TOLD_MORE,
    Contents,
    capitalised,
    words_of,
)
from evaluation.study_report.markup import Markup, element, joined
from evaluation.study_report.paired import alike, difference_of
from evaluation.study_report.scales import figure_text
from evaluation.study_report.wording import (
    code,
    counted,
    listed,
    p_text,
    signed,
    size_of,
    span,
    valued,
    with_interval,
)

# From so many conditions on, each is told in a sentence or two.
_MANY: Final = 3


def summary(contents: Contents) -> list[Markup]:
    """Paragraphs: how much there is, what was best under each condition, what failed."""
    told = [element("p", joined(_extent(contents)))]
    primary = contents.primary
    if primary is None:
        return [*told, element("p", "Nothing was measured: no trial finished with a figure.")]
    is_short = len(contents.contests(primary)) >= _MANY
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
    where, name = element("strong", condition), words_of(metric)
    more = _told_more(contents, condition, metric)
    if not rest:
        words = f" has a median {name} of {with_interval(best)}."
        return [element("p", where, ": ", code(best.estimator), words), more]
    opening = [
        where,
        ": ",
        code(best.estimator),
        f" has the {_superlative(metric)} median {name}, ",
    ]
    lines = [_against(contents, best, each) for each in rest]
    return [
        element("p", *opening, with_interval(best), ". ", _in_short(contents, best, rest)),
        element("details", element("summary", "By how much"), element("ul", *lines), more)
        if is_short
        else joined([element("ul", *lines), more]),
    ]


def _extent(contents: Contents) -> list[str]:
    num_failed, num = len(contents.failed), len(contents.outcomes)
    seeds = len({each.trial.seed for each in contents.outcomes})
    parts = [
        f"{num} trials: {counted(len(contents.estimators), 'estimator')} under "
        f"{counted(len(contents.conditions), 'condition')} with {counted(seeds, 'seed')}. "
    ]
    if num < contents.num_planned:
        missing = f"The study is not finished: {contents.num_planned - num} trials have not run. "
        parts.append(element("strong", missing))
    mixed = mixed_versions(contents.outcomes)
    if mixed:
        words = f"The trials were measured with several versions of {'; of '.join(mixed)}. "
        parts += [element("strong", words), "Differences may be theirs. "]
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
        f"It is shown to be better than {listed(beaten)}; "
        f"from {listed(undecided)} no difference in its favour can be shown:"
    )


def _told_more(contents: Contents, condition: str, metric: Metric) -> Markup:
    """The medians of those that know more than the measurements, as what to compare with."""
    found = [
        f"{each.estimator} ({TOLD_MORE[each.estimator]}) {valued(each.median, each.unit)}"
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
        f"With {counted(most, 'seed')} and {len(family)} comparisons even the clearest difference "
        f"has p = {smallest:.2g} after Holm: to show any, there must be more seeds."
    )
    return element("p", words, class_="note")


def _against(contents: Contents, best: Summary, other: Summary) -> Markup:
    found = difference_of(contents, best.condition, best.metric, best.estimator, other.estimator)
    median = valued(other.median, other.unit)
    opening = [code(other.estimator), f": {median}, "]
    if found is None:
        return element("li", joined([*opening, "no seed in common."]))
    won = winner(found)
    if won == best.estimator:
        ratio = _ratio(best, other)
        words = f"{_worse(best.better)} by {size_of(found)}{ratio}; {p_text(found.p_adjusted)}."
    elif won == other.estimator:
        words = (
            f"yet on the same seeds {_better(best.better)} by {size_of(found)}; "
            f"{p_text(found.p_adjusted)}."
        )
    elif found.n < MIN_FOR_INTERVAL:
        words = f"no difference can be shown with {counted(found.n, 'paired seed')}."
    else:
        words = f"no difference can be shown ({signed(found)}; {p_text(found.p_adjusted)})."
    return element("li", joined([*opening, words]))


def _others(contents: Contents, metric: Metric) -> Markup:
    """Who leads in a further metric, in one sentence a condition."""
    leaders = [_leaders(contents, condition, metric) for condition in contents.conditions]
    leaders = [each for each in leaders if each]
    if not leaders:
        return Markup()
    opening = element("strong", capitalised(words_of(metric)) + contents.nearest_to(metric))
    return element("p", opening, ": ", "; ".join(leaders), ".")


def _leads(contents: Contents, metric: Metric) -> Markup:
    """Under how many conditions each is shown to lead."""
    judged = contents.contests(metric)
    if not judged:
        return Markup()
    leaders = [alike(contents, condition, metric) for condition in judged]
    alone = Counter(tied[0] for tied in leaders if len(tied) == 1)
    words = [f"{name} under {count}" for name, count in alone.most_common()]
    num_open = len(judged) - alone.total()
    if num_open:
        words.append(f"under {num_open} nobody is shown to lead")
    opening = element("strong", capitalised(words_of(metric)) + contents.nearest_to(metric))
    told = f", first of {counted(len(judged), 'condition')}: {'; '.join(words)}."
    return element("p", opening, told)


def _leaders(contents: Contents, condition: str, metric: Metric) -> str:
    """The best, with all from which it is not shown to differ, and the first behind them."""
    ranked = list(contents.contenders(condition, metric))
    if len(ranked) < 2:
        return ""
    tied = alike(contents, condition, metric)
    best = ranked[0]
    where = f"{condition}: " if len(contents.conditions) > 1 else ""
    value = valued(best.median, best.unit)
    behind = next((each for each in ranked if each.estimator not in tied), None)
    if len(tied) == len(ranked):
        medians = [each.median for each in ranked]
        ends = span(min(medians), max(medians))
        words = f"(medians {ends} {best.unit}".rstrip()
        return f"{where}between {listed(tied)} no difference can be shown {words})"
    first = (
        f"{best.estimator}, {value}"
        if len(tied) == 1
        else f"{best.estimator}, {value}, from which {listed(tied[1:])} cannot be told apart"
    )
    if behind is None:
        return where + first
    return f"{where}{first}; the next is {behind.estimator}, {valued(behind.median, behind.unit)}"


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
