"""The bench of markers: each figure is measured, seeds repeat, a missing recording is said."""

import math
from pathlib import Path

import numpy as np
import pytest

from evaluation.bench_markers import marker_outcomes, optical_markers
from evaluation.bench_reflectors import reflectors_car_park


def test_every_figure_of_optical_markers_is_measured_and_reached() -> None:
    rows = optical_markers([31])
    assert {row.name.split(" px ")[0] for row in rows} == {"AprilTag >= 25", "AprilTag >= 50"}
    assert all(math.isfinite(row.value) for row in rows)
    figures = [row for row in rows if "range" in row.name or "bearing" in row.name]
    assert len(figures) == 4
    assert all(row.reached for row in figures)


def test_outcomes_repeat_and_differ_by_seed() -> None:
    first, again, other = (marker_outcomes([seed], (60.0, 80.0), 4) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.range_shares, again.range_shares)
    assert first.detected.all()
    assert not np.array_equal(first.bearings, other.bearings)


def test_a_car_park_that_is_not_there_is_said_and_not_reached(tmp_path: Path) -> None:
    rows = reflectors_car_park(tmp_path)
    assert [row.reached for row in rows] == [False]
    assert "left out" in rows[0].name


@pytest.mark.shared_data
def test_the_car_park_reaches_its_figures(shared_data: Path) -> None:
    rows = reflectors_car_park(shared_data / "car_park")
    assert len(rows) == 2
    assert all(row.reached for row in rows)
