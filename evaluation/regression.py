"""The regression gate: a small fixed study run and held against `baseline.json`."""

from collections.abc import Sequence
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from typing import Final

from evaluation.baseline import (
    Figure,
    Judged,
    Verdict,
    figures_of,
    judged,
    read_baseline,
    updated,
    write_baseline,
)
from evaluation.studies.execution import Execution, outcome_lines
from evaluation.studies.outcome_lines import parse_outcome
from evaluation.studies.study_file import plan_study, read_study
from evaluation.studies.trial import Outcome, Trial
from semgraph.errors import SemgraphError
from semgraph.progress import Report

_HERE: Final = Path(str(files("evaluation")))
BASELINE_JSON: Final = _HERE / "baseline.json"
BASELINE_TOML: Final = _HERE / "baseline.toml"


def baseline_trials(study: Path = BASELINE_TOML) -> tuple[Trial, ...]:
    """The trials of the fixed study.

    Raises:
        InputError: it is malformed.
    """
    return plan_study(read_study(str(study)), Path()).trials


def measured_figures(trials: Sequence[Trial], how: Execution, report: Report) -> dict[str, Figure]:
    """The figures as they are now.

    Raises:
        SemgraphError: there is no cluster.
    """
    outcomes: dict[str, Outcome] = {}
    with closing(outcome_lines(trials, how)) as lines:
        for line in lines:
            outcome = parse_outcome(line)
            outcomes[outcome.trial.id] = outcome
            report.done(len(outcomes))
    # As planned, however the trials came back: means then add up in the same order.
    return figures_of([outcomes[trial.id] for trial in trials if trial.id in outcomes])


def held_against(path: Path, now: dict[str, Figure]) -> tuple[Judged, ...]:
    """The verdict on each figure.

    Raises:
        InputError: the baseline is missing or malformed, or has no figure.
    """
    before = read_baseline(path)
    if not before:
        raise SemgraphError(f"{path}: expected figures, there are none; semgraph baseline --update")
    return judged(before, now)


def update(path: Path, now: dict[str, Figure], *, worse_too: bool) -> tuple[Judged, ...]:
    """Writes a baseline with what is better or new; what is worse only if that is asked for.

    Returns:
        The verdicts that led to it.

    Raises:
        InputError: the baseline is malformed.
        SemgraphError: it cannot be written.
    """
    before = read_baseline(path) if path.exists() else {}
    write_baseline(path, updated(before, now, worse_too=worse_too))
    return judged(before, now)


def failures(verdicts: Sequence[Judged]) -> tuple[Judged, ...]:
    """What has to be put right: worse, missing, not a number, crashed."""
    return tuple(each for each in verdicts if each.verdict.is_failure)


def told(verdicts: Sequence[Judged]) -> list[str]:
    """A line for each figure that is not as before, and one for all."""
    lines = [each.line for each in verdicts if each.verdict is not Verdict.AS_BEFORE]
    kinds = {kind: sum(each.verdict is kind for each in verdicts) for kind in Verdict}
    counts = ", ".join(f"{number} {kind.value}" for kind, number in kinds.items() if number)
    return [*lines, f"{len(verdicts)} figures: {counts}"]
