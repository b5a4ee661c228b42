"""A study run, in a folder from which it goes on wherever it was interrupted."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, closing
from pathlib import Path
from typing import Final

from evaluation.studies.execution import Execution, outcome_lines
from evaluation.studies.store import STUDY_TOML, TRIALS_JSONL, Store, opened_store, read_outcomes
from evaluation.studies.study_file import Plan, Study, plan_study, read_study, study_text
from evaluation.studies.trial import Outcome, Status, Trial
from evaluation.studies.trial_tables import write_files, write_tables
from evaluation.studies.versions import mixed_versions
from semgraph.errors import InputError, SemgraphError
from semgraph.progress import Report

_ONE_VERSION: Final = "for figures of one alone run the study in another --output"

Told = Callable[[str], None]
Watch = Callable[[int], AbstractContextManager[Report]]


def run_study(
    plan: Plan, folder: Path, how: Execution, watch: Watch, tell: Told, *, retry: bool = False
) -> tuple[Outcome, ...]:
    """The outcomes of all trials of a plan; those that the folder has are not run again.

    Args:
        plan: all that the folder has must be in it.
        folder: new, or of an earlier run of this study.
        how: where trials run.
        watch: given the number of trials to run, who hears how many are done.
        tell: hears what a user should know, a line each.
        retry: run those again that did not finish.

    Raises:
        InputError: the folder is another study's, or its outcomes are damaged.
        SemgraphError: it cannot be written, another process does, or there is no cluster.
    """
    with opened_store(folder) as store:
        for note in store.notes:
            tell(note)
        _claim(store, plan)
        waiting = [trial for trial in plan.trials if _is_wanted(store, trial, retry=retry)]
        kept = len(plan.trials) - len(waiting)
        if kept:
            tell(f"{kept} of {len(plan.trials)} trials are there already")
        if waiting:
            with watch(len(waiting)) as report:
                _run(store, waiting, how, report)
        outcomes = _in_order(store.outcomes, plan.trials)
        write_tables(folder, outcomes)
    for mixed in mixed_versions(outcomes):
        tell(f"trials were measured with several versions of {mixed}; {_ONE_VERSION}")
    return outcomes


def read_run(folder: Path) -> tuple[Study, tuple[Outcome, ...]]:
    """The study of a folder and its outcomes so far, in the order of its trials.

    Raises:
        InputError: the folder has none, or they are damaged.
    """
    path = folder / STUDY_TOML
    if not path.is_file():
        raise InputError(f"{folder}: expected the folder of a study, it has no {STUDY_TOML}")
    study = read_study(str(path))
    outcomes = {each.trial.id: each for each in read_outcomes(folder)}
    return study, _in_order(outcomes, plan_study(study, folder).trials)


def endings(outcomes: Iterable[Outcome]) -> Mapping[Status, int]:
    """How many trials ended how."""
    return Counter(each.status for each in outcomes)


def _claim(store: Store, plan: Plan) -> None:
    """The folder is this plan's.

    Raises:
        InputError: it has trials that are not in the plan.
    """
    planned = {trial.id for trial in plan.trials}
    others = [each.trial for key, each in store.outcomes.items() if key not in planned]
    if others:
        raise InputError(
            f"{store.folder / TRIALS_JSONL}: holds {len(others)} trials that this study does not "
            f"have, the first with {others[0].condition!r}, {others[0].estimator} and seed "
            f"{others[0].seed}; choose another --output"
        )
    text = study_text(plan.study)
    write_files(store.folder, {STUDY_TOML: lambda path: _write(path, text)})


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _is_wanted(store: Store, trial: Trial, *, retry: bool) -> bool:
    outcome = store.outcomes.get(trial.id)
    return outcome is None or (retry and outcome.status is not Status.FINISHED)


def _run(store: Store, waiting: list[Trial], how: Execution, report: Report) -> None:
    with closing(outcome_lines(waiting, how)) as lines:
        for done, line in enumerate(lines, start=1):
            _append(store, line)
            report.done(done)


def _append(store: Store, line: bytes) -> None:
    try:
        store.append(line)
    except InputError as error:
        raise SemgraphError(
            f"a worker sent what is no outcome ({error}); is its version of semgraph the same?"
        ) from error


def _in_order(outcomes: Mapping[str, Outcome], trials: Iterable[Trial]) -> tuple[Outcome, ...]:
    return tuple(outcomes[trial.id] for trial in trials if trial.id in outcomes)
