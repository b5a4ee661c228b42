"""The bench of reflectors: each figure is measured, a missing recording is refused."""

import math
from pathlib import Path

import pytest

from evaluation.benches.bench_reflectors import reflectors_car_park, reflectors_simulated
from semgraph.errors import InputError


def test_every_figure_is_measured() -> None:
    rows = reflectors_simulated([11, 12])
    assert len(rows) == 6
    assert all(math.isfinite(row.value) for row in rows)


def test_a_car_park_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not there"):
        reflectors_car_park(tmp_path)


@pytest.mark.shared_data
def test_the_car_park_reaches_its_figures(shared_data: Path) -> None:
    rows = reflectors_car_park(shared_data / "car_park")
    assert len(rows) == 2
    assert all(row.reached for row in rows)
