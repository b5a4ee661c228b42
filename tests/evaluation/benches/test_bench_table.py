"""Rows are judged, printed and written."""

import csv
import math
from pathlib import Path

import pytest
from rich.console import Console

from evaluation.benches.bench_table import (
    Better,
    Row,
    SectionRows,
    print_table,
    summary,
    write_csv,
    write_markdown,
)

SECTIONS = (
    SectionRows(
        "trees",
        (
            Row("recall [0.25 deg]", 0.93, "", Better.HIGHER, 0.92),
            Row("centre, a|b", 36.0 / 7.0, "mm", Better.LOWER, 5.0),
        ),
        12.4,
    ),
    SectionRows("car park", (), 0.0, "no data"),
)


@pytest.mark.parametrize(
    ("value", "better", "reached"),
    [
        (0.9, Better.HIGHER, True),
        (0.89, Better.HIGHER, False),
        (0.9, Better.LOWER, True),
        (0.91, Better.LOWER, False),
        (math.nan, Better.HIGHER, False),
        (math.nan, Better.LOWER, False),
    ],
)
def test_targets(value: float, better: Better, *, reached: bool) -> None:
    row = Row("figure", value, "", better, 0.9)
    assert row.reached is reached
    assert row.verdict == ("reached" if reached else "missed")


def test_the_table_names_what_is_missed_and_what_is_left_out() -> None:
    console = Console(width=120, record=True, quiet=False)
    print_table(console, SECTIONS)
    printed = console.export_text()
    assert "recall [0.25 deg]" in printed
    assert "missed" in printed
    assert "left out: no data" in printed
    assert summary(SECTIONS) == ("1 of 2 figures reached, 1 missed; 1 of 2 sections left out")
    assert summary(SECTIONS) in printed


def test_written_figures_are_read_again_unrounded(tmp_path: Path) -> None:
    write_csv(SECTIONS, tmp_path / "figures.csv")
    with (tmp_path / "figures.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["recall [0.25 deg]", "centre, a|b"]
    assert [float(row["value"]) for row in rows] == [0.93, 36.0 / 7.0]
    assert [row["reached"] for row in rows] == ["reached", "missed"]
    assert rows[1]["section"] == "trees"
    assert (rows[1]["better"], rows[1]["target"], rows[1]["unit"]) == ("<=", "5.0", "mm")


def test_markdown_has_a_table_for_each_section(tmp_path: Path) -> None:
    write_markdown(SECTIONS, "Title", tmp_path / "figures.md")
    text = (tmp_path / "figures.md").read_text()
    assert text.startswith("# Title\n\n1 of 2 figures reached")
    assert "| recall [0.25 deg] | 0.93 | >= 0.92 | reached |" in text
    assert "centre, a\\|b" in text
    assert "## car park (left out: no data)" in text
