"""Two estimators on the same measurements, and who cannot be told apart."""

from evaluation.metrics import Metric
from evaluation.studies.comparison import MIN_FOR_INTERVAL, Difference, winner
from evaluation.study_report.contents import Contents, words_of
from evaluation.study_report.markup import Markup, joined
from evaluation.study_report.wording import code, p_text, signed, size_of


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
        return joined(["No seed has a ", words_of(metric), " of both ", code(one), " and ",
                       code(other), "."])  # fmt: skip
    won = winner(found)
    evidence = f"{found.n} paired seeds, {p_text(found.p_adjusted)} after Holm"
    if found.n < MIN_FOR_INTERVAL:
        evidence = f"only {found.n} paired seeds"
    if won is None:
        between = f" ({signed(found)}; {evidence})."
        return joined(
            ["Between ", code(one), " and ", code(other), " no difference in ", words_of(metric),
             " can be shown", between]
        )  # fmt: skip
    loser = found.second if won == found.first else found.first
    return joined(
        [code(won), " is better than ", code(loser), f" in {words_of(metric)} by ",
         f"{size_of(found)} ({evidence})."]
    )  # fmt: skip


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
