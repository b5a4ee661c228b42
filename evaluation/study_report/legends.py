"""Which line is whose, and what is put around a chart."""

from dataclasses import dataclass

from evaluation.study_report.contents import (
    Contents,
)
from evaluation.study_report.markup import Markup, element


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
