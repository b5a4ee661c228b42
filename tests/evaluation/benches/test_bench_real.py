"""Figures over real recordings: left out where these are not, and judged where they are."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import pytest

from evaluation.benches import bench_real
from evaluation.benches.bench import Section, chosen, measure
from semgraph.progress import Silence

Metrics = dict[str, float]


def section(data: Path, name: str) -> Section:
    (found,) = chosen(bench_real.sections(data), [f"real: {name}"])
    return found


def plant(monkeypatch: pytest.MonkeyPatch, outcome: Callable[[object], object]) -> None:
    def each(trial: object, cases: Sequence[object]) -> list[object]:
        return [outcome(case) for case in cases]

    monkeypatch.setattr(bench_real, "each_seed", each)


@pytest.mark.parametrize("name", ["car park", "Victoria Park", "MRCLAM", "Wild"])
def test_without_its_folder_a_section_is_left_out(tmp_path: Path, name: str) -> None:
    missing = chosen(bench_real.sections(tmp_path), [f"real: {name}"])
    (measured,) = measure([missing[0]], [1], Silence())
    assert measured.rows == ()
    assert str(tmp_path) in measured.left_out


def test_robots_are_judged_each_by_its_own_limit(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[object] = []

    def outcome(case: object) -> Metrics:
        asked.append(case)
        return {"trajectory_rmse_m": 0.12}

    plant(monkeypatch, outcome)
    rows = section(tmp_path, "MRCLAM").figures[0]([1])
    assert [row.reached for row in rows] == [False, False, False, True, True]
    place = str(tmp_path / "mrclam6")
    assert asked == [(place, {"robot": k, "identities": False}) for k in range(1, 6)]


def test_a_graph_with_too_many_or_few_landmarks_misses(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    verdicts = {}
    for count in (147, 151, 155):
        plant(monkeypatch, partial(beside_the_known, count))
        rows = section(tmp_path, "Victoria Park's graph").figures[0]([1])
        verdicts[count] = [row.reached for row in rows]
    assert verdicts == {147: [True, False, True], 151: [True] * 3, 155: [True, True, False]}


def beside_the_known(count: int, _: object) -> tuple[float, int]:
    return 0.05, count


def test_a_metric_that_a_run_does_not_have_is_missed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plant(monkeypatch, lambda _: {"landmarks_found": 15.0, "landmarks_false": 0.0})
    rows = section(tmp_path, "car park").figures[0]([1])
    assert [row.reached for row in rows] == [False, False, True, True]


@pytest.mark.shared_data
def test_the_car_park_is_run_and_judged(shared_data: Path) -> None:
    (measured,) = measure([section(shared_data, "car park")], [1], Silence())
    assert measured.left_out == ""
    values = {row.name: row.value for row in measured.rows}
    assert values["beacons found of 15"] == 15.0
    assert values["path, RMSE"] < 0.1
