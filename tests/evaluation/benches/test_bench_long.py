"""Costs of a long run, from a short one, and from costs known beforehand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.benches import bench_long
from evaluation.benches.bench_long import Costs, drive, rows
from semgraph.errors import InputError
from sensors.catalog import open_source

SHORT: dict[str, object] = {"length_m": 100.0, "scan_rate_hz": 5.0, "seed": 1}


def test_growth_memory_and_the_longest_calls_are_judged() -> None:
    n = 1000
    good = Costs(np.full(n, 1e-3), np.full(n, 0.2), np.zeros(n, dtype=np.bool_), 1900.0, 0.1)
    assert all(row.reached for row in rows(good))
    growing = replace(good, cpu_s=np.linspace(1e-3, 2e-3, n))
    slow = good.wall_s.copy()
    slow[500] = 1.0
    closing = np.arange(n) == 500
    lost = replace(good, path_rmse_m=5.0)
    heavy = replace(good, bytes_a_scan=3000.0)
    stalled = replace(good, wall_s=slow)
    for costs in (growing, lost, heavy, stalled):
        assert sum(not row.reached for row in rows(costs)) == 1
    assert all(row.reached for row in rows(replace(stalled, is_closing=closing)))
    assert not all(
        row.reached for row in rows(replace(stalled, wall_s=2.0 * slow, is_closing=closing))
    )


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")
def test_a_short_course_is_driven_and_told() -> None:
    told: list[float] = []
    costs = drive(open_source("course:lanes", SHORT), told.append)
    assert len(costs.cpu_s) == len(costs.wall_s) == 251
    assert (costs.cpu_s > 0.0).all()
    assert costs.is_closing.any()
    assert not costs.is_closing.all()
    assert costs.path_rmse_m < 0.2
    assert told == [0.0, pytest.approx(200 / 251)]


def test_a_system_that_does_not_tell_memory_is_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(bench_long, "_MEMORY", tmp_path / "none")
    with pytest.raises(InputError, match="Linux"):
        drive(open_source("course:lanes", SHORT), lambda _: None)
