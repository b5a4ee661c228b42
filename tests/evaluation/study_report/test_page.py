"""The page of a study: complete, small, safe, and readable without any script."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from evaluation.metrics import Metric
from evaluation.studies.trial import Drawing, Outcome, Series
from evaluation.study_report.page import page
from tests.evaluation.study_report import made

_MOST_BYTES = 5_000_000
_HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>\"'&\x00\ud800 </script>"


class _Elements(HTMLParser):
    """Every start tag with its attributes, and the words outside scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self._within: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag in ("script", "style", "title", "desc"):
            self._within.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if self._within and self._within[-1] == tag:
            self._within.pop()

    def handle_data(self, data: str) -> None:
        if not self._within:
            self.words += data

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]


@pytest.fixture(scope="module")
def text() -> str:
    return page(made.contents(made.outcomes(20, num_failed=3)))


def test_it_asks_for_nothing_outside_itself(text: str) -> None:
    elements = _Elements(text)
    policy = next(each for each in elements.all("meta") if "http-equiv" in each)["content"]
    assert policy is not None
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    for tag, attributes in elements.found:
        assert "src" not in attributes
        assert "style" not in attributes
        assert tag not in ("link", "iframe", "object", "img", "base", "form")
        assert (attributes.get("href") or "#").startswith("#")
    style = text.split("<style>")[1].split("</style>")[0]
    assert "url(" not in style
    assert "@import" not in style


def test_every_chart_says_in_words_what_is_to_be_seen(text: str) -> None:
    charts = [each for each in _Elements(text).all("svg") if each.get("role") == "img"]
    assert len(charts) >= 12
    for chart in charts:
        assert len(chart["aria-label"] or "") > 30
    others = [each for each in _Elements(text).all("svg") if each.get("role") != "img"]
    assert all(each["aria-hidden"] == "true" for each in others)


def test_tables_have_scopes_and_the_page_a_language(text: str) -> None:
    elements = _Elements(text)
    assert elements.all("html") == [{"lang": "en"}]
    assert all(each.get("scope") in ("col", "row") for each in elements.all("th"))
    assert len(elements.all("table")) == len(elements.all("caption")) > 3
    assert len(elements.all("h1")) == 1


def test_every_link_leads_somewhere(text: str) -> None:
    elements = _Elements(text)
    ids = {attributes["id"] for _, attributes in elements.found if "id" in attributes}
    data = json.loads(text.split('id="data">')[1].split("</script>")[0])
    trials = {f"trial-{each}" for pair in data["pairs"] for each in pair["ids"]}
    targets = {(each["href"] or "")[1:] for each in elements.all("a")}
    assert targets <= ids | trials
    assert trials <= targets


def test_figures_are_without_gaps_in_numbers(text: str) -> None:
    for path in re.findall(r' d="([^"]*)"', text):
        assert "nan" not in path
        assert "inf" not in path


def test_names_from_the_files_are_shown_and_never_run() -> None:
    outcomes = tuple(_renamed(each) for each in made.outcomes(7, num_failed=1))
    contents = replace(made.contents(outcomes), name=_HOSTILE, what=_HOSTILE, settings=_HOSTILE)
    text = page(contents)
    elements = _Elements(text)
    assert not elements.all("img")
    assert len(elements.all("script")) == 2
    assert not any(name.startswith("on") for _, each in elements.found for name in each)
    assert "<script>alert(1)</script>" in elements.words
    text.encode("utf-8")


def test_two_thousand_trials_stay_small() -> None:
    outcomes, text = made.two_thousand()
    assert len(outcomes) >= 2000
    assert len(text.encode()) <= _MOST_BYTES


def test_a_study_of_which_nothing_finished_has_a_page() -> None:
    outcomes = made.outcomes(1, num_failed=len(made.ESTIMATORS))
    words = _Elements(page(made.contents(outcomes))).words
    assert "Nothing was measured" in words
    assert words.count("took longer than 60 s") == len(outcomes)


@pytest.mark.parametrize("num_seeds", [1, 2, 6])
def test_few_seeds_have_a_page(num_seeds: int) -> None:
    text = page(made.contents(made.outcomes(num_seeds)))
    if num_seeds < 6:
        assert "too few for an interval" in text


def test_several_conditions_are_told_apart() -> None:
    text = page(
        made.contents(made.outcomes(6, ("calm", "clutter=1", "clutter=3"), study="clutter"))
    )
    elements = _Elements(text)
    assert "under each condition" in elements.words
    assert elements.words.count("clutter=3") >= 4


def test_an_outcome_without_drawing_or_series_has_a_page() -> None:
    bare = tuple(replace(each, series=None, drawing=None) for each in made.outcomes(7))
    assert "Spread of path error" in page(made.contents(bare))


def test_values_that_are_not_finite_are_left_out() -> None:
    outcomes = made.outcomes(7)
    first = outcomes[0]
    broken = tuple(replace(each, value=np.inf) for each in first.metrics)
    text = page(made.contents((replace(first, metrics=broken), *outcomes[1:])))
    assert "no value" in text


@pytest.mark.parametrize("value", [1e100, -1e100, 1e-320])
def test_the_largest_and_smallest_numbers_a_file_may_hold_have_a_page(value: float) -> None:
    outcomes = []
    for each in made.outcomes(2):
        assert each.series is not None
        assert each.drawing is not None
        times_s, points = each.series.times_s, np.full((5, 2), value)
        everywhere = np.full(len(times_s), value)
        outcomes.append(
            replace(
                each,
                metrics=tuple(replace(metric, value=value) for metric in each.metrics),
                series=Series(times_s, everywhere, everywhere, everywhere),
                drawing=Drawing(points, points, points, points),
            )
        )
    assert "<h1>" in page(made.contents(tuple(outcomes)))


def test_degrees_of_freedom_are_each_conditions_own() -> None:
    outcomes = made.outcomes(6, ("with headings", "without"))
    without = tuple(
        replace(each, metrics=tuple(_with_two_degrees(one) for one in each.metrics))
        for each in outcomes
        if each.trial.condition == "without"
    )
    text = page(made.contents((*outcomes[: len(without)], *without)))
    words = _Elements(text).words
    assert "nearest to 2 or 3" in words
    assert "NEES of the poses, expected 2" in words
    assert "NEES of the poses, expected 3" in words
    assert "Mean NEES, 2 is honest" in text
    assert "Mean NEES, 3 is honest" in text


def _with_two_degrees(metric: Metric) -> Metric:
    return metric if metric.expected is None else replace(metric, expected=2.0)


def _renamed(outcome: Outcome) -> Outcome:
    trial = replace(
        outcome.trial,
        condition=_HOSTILE,
        estimator=_HOSTILE + outcome.trial.estimator,
        source=_HOSTILE,
        options=((_HOSTILE, _HOSTILE),),
    )
    metrics = tuple(replace(each, unit=_HOSTILE) for each in outcome.metrics)
    return replace(
        outcome,
        trial=trial,
        metrics=metrics,
        reason=_HOSTILE if outcome.reason else "",
        versions=((_HOSTILE, _HOSTILE),),
    )
