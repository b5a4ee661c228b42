"""Figures in words: values with units, intervals, p, lists."""

from typing import Final

import numpy as np

from evaluation.studies.comparison import Difference, Summary
from evaluation.study_report.markup import Markup, element
from evaluation.study_report.scales import figure_text, figure_texts

_SMALLEST_P: Final = 0.001


def with_interval(summary: Summary) -> str:
    """The median with unit, interval and number of seeds."""
    value = valued(summary.median, summary.unit)
    seeds = counted(summary.n, "seed")
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


def size_of(difference: Difference) -> str:
    """How large the median difference is, with its interval, without its sign."""
    ends = sorted((abs(difference.low), abs(difference.high)))
    value = valued(abs(difference.median), difference.unit)
    if not np.isfinite(ends).all():
        return value
    return f"{value} ({span(*ends)})"


def signed(difference: Difference) -> str:
    """The median difference as it is, with its interval."""
    if not np.isfinite([difference.low, difference.high]).all():
        return f"median difference {valued(difference.median, difference.unit)}"
    median, low, high = figure_texts(difference.median, difference.low, difference.high)
    return f"median difference {f'{median} {difference.unit}'.strip()}, {low} to {high}"


def valued(value: float, unit: str) -> str:
    """A value with its unit."""
    return f"{figure_text(value)} {unit}".strip()


def listed(names: list[str]) -> str:
    """Names with commas and an and."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def counted(number: int, what: str) -> str:
    """A number of things."""
    return f"{number} {what}" + "s" * (number != 1)


def code(name: str) -> Markup:
    """A name as it is typed."""
    return element("code", name)
