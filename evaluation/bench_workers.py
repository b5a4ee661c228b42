"""Processes that figures are measured in, beside each other or alone; they tell how far they are.

Each begins anew, so that what one run leaves in memory is not measured in the next.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Final, TypeVar

from evaluation.bench import tell
from semgraph.errors import SemgraphError

Case = TypeVar("Case")
Value = TypeVar("Value")
# A new process costs seconds, and one that is kept grows.
_TRIALS_A_PROCESS: Final = 8

Tell = Callable[[float], None]


def each_seed(trial: Callable[[Case], Value], seeds: Sequence[Case]) -> list[Value]:
    """The outcome of each seed or other case, in processes beside each other."""
    context = get_context("spawn")
    with ProcessPoolExecutor(
        os.cpu_count(), context, max_tasks_per_child=_TRIALS_A_PROCESS
    ) as pool:
        futures = [pool.submit(trial, seed) for seed in seeds]
        try:
            for k, future in enumerate(as_completed(futures), start=1):
                future.result()
                tell(k / len(seeds))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [future.result() for future in futures]


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
