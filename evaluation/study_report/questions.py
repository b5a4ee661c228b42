"""What the study `paper` was made to answer."""

from typing import Final

import numpy as np

from evaluation.metrics import Metric
from evaluation.studies.comparison import ORACLE
from evaluation.study_report.closing import against_forgetting
from evaluation.study_report.contents import PATH_ERROR, Contents, words_of
from evaluation.study_report.markup import Markup, element, escaped, joined
from evaluation.study_report.paired import compared
from evaluation.study_report.paper_figures import FAST
from evaluation.study_report.scales import figure_text
from evaluation.study_report.wording import span
from semgraph.arrays import FloatArray

_SMOOTHED, _REFINED = "smoothed", "refined"
_DRIFT: Final = "trajectory_max_origin_m"
_PAPERS_DRIFT: Final = (
    "The paper saw up to 0.5 m on its course, corrected once it met its start again."
)


def answers(contents: Contents) -> list[Markup]:
    """The four questions under each condition; what cannot be answered is left out."""
    primary = contents.metrics.get(PATH_ERROR)
    if primary is None:
        return []
    asked = [
        condition
        for condition in contents.conditions
        if len(contents.values(condition, _SMOOTHED, PATH_ERROR))
    ]
    several = len(asked) > 1
    found = []
    for condition in asked:
        where = f" ({condition})" if several else ""
        for question, told in (
            ("How far does the fast estimator drift?", _drift(contents, condition)),
            ("What does the loop closure do?", _closure(contents, condition)),
            ("What does the graph add?", _graph(contents, condition, primary)),
            ("How near is the oracle?", _oracle(contents, condition, primary)),
        ):
            if told:
                paragraphs = [element("p", each) for each in told]
                heading = element("h3", question + where)
                found.append(element("div", heading, *paragraphs, class_="answer"))
    return found


def _drift(contents: Contents, condition: str) -> list[Markup]:
    """The largest error when only the first pose is laid onto the truth."""
    found = contents.values(condition, FAST, _DRIFT)
    if not len(found):
        return []
    middle, high, worst = (figure_text(float(each)) for each in np.quantile(found, (0.5, 0.9, 1.0)))
    told = (
        f"With its first pose laid onto the true one, {FAST} is at most {middle} m off in the "
        f"middle seed, {high} m in nine of ten, and {worst} m in the worst of {len(found)}. "
    )
    others = [
        f"{name} {_median(values)} m"
        for name in ("paper", "dead-reckoning", _SMOOTHED)
        if len(values := contents.values(condition, name, _DRIFT))
    ]
    beside = f" In the middle seed of others: {', '.join(others)}." if others else ""
    return [escaped(told + _PAPERS_DRIFT + beside)]


def _closure(contents: Contents, condition: str) -> list[Markup]:
    """The error before the end, and at the end; whether and how soon loops were closed."""
    told = []
    for estimator in (FAST, _SMOOTHED):
        largest_m, last_m = _peaks_and_ends(contents, condition, estimator)
        if len(last_m):
            share = float(np.mean(last_m < 0.5 * largest_m))
            told.append(
                f"The position's error of {estimator} is {_median(largest_m)} m at its largest and "
                f"{_median(last_m)} m at the end (medians after rigid alignment); in {share:.0%} "
                f"of the seeds it ends below half of the largest."
                + _returns(contents, condition, estimator)
            )
    return [*against_forgetting(contents, condition, FAST), *[escaped(each) for each in told]]


def _returns(contents: Contents, condition: str, estimator: str) -> str:
    """Whether and how soon a return to a place was noticed."""
    closed = contents.values(condition, estimator, "loops_closed")
    delays_s = contents.values(condition, estimator, "time_to_closure_s")
    if not len(closed):
        return ""
    soon = f", after {_median(delays_s)} s in the middle seed" if len(delays_s) else ""
    return f" It noticed {closed.mean():.0%} of the returns{soon}."


def _graph(contents: Contents, condition: str, primary: Metric) -> list[Markup]:
    """Fast against smoothed, and smoothed against refined, on the same seeds."""
    told = []
    for one, other in ((FAST, _SMOOTHED), (_SMOOTHED, _REFINED)):
        if {one, other} <= set(contents.estimators):
            told.append(compared(contents, condition, primary, one, other))
    landmarks = contents.metrics.get("map_rmse_m")
    if landmarks is not None and {FAST, _SMOOTHED} <= set(contents.estimators):
        told.append(compared(contents, condition, landmarks, FAST, _SMOOTHED))
    return told


def _oracle(contents: Contents, condition: str, primary: Metric) -> list[Markup]:
    """Ratios to the batch optimum with true associations."""
    found = [
        (each.estimator, each)
        for each in contents.ranked(condition, primary)
        if each.estimator != ORACLE and np.isfinite(each.oracle_ratio)
    ]
    if not found:
        return []
    shown = [
        f"{name} {figure_text(each.oracle_ratio)}"
        + (f" ({span(each.oracle_low, each.oracle_high)})" if np.isfinite(each.oracle_low) else "")
        for name, each in found
    ]
    return [
        joined(
            [f"Median {words_of(primary)} over that of the oracle, the batch optimum with true "
             f"associations, on the same seeds: {', '.join(shown)}."]
        )
    ]  # fmt: skip


def _median(values: FloatArray) -> str:
    return figure_text(float(np.median(values)))


def _peaks_and_ends(
    contents: Contents, condition: str, estimator: str
) -> tuple[FloatArray, FloatArray]:
    """(n,) the largest and the last error of the position of each seed."""
    series = [
        each.series.position_errors_m
        for each in contents.finished(condition, estimator)
        if each.series is not None and len(each.series.times_s)
    ]
    return np.array([one.max() for one in series]), np.array([one[-1] for one in series])
