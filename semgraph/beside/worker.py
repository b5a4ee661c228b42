"""The graph's process: started, looked after and ended. What it does is in `smoothing_loop`."""

import os
import signal
import time
from multiprocessing import get_context
from typing import Any, final

from semgraph.beside.spool import Spool
from semgraph.errors import SemgraphError
from semgraph.one_thread import use_one_thread


@final
class Worker:
    """One process that works through a spool of scans from its start.

    Raises:
        SemgraphError: the system gives no process or no file for its answers.
    """

    def __init__(self, scans: Spool, niceness: int) -> None:
        self._answers = Spool()
        self._heard_s = time.monotonic()
        self._process = get_context("spawn").Process(
            target=_begin, args=(niceness, scans, self._answers), daemon=True, name="semgraph graph"
        )
        try:
            self._process.start()
        except OSError as error:
            self._answers.close()
            raise SemgraphError(
                f"the graph's process cannot be started: {error.strerror}; run without --online"
            ) from error

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid or 0

    def answer(self) -> Any:
        """The next thing that it says; None if it says nothing for now."""
        answer = self._answers.read()
        if answer is not None:
            self._heard_s = time.monotonic()
        return answer

    def wait(self, seconds: float) -> None:
        """Until it has ended, but no longer."""
        self._process.join(seconds)

    def exit_code(self) -> int | None:
        """None while it lives; minus the signal that killed it."""
        return self._process.exitcode

    def silent_s(self) -> float:
        """How long it has not said anything."""
        return time.monotonic() - self._heard_s

    def end(self) -> None:
        """At once, whatever it is doing."""
        self._process.kill()
        self._process.join()
        self._process.close()
        self._answers.close()


def ended_by(exit_code: int) -> str:
    """How a process ended, in words."""
    if exit_code < 0:
        return f"killed by {signal.Signals(-exit_code).name}"
    return f"ended with status {exit_code}"


def _begin(niceness: int, scans: Spool, answers: Spool) -> None:
    """The process's first function.

    What is below it is imported here, so that numpy finds how many threads it may use: cores are
    for the scan path. An interrupt from the terminal is for the parent, who ends this process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(niceness)
    use_one_thread()
    from semgraph.beside.smoothing_loop import smooth

    smooth(scans, answers)
