"""The process that trials are run in: it has imported everything, and forks for each.

So each trial begins as the one before it did, at the price of a fork, and one that hangs, crashes
or takes all memory takes nobody with it. Requests come in on standard input, a trial a line;
outcomes go out on standard output. When the input ends, so do this process and its trial.
"""

import importlib
import os
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, NoReturn, cast

from evaluation.studies.outcome_lines import MAX_LINE_BYTES, outcome_line, parse_trial
from evaluation.studies.trial import Outcome, Status, Trial
from semgraph.beside.worker import ended_by
from semgraph.errors import InputError, SemgraphError

READY: Final = b"ready\n"
MEASURE: Final = "evaluation.studies.prepared:measure"
# Whoever needs it after that starts it anew.
_IDLE_S: Final = 60.0
# What `select` takes, where there is no limit.
_LONGEST_WAIT_S: Final = 1e6
# Of what Linux asks when memory runs out: rather a trial than whoever looks after it.
_OOM_SCORE: Final = "500"

Measure = Callable[[Trial], Outcome]


@dataclass(frozen=True, slots=True)
class Limits:
    """What a trial may take.

    Attributes:
        seconds: of wall time.
        memory_bytes: of address space; 0 for as much as there is.
    """

    seconds: float
    memory_bytes: int = 0


def measure_named(name: str) -> Measure:
    """A function by `module:name`."""
    module, _, function = name.partition(":")
    return cast(Measure, getattr(importlib.import_module(module), function))


def measured(measure: Measure, trial: Trial) -> Outcome:
    """What a trial gives, or what ended it."""
    try:
        return measure(trial)
    except MemoryError:
        return Outcome(trial, Status.OUT_OF_MEMORY, "there was no memory left for it")
    except SemgraphError as error:
        return Outcome(trial, Status.FAILED, str(error) or type(error).__name__)
    except Exception as error:  # noqa: BLE001 - whatever ends a trial is its outcome
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name} line {place.lineno}"
        return Outcome(trial, Status.FAILED, f"{type(error).__name__}: {error} ({where})")


def serve(measure_name: str, limits: Limits) -> None:
    """Runs trials from standard input until it ends, or nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    measure = measure_named(measure_name)
    _write(answers, READY)
    while (line := _request()) is not None:
        _write(answers, _forked(measure, parse_trial(line), limits))


def _request() -> bytes | None:
    """The next line, None at the end."""
    line = b""
    while not line.endswith(b"\n"):
        if not select.select([0], [], [], _IDLE_S)[0]:
            return None
        part = os.read(0, MAX_LINE_BYTES)
        if not part:
            return None
        line += part
    return line


def _forked(measure: Measure, trial: Trial, limits: Limits) -> bytes:
    """The outcome of a trial in a process of its own."""
    started = time.monotonic()
    with tempfile.TemporaryFile() as said:
        reading, writing = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(reading)
            _child(measure, trial, limits, writing, said)
        os.close(writing)
        line, in_time = _answer(reading, pid, started + limits.seconds)
        os.close(reading)
        _, status, usage = os.wait4(pid, 0)
        if in_time and status == 0 and line.endswith(b"\n"):
            return line
        outcome = Outcome(
            trial,
            *_end(status, limits, said, in_time=in_time),
            wall_s=time.monotonic() - started,
            cpu_s=usage.ru_utime + usage.ru_stime,
            peak_memory_bytes=usage.ru_maxrss * 1024,
        )
    return outcome_line(outcome)


def _answer(reading: int, pid: int, deadline: float) -> tuple[bytes, bool]:
    """What the trial's process wrote, and whether in time; if not, it is ended."""
    line = b""
    in_time = True
    while True:
        left = deadline - time.monotonic()
        ready = select.select([reading, 0], [], [], min(max(left, 0.0), _LONGEST_WAIT_S))[0]
        if not ready and left > _LONGEST_WAIT_S:
            continue
        if not ready:
            in_time = False
            break
        if reading not in ready:
            _end_group(pid)
            os._exit(0)
        part = os.read(reading, 2**16)
        if not part:
            break
        line += part
    if not in_time:
        _end_group(pid)
    return line, in_time


def _end_group(pid: int) -> None:
    """The trial's process, and whatever it started."""
    try:
        os.killpg(pid, signal.SIGKILL)
    except ProcessLookupError:
        os.kill(pid, signal.SIGKILL)


def _end(status: int, limits: Limits, said: BinaryIO, *, in_time: bool) -> tuple[Status, str]:
    """How a trial without an outcome ended, and why."""
    if not in_time:
        return Status.TIMED_OUT, f"not done after {limits.seconds:g} s (--trial-timeout)"
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGKILL:
        return Status.OUT_OF_MEMORY, "killed by SIGKILL, as Linux does when memory runs out"
    said.seek(max(said.seek(0, os.SEEK_END) - 2000, 0))
    words = said.read().decode(errors="replace").strip().splitlines()
    return Status.FAILED, f"its process {ended_by(code)}" + (f": {words[-1]}" if words else "")


def _child(
    measure: Measure, trial: Trial, limits: Limits, writing: int, said: BinaryIO
) -> NoReturn:
    """The trial's process."""
    status = 1
    try:
        os.setsid()
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        _limit(limits)
        _write(writing, outcome_line(measured(measure, trial)))
        status = 0
    except BaseException:  # noqa: BLE001 - nothing may return into the parent's code
        traceback.print_exc()
    finally:
        os._exit(status)


def _limit(limits: Limits) -> None:
    adjustment = Path("/proc/self/oom_score_adj")
    if adjustment.exists():
        adjustment.write_text(_OOM_SCORE)
    if limits.memory_bytes:
        resource.setrlimit(resource.RLIMIT_AS, (limits.memory_bytes, limits.memory_bytes))


def _write(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


def main(arguments: list[str]) -> None:
    """Serves the function, with the limits, that the arguments name."""
    if len(arguments) != 3:
        raise InputError("expected module:function, seconds and bytes")
    serve(arguments[0], Limits(float(arguments[1]), int(arguments[2])))


if __name__ == "__main__":
    main(sys.argv[1:])
