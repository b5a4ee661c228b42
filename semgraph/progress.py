"""How far long work is, with its rate and the time left; plain lines where there is no terminal."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.console import Console

_SECONDS_BETWEEN_LINES: Final = 5.0


@contextmanager
def progress(console: "Console", what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A function to be told how many of `total` are done."""
    if console.is_terminal:
        with _bar(console, what, total) as report:
            yield report
    else:
        yield _lines(console, what, total)


@contextmanager
def _bar(console: "Console", what: str, total: int) -> Iterator[Callable[[int], None]]:
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(show_speed=True),
        TextColumn("{task.completed}/{task.total} scans, {task.fields[rate]:.0f}/s"),
        TimeRemainingColumn(),
    )
    started = time.monotonic()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=total, rate=0.0)

        def report(done: int) -> None:
            rate = done / max(time.monotonic() - started, 1e-9)
            bar.update(task, completed=done, rate=rate)

        yield report


def _lines(console: "Console", what: str, total: int) -> Callable[[int], None]:
    started = told = time.monotonic()

    def report(done: int) -> None:
        nonlocal told
        now = time.monotonic()
        if now - told < _SECONDS_BETWEEN_LINES:
            return
        told = now
        rate = done / (now - started)
        left = (total - done) / rate
        console.print(f"{what}: {done}/{total} scans, {rate:.0f}/s, {left:.0f} s left")

    return report
