"""Processes that figures are measured in, beside each other or alone; they tell how far they are.

Each begins anew, so that what one run leaves in memory is not measured in the next.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Final, TypeVar

from evaluation.benches.bench import tell
from semgraph.errors import SemgraphError

Case = TypeVar("Case")
Value = TypeVar("Value")
# A new process costs seconds, and one that is kept grows. Pools follow each other, since their own
# `max_tasks_per_child` waits for ever on many Pythons (cpython's issue 115634).
_TRIALS_A_PROCESS: Final = 8

Tell = Callable[[float], None]


def each_seed(trial: Callable[[Case], Value], seeds: Sequence[Case]) -> list[Value]:
    """The outcome of each seed or other case, in processes beside each other."""
    workers = os.cpu_count() or 1
    size = workers * _TRIALS_A_PROCESS
    outcomes: list[Value] = []
    for start in range(0, len(seeds), size):
        with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
            futures = [pool.submit(trial, seed) for seed in seeds[start : start + size]]
            for k, future in enumerate(_finished(pool, futures), start=start + 1):
                future.result()
                tell(k / len(seeds))
        outcomes += [future.result() for future in futures]
    return outcomes


def _finished(
    pool: ProcessPoolExecutor, futures: Sequence[Future[Value]]
) -> Iterator[Future[Value]]:
    """The futures as they finish; what waits is given up where one of them fails."""
    try:
        for future in as_completed(futures):
            if future.exception() is not None:
                pool.shutdown(wait=False, cancel_futures=True)
            yield future
    except KeyboardInterrupt:
        pool.shutdown(wait=False, cancel_futures=True)
        raise


def alone(trial: Callable[[Tell], Value]) -> Value:
    """The outcome of one trial in a process of its own, which tells how far it is.

    Raises:
        SemgraphError: the trial's own, or the process ended without an outcome.
    """
    context = get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(there, trial), daemon=True)
    process.start()
    there.close()
    try:
        while True:
            kind, value = here.recv()
            if kind == _DONE:
                return value  # type: ignore[no-any-return]
            if kind == _FAILED:
                raise SemgraphError(value)
            tell(value)
    except EOFError:
        process.join()
        raise SemgraphError(f"the measuring process ended with {process.exitcode}") from None
    finally:
        here.close()
        process.terminate()
        process.join()


_TOLD, _DONE, _FAILED = "told", "done", "failed"


def _send(there: Connection, trial: Callable[[Tell], object]) -> None:
    """What a trial tells and gives, or why it cannot."""
    try:
        outcome = trial(lambda share: there.send((_TOLD, share)))
    except SemgraphError as error:
        there.send((_FAILED, str(error)))
    else:
        there.send((_DONE, outcome))
