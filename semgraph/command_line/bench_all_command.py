"""What `semgraph bench` and `semgraph bench all` do."""

import argparse
from pathlib import Path

from semgraph.command_line.argument_types import DATA, AddParser, seeds


def add_bench_all(add_parser: AddParser) -> None:
    """The command and its arguments."""
    every = add_parser("all", help="all of these in one table; so does semgraph bench alone")
    every.add_argument(
        "--seeds", type=seeds, metavar="A-B", help="instead of each benchmark's own (some hours)"
    )
    every.add_argument("--data", type=Path, metavar="DIR", help=f"recordings (default: {DATA})")
    every.add_argument(
        "--only",
        action="append",
        metavar="NAME",
        help="sections that begin with this, as in `studies` or `graph: paper`; may be repeated",
    )
    every.add_argument(
        "--output", type=Path, metavar="DIR", help="where to write (default: results/<time>)"
    )


def call_bench_all(parsed: argparse.Namespace) -> None:
    """Measures every benchmark, prints and writes `bench.md` and `bench.csv`.

    Raises:
        InputError: no section begins with a name of `--only`.
        SemgraphError: the folder cannot be written, or holds something else.
    """
    from datetime import datetime

    from evaluation.benches.bench import bench, chosen
    from evaluation.benches.bench_all import all_sections
    from semgraph.command_line.commands import RESULTS
    from semgraph.command_line.terminal import terminal
    from semgraph.files import staging

    # Without `all` there are no arguments of its own.
    given = {**dict.fromkeys(("seeds", "data", "only", "output")), **vars(parsed)}
    sections = all_sections(given["data"] or DATA, given["seeds"])
    folder = given["output"] or staging.new_results_folder(RESULTS, datetime.now().astimezone())
    console = terminal()
    bench(console, "bench", chosen(sections, given["only"] or []), None, folder)
    console.print(f"written: {folder}")
