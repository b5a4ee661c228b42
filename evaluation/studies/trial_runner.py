"""Trials given to a `trial_process`, which is started when it is needed and again when it is gone.

Limits hold there. It is not a `multiprocessing.Process`, since a Dask worker may start none.
"""

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import IO, Final, final

from evaluation.studies.outcome_lines import outcome_line, trial_line
from evaluation.studies.trial import Outcome, Status, Trial
from evaluation.studies.trial_process import READY, Limits
from semgraph.beside.worker import ended_by
from semgraph.one_thread import ONE_THREAD

_MODULE: Final = "evaluation.studies.trial_process"
_NUM_ATTEMPTS: Final = 3


@final
class TrialRunner:
    """One process for trials, one after the other."""

    def __init__(self, measure: str, limits: Limits) -> None:
        self.runs = measure, limits
        self._process: subprocess.Popen[bytes] | None = None

    def outcome_line(self, trial: Trial) -> bytes:
        """The outcome of a trial as a line; it is tried again if the process is killed."""
        ends = ""
        for _ in range(_NUM_ATTEMPTS):
            line = self._asked(trial)
            if line.endswith(b"\n"):
                return line
            ends = ended_by(self._ended())
        reason = f"the process for trials {ends}, {_NUM_ATTEMPTS} times"
        return outcome_line(Outcome(trial, Status.FAILED, reason))

    def end(self) -> None:
        """The process, at once."""
        if self._process is not None:
            self._process.kill()
            self._ended()

    def _asked(self, trial: Trial) -> bytes:
        """What the process answers; something without an end if it is gone."""
        if self._process is None or self._process.poll() is not None:
            self._ended()
            self._process = self._started()
            if _pipe(self._process.stdout).readline() != READY:
                return b""
        try:
            _pipe(self._process.stdin).write(trial_line(trial))
            _pipe(self._process.stdin).flush()
        except BrokenPipeError:
            return b""
        return _pipe(self._process.stdout).readline()

    def _started(self) -> subprocess.Popen[bytes]:
        measure, limits = self.runs
        arguments = (measure, repr(limits.seconds), str(limits.memory_bytes))
        paths = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)
        return subprocess.Popen(  # noqa: S603 - this Python, with arguments of our own
            [sys.executable, "-P", "-m", _MODULE, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": paths},
        )

    def _ended(self) -> int:
        """The exit code of the process, which is gone or about to be."""
        process, self._process = self._process, None
        if process is None:
            return 0
        for pipe in (process.stdin, process.stdout):
            _close(pipe)
        return process.wait()


_of_thread = threading.local()


def run_trial(trial: Trial, measure: str, limits: Limits) -> bytes:
    """The outcome of a trial as a line, by the process that this thread keeps for trials."""
    runner: TrialRunner | None = getattr(_of_thread, "runner", None)
    if runner is None or runner.runs != (measure, limits):
        if runner is not None:
            runner.end()
        runner = _of_thread.runner = TrialRunner(measure, limits)
    return runner.outcome_line(trial)


def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
    if pipe is None:
        raise ValueError("expected a process with pipes")
    return pipe


def _close(pipe: IO[bytes] | None) -> None:
    """What was not written to a process that is gone does not matter."""
    try:
        _pipe(pipe).close()
    except BrokenPipeError:
        return
