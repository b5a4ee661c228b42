"""What `semgraph report` does."""

import argparse
from pathlib import Path

from semgraph.command_line.argument_types import AddParser


def add_report(add_parser: AddParser) -> None:
    """The command and its argument."""
    report = add_parser("report", help="make the page of a study again, from its files")
    report.add_argument("folder", type=Path, metavar="DIR", help="the results of a study")


def call_report(parsed: argparse.Namespace) -> None:
    """Writes the page and says where it is.

    Raises:
        SemgraphError: the folder is not a study's, its files are damaged, or it cannot be written.
    """
    from evaluation.study_report.report import write_report
    from semgraph.command_line.terminal import terminal

    console = terminal()
    with console.status(f"writing the report of {parsed.folder}"):
        path = write_report(parsed.folder)
    console.print(f"written: {path}, look at it in a browser")
