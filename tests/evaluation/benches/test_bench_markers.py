"""The bench of optical markers: each figure is measured, seeds repeat."""

import math

import numpy as np

from evaluation.benches.bench_markers import marker_outcomes, optical_markers


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
