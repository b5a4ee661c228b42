"""Trials run in this process, in a Dask cluster on this machine, or in one that is there already.

Whoever runs them, a trial's outcome comes back as the line that is stored.
"""

import logging
import os
import secrets
import time
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from evaluation.studies.outcome_lines import outcome_line
from evaluation.studies.trial import Outcome, Status, Trial
from evaluation.studies.trial_process import MEASURE, Limits, measure_named, measured
from evaluation.studies.trial_runner import TrialRunner, run_trial
from semgraph.errors import InputError, SemgraphError
from semgraph.one_thread import ONE_THREAD

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

DEFAULT_LIMITS: Final = Limits(3600.0)
_PATIENCE_S: Final = 10.0
# Workers take seconds to start, and to be started again by whoever looks after them.
_WORKERLESS_S: Final = 30.0
# So often a worker may end with a trial before others go first.
_NUM_KILLED: Final = 1
# So many trials a thread are known to the scheduler: one runs, and one is there when it is done.
_AHEAD: Final = 2
# Dask looks after itself fifty times a second and more; that took 4 % of a core from the trials.
_QUIET: Final = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "30s",
    "distributed.worker.memory.monitor-interval": "10s",
}


@dataclass(frozen=True, slots=True)
class Tls:
    """Files in PEM for a scheduler with tls://; None leaves it to the configuration of Dask."""

    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None


@dataclass(frozen=True, slots=True)
class Execution:
    """How trials are run.

    Attributes:
        workers: processes on this machine, 0 for this very process.
        scheduler: an existing one, instead of processes on this machine.
        limits: of a trial; this very process knows none.
        measure: `module:function`, a trial in, an outcome out.
    """

    workers: int = os.cpu_count() or 1
    scheduler: str | None = None
    tls: Tls = Tls()
    limits: Limits = DEFAULT_LIMITS
    measure: str = MEASURE


def outcome_lines(trials: Sequence[Trial], how: Execution) -> Generator[bytes, None, None]:
    """The outcome of each trial as a line, as they are done.

    Raises:
        SemgraphError: the scheduler cannot be reached, has no workers, or is gone.
    """
    if how.scheduler is None and how.workers == 0:
        measure = measure_named(how.measure)
        return (outcome_line(measured(measure, trial)) for trial in trials)
    return _on_cluster(trials, how)


def run_alone(trial: Trial, how: Execution) -> bytes:
    """The outcome of one trial, within its limits but without a cluster."""
    runner = TrialRunner(how.measure, how.limits)
    try:
        return runner.outcome_line(trial)
    finally:
        runner.end()


def _on_cluster(trials: Sequence[Trial], how: Execution) -> Generator[bytes, None, None]:
    from distributed.client import FutureCancelledError, FuturesCancelledError

    with _client(how, len(trials)) as client:
        try:
            yield from _lines(client, trials, how)
        except (OSError, FutureCancelledError, FuturesCancelledError) as error:
            raise SemgraphError(
                "the scheduler is gone; all finished trials are kept: give the same command again"
            ) from error


def _lines(client: "Client", trials: Sequence[Trial], how: Execution) -> Iterator[bytes]:
    """The outcomes; trials whose workers ended come again, one by one and last.

    Dask blames a worker's end on all trials that were waiting for it too, and what a worker takes
    with it that had finished already it runs again without a word.
    """
    submit = partial(_submitted, client, how)
    suspects = deque[Trial]()
    for trial, future in _completed(client, trials, submit):
        line = None if _was_killed(future) else _line(trial, future)
        if line is None:
            suspects.append(trial)
        else:
            yield line
    while suspects:
        for trial, future in _completed(client, [suspects.popleft()], submit):
            line = _line(trial, future)
            if line is None:
                suspects.append(trial)
            else:
                yield line


def _completed(
    client: "Client", trials: Sequence[Trial], submit: Callable[[Trial], "Future"]
) -> Iterator[tuple[Trial, "Future"]]:
    """Trials as they are done; only as many are submitted as keep all workers busy."""
    waiting = iter(trials)
    running: dict[Future, Trial] = {}
    while True:
        for trial in _some(waiting, _AHEAD * _num_threads(client) - len(running)):
            running[submit(trial)] = trial
        if not running:
            return
        for future in _next_done(client, running):
            yield running.pop(future), future
            future.release()


