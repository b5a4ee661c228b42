"""What commands print is what they were told."""

import io

import pytest
from rich.console import Console
from rich.table import Table

from semgraph.command_line.terminal import terminal
from semgraph.progress import progress

NAME = "course:eight: [bold]a[/x]"


def test_names_are_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table("name")
    table.add_row(NAME)
    terminal().print(NAME)
    terminal().print(table)
    assert capsys.readouterr().out.count(NAME) == 2


def test_so_are_they_beside_a_bar() -> None:
    screen = Console(file=io.StringIO(), force_terminal=True, width=120, color_system=None)
    with progress(screen, NAME, 10) as report:
        report.done(5)
        screen.print("between")
    assert isinstance(screen.file, io.StringIO)
    assert NAME in screen.file.getvalue()
