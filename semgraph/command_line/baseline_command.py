"""What `semgraph baseline` does."""

import argparse
import os
from pathlib import Path

from semgraph.command_line.argument_types import AddParser, num_workers


def add_baseline(add_parser: AddParser) -> None:
    """The command and its arguments."""
    baseline = add_parser(
        "baseline", help="run a small fixed study; fails where a figure is worse than it was"
    )
    baseline.add_argument(
        "--update", action="store_true", help="keep what is better or new as the baseline"
    )
    baseline.add_argument(
        "--worse-too", action="store_true", help="with --update: keep what is worse or missing too"
    )
    baseline.add_argument(
        "--file", type=Path, metavar="FILE", help="of figures (default: evaluation/baseline.json)"
    )
    baseline.add_argument(
        "--workers", type=num_workers, metavar="N", help="processes (default: the machine's cores)"
    )


def call_baseline(parsed: argparse.Namespace) -> None:
    """Runs the study, prints what is not as before.

    Raises:
        SemgraphError: a figure is worse, missing, not a number, or its trial crashed; the file of
            figures is damaged or cannot be written.
    """
    from semgraph.one_thread import use_one_thread

    use_one_thread()
    from evaluation.regression import (
        BASELINE_JSON,
        baseline_trials,
        failures,
        held_against,
        measured_figures,
        told,
        update,
    )
    from evaluation.studies.execution import Execution
    from semgraph.command_line.terminal import terminal
    from semgraph.errors import InputError, SemgraphError
    from semgraph.progress import progress

    if parsed.worse_too and not parsed.update:
        raise InputError("--worse-too: expected --update with it")
    console, path = terminal(), parsed.file or BASELINE_JSON
    trials = baseline_trials()
    how = Execution(os.cpu_count() or 1 if parsed.workers is None else parsed.workers)
    with progress(console, "baseline", len(trials), "trials") as report:
        now = measured_figures(trials, how, report)
    if parsed.update:
        verdicts = update(path, now, worse_too=parsed.worse_too)
    else:
        verdicts = held_against(path, now)
    for line in told(verdicts):
        console.print(line, highlight=False)
    failed = () if parsed.worse_too else failures(verdicts)
    if failed:
        raise SemgraphError(f"{len(failed)} figures are not as good as in {path}, see above")
