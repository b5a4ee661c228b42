"""Figures beside their targets: as rows, in sections, printed and written."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Final

from semgraph.files.tables import write_text

if TYPE_CHECKING:
    from rich.console import Console

_COLUMNS: Final = ("section", "name", "value", "better", "target", "unit", "reached")


class Better(Enum):
    """On which side of its target a figure should lie."""

    HIGHER = ">="
    LOWER = "<="


@dataclass(frozen=True, slots=True)
class Row:
    """A figure with its target; NaN reaches none."""

    name: str
    value: float
    unit: str
    better: Better
    target: float

    @property
    def reached(self) -> bool:
        """Whether the figure is at least as good as its target."""
        return (
            self.value >= self.target if self.better is Better.HIGHER else self.value <= self.target
        )

    @property
    def verdict(self) -> str:
        """Reached or missed."""
        return "reached" if self.reached else "missed"

    def texts(self) -> tuple[str, str, str, str]:
        """Name, value, target and verdict as a reader wants them."""
        return (
            self.name,
            f"{self.value:.3g} {self.unit}".strip(),
            f"{self.better.value} {self.target:g} {self.unit}".strip(),
            self.verdict,
        )


@dataclass(frozen=True, slots=True)
class SectionRows:
    """What one section of a bench gave.

    Attributes:
        seconds: how long it took.
        left_out: why there are no figures; empty where there are.
    """

    name: str
    rows: tuple[Row, ...]
    seconds: float
    left_out: str = ""

    @property
    def heading(self) -> str:
        """The name, and how long it took or why it was left out."""
        what = f"left out: {self.left_out}" if self.left_out else f"{self.seconds:.0f} s"
        return f"{self.name} ({what})"


def summary(sections: Sequence[SectionRows]) -> str:
    """How many figures are reached, in a line."""
    rows = [row for section in sections for row in section.rows]
    reached = sum(row.reached for row in rows)
    left_out = sum(bool(section.left_out) for section in sections)
    tail = f"; {left_out} of {len(sections)} sections left out" if left_out else ""
    return f"{reached} of {len(rows)} figures reached, {len(rows) - reached} missed{tail}"


def print_table(console: "Console", sections: Sequence[SectionRows]) -> None:
    """One line a figure: name, value, target, whether it is reached."""
    from rich.table import Table
    from rich.text import Text

    table = Table("figure", "value", "target", "reached")
    for section in sections:
        table.add_section()
        table.add_row(Text(section.heading, style="bold"))
        for row in section.rows:
            table.add_row(*map(Text, row.texts()))
    console.print(table)
    console.print(summary(sections))


def write_csv(sections: Sequence[SectionRows], path: Path) -> None:
    """One line a figure, unrounded.

    Raises:
        SemgraphError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for section in sections:
        for row in section.rows:
            better = row.better.value
            values = (row.name, repr(row.value), better, repr(row.target), row.unit, row.verdict)
            writer.writerow((section.name, *values))
    write_text(path, text.getvalue())


def write_markdown(sections: Sequence[SectionRows], title: str, path: Path) -> None:
    """A table under each section's heading.

    Raises:
        SemgraphError: the file cannot be written.
    """
    lines = [f"# {title}", "", f"{summary(sections)}."]
    for section in sections:
        lines += ["", f"## {section.heading}"]
        if section.rows:
            lines += ["", "| figure | value | target | reached |", "|---|---|---|---|"]
        for row in section.rows:
            lines.append("| " + " | ".join(text.replace("|", "\\|") for text in row.texts()) + " |")
    write_text(path, "\n".join(lines) + "\n")
