"""The page as Chromium shows it; left out, with a word, where there is no Chromium."""

from dataclasses import replace
from pathlib import Path

import pytest

from evaluation.studies.trial import Outcome
from evaluation.study_report.page import page
from tests.evaluation.study_report import made
from tests.evaluation.study_report.browser import CHROMIUM, Tab, tab

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH")

_MOST_MS = 2000.0
_PHONE = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
_OPENED_MS = "performance.getEntriesByType('navigation')[0].loadEventEnd"
_OUTSIDE = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


def test_two_thousand_trials_open_at_once(tmp_path: Path) -> None:
    outcomes, text = made.two_thousand()
    path = tmp_path / "report.html"
    path.write_text(text, encoding="utf-8")
    url = path.as_uri()
    with tab(tmp_path / "profile") as shown:
        # The best of a few: other programs may hold up any one of them.
        assert min(_opened_ms(shown, url) for _ in range(3)) <= _MOST_MS
        for outcome in (outcomes[0], outcomes[-1]):
            _check_trial(shown, outcome)
        shown.value("location.hash = '#trials'")
        shown.until("document.getElementById('trial').hidden")
        assert not shown.complaints()
        assert set(shown.requests()) <= {url, "about:blank"}


def test_no_page_is_wider_than_a_phone(tmp_path: Path) -> None:
    outcomes = made.outcomes(8)
    url = _written(tmp_path, outcomes)
    with tab(tmp_path / "profile") as shown:
        shown.call("Emulation.setDeviceMetricsOverride", **_PHONE)
        shown.open(url)
        assert shown.value(_OUTSIDE) <= 0
        _check_trial(shown, outcomes[11])
        assert shown.value(_OUTSIDE) <= 0


def test_dark_is_dark_and_paper_is_white(tmp_path: Path) -> None:
    url = _written(tmp_path, made.outcomes(6))
    luminance = "getComputedStyle(document.body).backgroundColor"
    dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    with tab(tmp_path / "profile") as shown:
        shown.open(url)
        assert shown.value(luminance) == "rgb(255, 255, 255)"
        shown.call("Emulation.setEmulatedMedia", **dark)
        assert shown.value(luminance) == "rgb(20, 24, 30)"
        shown.call("Emulation.setEmulatedMedia", media="print", **dark)
        assert shown.value(luminance) == "rgb(255, 255, 255)"


def test_hostile_names_run_nothing(tmp_path: Path) -> None:
    hostile = "<img src=x onerror=\"document.title='run'\"><script>document.title='run'</script>"
    outcomes = tuple(
        replace(
            each,
            trial=replace(each.trial, condition=hostile, options=((hostile, hostile),)),
            reason=hostile if each.reason else "",
        )
        for each in made.outcomes(6, num_failed=1)
    )
    url = _written(tmp_path, outcomes)
    with tab(tmp_path / "profile") as shown:
        shown.open(url)
        _check_trial(shown, outcomes[0])
        _check_trial(shown, outcomes[12])
        shown.value("location.hash = '#trial-" + "%3Cimg src=x%3E'")
        shown.until("document.getElementById('trial').innerText.includes('no such trial')")
        assert shown.value("document.title") == "Study paper"
        assert shown.value("document.querySelectorAll('img').length") == 0
        assert not shown.complaints()


def _written(folder: Path, outcomes: tuple[Outcome, ...]) -> str:
    path = folder / "report.html"
    path.write_text(page(made.contents(outcomes)), encoding="utf-8")
    return path.as_uri()


def _opened_ms(shown: Tab, url: str) -> float:
    shown.events.clear()
    shown.open(url)
    shown.until(f"{_OPENED_MS} > 0")
    return float(shown.value(_OPENED_MS))


def _check_trial(shown: Tab, outcome: Outcome) -> None:
    """Its page tells who it is and, if it finished, draws map, errors and NEES."""
    trial = outcome.trial
    shown.value(f"location.hash = '#trial-{trial.id}'")
    heading = f"{trial.estimator}, "
    shown.until(
        "document.querySelector('#trial h2')?.textContent"
        f".startsWith({heading!r}) && document.querySelector('#trial code').textContent"
        f".includes({trial.id!r})"
    )
    assert shown.value("document.getElementById('study').hidden")
    num_charts = 4 if outcome.series is not None else 0
    assert shown.value("document.querySelectorAll('#trial svg').length") == num_charts
    if outcome.reason:
        assert outcome.reason in shown.value("document.getElementById('trial').innerText")
