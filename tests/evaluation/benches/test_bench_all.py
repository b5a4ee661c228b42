"""All benchmarks in one table."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from evaluation.benches import bench_all
from evaluation.benches.bench import Section, chosen
from evaluation.benches.bench_all import PARTS, Part, all_sections
from evaluation.benches.bench_table import Better, Row
from semgraph.cli import main

_CHEAP = (
    Part("one", range(3, 5), 1.0, lambda _: (Section("a", (lambda seeds: _rows(seeds),), 2.0),)),
    Part("two", range(7, 8), 3.0, lambda _: (Section("b", (lambda seeds: _rows(seeds),), 9.0),)),
)


def test_every_section_names_its_part_and_has_its_seeds(tmp_path: Path) -> None:
    sections = all_sections(tmp_path)
    names = [each.name for each in sections]
    assert len(set(names)) == len(names)
    assert {name.partition(": ")[0] for name in names} == {part.name for part in PARTS}
    seeds = {part.name: part.seeds for part in PARTS}
    assert all(each.seeds == seeds[each.name.partition(": ")[0]] for each in sections)
    assert chosen(sections, ["studies"])[0].name == "studies: study paper"


def test_the_time_left_is_by_hours_of_the_parts(tmp_path: Path) -> None:
    for part in PARTS:
        its = [each for each in all_sections(tmp_path) if each.name.startswith(f"{part.name}: ")]
        hours = sum(each.work for each in its if not each.asked_only)
        assert hours == pytest.approx(part.hours)


@pytest.mark.parametrize("command", [["bench"], ["bench", "all"]])
def test_one_table_has_all_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bench_all, "PARTS", _CHEAP)
    assert main(command) == 0
    (table,) = (tmp_path / "results").glob("*/bench.md")
    assert table.read_text().count("| figure | value | target | reached |") == 2
    assert "## one: a, seeds 3 to 4 (" in table.read_text()
    lines = table.with_suffix(".csv").read_text().splitlines()
    assert [line.split(",")[-5] for line in lines[1:]] == ["7.0", "7.0"]


def _rows(seeds: Sequence[int]) -> list[Row]:
    return [Row("sum of the seeds", float(sum(seeds)), "", Better.LOWER, 5.0)]
