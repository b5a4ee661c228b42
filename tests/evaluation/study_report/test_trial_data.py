"""What the page's script reads: true to the outcomes, and thinned where there are many."""

import base64
import json
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from evaluation.study_report.time_figures import nees_over_time
from evaluation.study_report.trial_data import trial_data
from semgraph.arrays import FloatArray
from tests.evaluation.study_report import made


def test_values_come_back_to_a_thousandth_of_their_extent() -> None:
    contents = made.contents(made.outcomes(2))
    data = json.loads(trial_data(contents, 1_000_000))
    for pair, start in zip(data["pairs"], (0, len(made.ESTIMATORS)), strict=True):
        block = _block(pair)
        outcomes = contents.outcomes[start : start + len(made.ESTIMATORS)]
        assert pair["ids"] == [each.trial.id for each in outcomes]
        for told, outcome in zip(block["trials"], outcomes, strict=True):
            assert outcome.series is not None
            assert outcome.drawing is not None
            _check(told["series"]["p"], outcome.series.position_errors_m)
            _check(told["series"]["n"], np.log10(outcome.series.nees))
            _check(told["path"][0], outcome.drawing.estimated_path[:, 0])
        assert outcome.drawing is not None
        _check(block["truth"]["landmarks"][1], outcome.drawing.true_landmarks[:, 1])


def test_where_there_are_many_no_peak_is_lost() -> None:
    contents = made.contents(made.outcomes(2))
    whole = json.loads(trial_data(contents, 1_000_000))
    thinned = json.loads(trial_data(contents, 10_000))
    assert sum(len(pair["data"]) for pair in thinned["pairs"]) < 0.6 * sum(
        len(pair["data"]) for pair in whole["pairs"]
    )
    series = contents.outcomes[2].series
    assert series is not None
    told = _values(_block(thinned["pairs"][0])["trials"][2]["series"]["p"])
    assert len(told) < len(series.times_s) / 4
    assert max(told) == pytest.approx(series.position_errors_m.max(), rel=2e-3)


def test_thinned_nees_are_those_of_samples_not_the_largest() -> None:
    contents = made.contents(made.outcomes(2))
    thinned = json.loads(trial_data(contents, 10_000))
    series = contents.outcomes[2].series
    assert series is not None
    told = _values(_block(thinned["pairs"][0])["trials"][2]["series"]["n"])
    stride = len(series.nees) // len(told)
    assert told == pytest.approx(np.log10(series.nees[stride - 1 :: stride]), abs=0.01)


def test_a_first_pose_without_error_leaves_the_axis_to_the_others() -> None:
    outcomes = made.outcomes(2)
    exact = []
    for each in outcomes:
        assert each.series is not None
        nees = each.series.nees.copy()
        nees[0] = 1e-40
        exact.append(replace(each, series=replace(each.series, nees=nees)))
    contents = made.contents(tuple(exact))
    block = _block(json.loads(trial_data(contents, 1_000_000))["pairs"][0])
    assert _values(block["trials"][2]["series"]["n"]).min() == pytest.approx(-2.0)
    assert "e\N{MINUS SIGN}" not in str(nees_over_time(contents, contents.conditions[0]))


def test_units_and_directions_are_told() -> None:
    data = json.loads(trial_data(made.contents(made.outcomes(2)), 1_000_000))
    told = {name: (unit, better) for name, unit, better in data["metrics"]}
    assert told["path error (ATE RMSE)"] == ("m", "lower")
    assert told["NEES of the poses"] == ("", "nearest to 3")


def _block(pair: dict[str, Any]) -> dict[str, Any]:
    return dict(json.loads(zlib.decompress(base64.b64decode(pair["data"]))))


def _values(steps: list[Any]) -> FloatArray:
    """As the script reads them."""
    if not steps:
        return np.empty(0)
    low, step, *differences = steps
    known = np.cumsum([each or 0 for each in differences])
    return np.where([each is None for each in differences], np.nan, low + step * known)


def _check(steps: list[Any], values: FloatArray) -> None:
    if not np.isfinite(values).any():
        assert steps == []
        return
    extent = float(np.nanmax(values) - np.nanmin(values))
    np.testing.assert_allclose(_values(steps), values, atol=1.1e-3 * extent, rtol=1e-4)
