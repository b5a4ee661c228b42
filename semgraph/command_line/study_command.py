"""What `semgraph study` does."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.studies.checks import check_trials
from evaluation.studies.comparison import Summary, summaries
from evaluation.studies.execution import Execution, run_alone
from evaluation.studies.outcome_lines import parse_outcome
from evaluation.studies.running import endings, run_study
from evaluation.studies.study_file import Plan, plan_study, read_study
from evaluation.studies.trial import Outcome, Status, Trial
from evaluation.studies.trial_process import measure_named
from evaluation.study_report.report import write_report
from semgraph.command_line.terminal import terminal
from semgraph.errors import InputError
from semgraph.progress import progress

RESULTS: Final = Path("results")
_MAX_TOLD: Final = 10
# Of a table that a terminal has room for; the report has all.
_COLUMNS: Final = {
    "trajectory_rmse_m": "path, m",
    "map_rmse_m": "map, m",
    "nees_mean": "NEES",
    "cpu_s": "CPU, s",
}


@dataclass(frozen=True, slots=True)
class StudyRequest:
    """What the command line asks for.

    Attributes:
        place: a study's file or name.
        output: its folder; None for `results/study-NAME`.
        seeds: instead of the study's.
        data: the folder of the recordings.
        retry_failed: run those trials again that did not finish.
        trial: the id of the only one to run, or how it begins; nothing is written then.
        how: where trials run.
    """

    place: str
    output: Path | None
    seeds: range | None
    data: Path
    retry_failed: bool
    trial: str | None
    how: Execution


def study(request: StudyRequest) -> None:
    """Runs a study, or what is left of it, writes and prints what came out.

    Raises:
        SemgraphError: anything that a user can put right.
    """
    console = terminal()
    plan = plan_study(read_study(request.place), request.data, request.seeds)
    check_trials(plan.trials)
    if request.trial is not None:
        _run_one(console, plan, request.trial, request.how)
        return
    for reason in plan.left_out:
        console.print(reason)
    folder = request.output or RESULTS / f"study-{plan.study.name}"
    watch = partial(progress, console, plan.study.name, unit="trials")
    outcomes = run_study(
        plan, folder, request.how, watch, console.print, retry=request.retry_failed
    )
    _print_failures(console, outcomes, request)
    with console.status("comparing"):
        found = summaries(outcomes, np.random.default_rng(0))
    _print_summaries(console, found)
    with console.status("writing the report"):
        page = write_report(folder)
    console.print(f"written: {folder}, look at {page}")


def _run_one(console: Console, plan: Plan, wanted: str, how: Execution) -> None:
    """One trial by its id, in this very process with `--workers 0`, so that a debugger sees it."""
    (trial,) = _named(plan.trials, wanted)
    console.print(f"{trial.estimator} on {trial.condition}, seed {trial.seed}")
    if how.workers == 0:
        outcome = measure_named(how.measure)(trial)
    else:
        outcome = parse_outcome(run_alone(trial, how))
    console.print(f"{outcome.status.value} in {outcome.wall_s:.1f} s {outcome.reason}".rstrip())
    for metric in outcome.metrics:
        console.print(f"{metric.name} {metric.value:.6g} {metric.unit}".rstrip())


def _named(trials: Sequence[Trial], wanted: str) -> list[Trial]:
    found = [trial for trial in trials if wanted and trial.id.startswith(wanted)]
    if len(found) != 1:
        raise InputError(
            f"--trial {wanted}: expected how the id of one trial of the study begins, as in "
            f"trials.csv; {len(found)} begin so"
        )
    return found


def _print_failures(console: Console, outcomes: Sequence[Outcome], request: StudyRequest) -> None:
    failed = [each for each in outcomes if each.status is not Status.FINISHED]
    numbers = ", ".join(f"{number} {status.value}" for status, number in endings(outcomes).items())
    console.print(f"{len(outcomes)} trials: {numbers}")
    for each in failed[:_MAX_TOLD]:
        trial = each.trial
        console.print(
            f"{each.status.value}: {trial.estimator} on {trial.condition}, seed {trial.seed}: "
            f"{each.reason}; alone: semgraph study {request.place} --trial {trial.id}"
        )
    if len(failed) > _MAX_TOLD:
        console.print(f"and {len(failed) - _MAX_TOLD} more, in trials.csv")


def _print_summaries(console: Console, found: Sequence[Summary]) -> None:
    """Medians with their intervals, a table a condition."""
    for condition in dict.fromkeys(each.condition for each in found):
        its = {(each.estimator, each.metric): each for each in found if each.condition == condition}
        table = Table(title=condition)
        for name in ("estimator", "trials", "failed", *_COLUMNS.values()):
            table.add_column(name)
        for estimator in dict.fromkeys(estimator for estimator, _ in its):
            table.add_row(estimator, *_cells(estimator, its))
        console.print(table)


def _cells(estimator: str, its: dict[tuple[str, str], Summary]) -> list[str]:
    any_of = next(each for (name, _), each in its.items() if name == estimator)
    total = any_of.n + any_of.failures + any_of.absent
    metrics = [its.get((estimator, metric)) for metric in _COLUMNS]
    return [str(total), str(any_of.failures), *map(_interval, metrics)]


def _interval(summary: Summary | None) -> str:
    if summary is None or not summary.n:
        return "-"
    interval = "" if np.isnan(summary.low) else f" ({summary.low:.3g} to {summary.high:.3g})"
    return f"{summary.median:.3g}{interval}"