def _next_done(client: "Client", running: Collection["Future"]) -> Collection["Future"]:
    """One or more of the futures, which are done.

    Raises:
        SemgraphError: there has been no worker for long.
    """
    from distributed import wait

    deadline = time.monotonic() + _WORKERLESS_S
    while True:
        try:
            with client.as_current():
                done: Collection[Future] = wait(list(running), _PATIENCE_S, "FIRST_COMPLETED").done
        except TimeoutError:
            if client.nthreads():
                deadline = time.monotonic() + _WORKERLESS_S
            elif time.monotonic() > deadline:
                raise SemgraphError(
                    f"there has been no worker for {_WORKERLESS_S:.0f} s; all finished trials are "
                    "kept: start workers and give the same command again"
                ) from None
        else:
            return done


def _some(trials: Iterator[Trial], number: int) -> Iterator[Trial]:
    for _ in range(number):
        trial = next(trials, None)
        if trial is None:
            return
        yield trial


def _num_threads(client: "Client") -> int:
    """Of all workers; those that come later are used too."""
    return max(sum(int(threads) for threads in client.nthreads().values()), 1)


def _submitted(client: "Client", how: Execution, trial: Trial) -> "Future":
    """A trial on its way, under a key of its own, whoever submitted it before."""
    key = f"trial-{trial.id}-{secrets.token_hex(4)}"
    return client.submit(run_trial, trial, how.measure, how.limits, key=key, pure=False)


def _was_killed(future: "Future") -> bool:
    """Whether workers ended while they ran it, or it waited for them."""
    from distributed import KilledWorker

    return isinstance(_error(future), KilledWorker)


def _line(trial: Trial, future: "Future") -> bytes | None:
    """The outcome that a future brings, or why it has none; None if its worker took that along."""
    try:
        error = _error(future)
        if error is None:
            return bytes(future.result(_PATIENCE_S))
    except TimeoutError:
        return None
    reason = f"its worker could not run it: {type(error).__name__}: {error}"
    if _was_killed(future):
        reason = "every worker that ran it ended, even when nothing else ran"
    return outcome_line(Outcome(trial, Status.FAILED, reason))


def _error(future: "Future") -> BaseException | None:
    error: BaseException | None = future.exception(_PATIENCE_S)
    return error


@contextmanager
def _client(how: Execution, num_trials: int) -> Iterator["Client"]:
    """A connection to the cluster, which is started where none is named."""
    import dask
    from distributed import Client

    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    settings = {
        "distributed.scheduler.allowed-failures": _NUM_KILLED,
        "distributed.nanny.pre-spawn-environ": ONE_THREAD,
    }
    with dask.config.set(settings | _QUIET):
        if how.scheduler is not None:
            with _connected(how.scheduler, how.tls) as client:
                yield client
            return
        with _local_cluster(min(how.workers, num_trials)) as cluster, Client(cluster) as client:
            yield client


def _local_cluster(num_workers: int) -> "LocalCluster":
    """Processes of this machine, behind its loopback.

    Raises:
        SemgraphError: the system gives no processes, ports or place for their files.
    """
    from distributed import LocalCluster

    try:
        return LocalCluster(
            n_workers=max(num_workers, 1),
            threads_per_worker=1,
            host="127.0.0.1",
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        )
    except (OSError, RuntimeError) as error:
        raise SemgraphError(
            f"no workers could be started: {_first_line(error)}; `--workers 0` needs none"
        ) from error


@contextmanager
def _connected(address: str, tls: Tls) -> Iterator["Client"]:
    from distributed import Client
    from distributed.security import Security

    given = {"tls_ca_file": tls.ca, "tls_client_cert": tls.certificate, "tls_client_key": tls.key}
    files = {key: path for key, path in given.items() if path is not None}
    for path in files.values():
        if not path.is_file():
            raise InputError(f"{path}: expected a file in PEM for {address}, there is none")
    security = Security(**{key: str(path) for key, path in files.items()})
    try:
        client = Client(address, security=security, timeout=_PATIENCE_S)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise SemgraphError(
            f"{address}: the scheduler cannot be reached: {_first_line(error)}; start one with: "
            "dask scheduler"
        ) from error
    try:
        _check_workers(client, address)
        yield client
    finally:
        client.close()


def _check_workers(client: "Client", address: str) -> None:
    """There are some, and they know what to do.

    Raises:
        SemgraphError: there is none, or one lacks this package.
    """
    deadline = time.monotonic() + _WORKERLESS_S
    while not client.nthreads():
        if time.monotonic() > deadline:
            raise SemgraphError(
                f"{address}: the scheduler has no workers; start some with: dask worker {address}"
            )
        time.sleep(0.1)
    for worker, answer in client.run(package_version, on_error="return").items():
        if isinstance(answer, Exception):
            raise SemgraphError(
                f"{address}: worker {worker} cannot run trials: {_first_line(answer)}; install "
                "semgraph there"
            )


def package_version() -> str:
    """Of semgraph, where this is called."""
    from importlib.metadata import version

    return version("semgraph")


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
