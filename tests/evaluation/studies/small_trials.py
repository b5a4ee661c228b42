"""A stand-in for what studies measure: small, and with every way to end that a trial has."""

import ctypes
import os
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np

from evaluation.metrics import Direction, Metric
from evaluation.studies.execution import Execution
from evaluation.studies.running import run_study
from evaluation.studies.study_file import Condition, Plan, Study, plan_study
from evaluation.studies.trial import Drawing, Outcome, Series, Status, Trial
from semgraph.errors import InputError
from semgraph.progress import Silence

MEASURE = "tests.evaluation.studies.small_trials:measure"
CLIENT = "tests.evaluation.studies.small_trials"


def trial(
    estimator: str = "plain", seed: int = 0, condition: str = "calm", **options: str
) -> Trial:
    return Trial(
        "small", condition, "course:none", tuple(sorted(options.items())), (), estimator, seed
    )


def measure(trial: Trial) -> Outcome:
    options = dict(trial.options)
    if "log" in options:
        with Path(options["log"]).open("a") as log:
            log.write(f"{trial.id}\n")
    if "seconds" in options:
        time.sleep(float(options["seconds"]))
    _end(trial, options)
    return _outcome(trial)


def _end(trial: Trial, options: dict[str, str]) -> None:
    match trial.estimator:
        case "refuses":
            raise InputError("nothing to see\nhere")
        case "throws":
            raise ZeroDivisionError("by nought")
        case "hangs":
            time.sleep(3600.0)
        case "grabs":
            np.ones(2**36)
        case "fills":
            np.ones(2**31)
        case "crashes":
            ctypes.string_at(0)
        case "is-killed":
            os.kill(os.getpid(), signal.SIGKILL)
        case "kills-its-worker" if not Path(options["once"]).exists():
            Path(options["once"]).touch()
            os.kill(_worker_pid(), signal.SIGKILL)
        case "kills-its-worker-always":
            os.kill(_worker_pid(), signal.SIGKILL)


def _worker_pid() -> int:
    """Of the parent of the process that forked this one."""
    return int(Path(f"/proc/{os.getppid()}/stat").read_text().rpartition(")")[2].split()[1])


def _outcome(trial: Trial) -> Outcome:
    """Numbers that depend on the order of additions, and so on the number of BLAS threads."""
    rng = np.random.default_rng(trial.seed)
    matrix = rng.normal(size=(200, 200))
    value = float(np.linalg.norm(np.linalg.inv(matrix @ matrix.T) @ matrix))
    path = rng.normal(size=(5, 2))
    return Outcome(
        trial,
        Status.FINISHED,
        metrics=(
            Metric("error_m", value, "m", Direction.LOWER),
            Metric("nees_mean", float(rng.chisquare(3)), "", Direction.EXPECTED, 3.0),
        ),
        wall_s=0.5,
        cpu_s=0.25,
        peak_memory_bytes=2**20,
        series=Series(np.arange(5.0), path[:, 0] ** 2, np.full(5, np.nan), path[:, 1] ** 2),
        drawing=Drawing(path, path + 0.1, np.empty((0, 2)), path),
        versions=(("numpy", np.__version__),),
    )


def plan(
    number: int, estimators: Sequence[str] = ("plain",), **options: str | float | bool
) -> Plan:
    """A study of so many seeds."""
    condition = Condition(name="calm", source="course:none", options=options)
    study = Study(
        name="small",
        question="Does it all come home?",
        seeds=f"0-{number - 1}",
        estimators=list(estimators),
        condition=[condition],
    )
    return plan_study(study, Path("nowhere"))


def unwatched(number: int) -> AbstractContextManager[Silence]:
    return nullcontext(Silence())


def client(arguments: Sequence[str]) -> None:
    """A process of its own that runs a small study: folder, workers, number, options."""
    folder, workers, number, *options = arguments
    named = dict(option.split("=", 1) for option in options)
    how = Execution(workers=int(workers), measure=MEASURE)
    run_study(plan(int(number), **named), Path(folder), how, unwatched, print)


if __name__ == "__main__":
    client(sys.argv[1:])
