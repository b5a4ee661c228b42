"""How far long work is, with its rate and the time left; plain lines where there is no terminal."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, Protocol, final

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

_SECONDS_BETWEEN_LINES: Final = 5.0


class Report(Protocol):
    """Whom the work tells how far it is."""

    def done(self, count: int) -> None:
        """So many of the total are done."""
        ...

    def note(self, text: str) -> None:
        """What goes on where no count can tell."""
        ...


@final
class Silence:
    """Nobody listens."""

    def done(self, count: int) -> None:
        """As `Report`."""

    def note(self, text: str) -> None:
        """As `Report`."""


@contextmanager
def progress(console: "Console", what: str, total: int, unit: str = "scans") -> Iterator[Report]:
    """Whom to tell how many of `total` are done."""
    if console.is_terminal:
        with _bar(console, unit) as bar:
            yield _Bar(bar, bar.add_task(what, total=total, rate=0.0), what)
    else:
        yield _Lines(console, what, total, unit)


def _bar(console: "Console", unit: str) -> "Progress":
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(show_speed=True),
        TextColumn(f"{{task.completed}}/{{task.total}} {unit}, {{task.fields[rate]:.3g}}/s"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )


class _Bar:
    def __init__(self, bar: "Progress", task: "TaskID", what: str) -> None:
        self._bar = bar
        self._task = task
        self._what = what
        self._started = time.monotonic()

    def done(self, count: int) -> None:
        rate = count / max(time.monotonic() - self._started, 1e-9)
        self._bar.update(self._task, completed=count, rate=rate)

    def note(self, text: str) -> None:
        self._bar.update(self._task, description=f"{self._what}: {text}")


class _Lines:
    def __init__(self, console: "Console", what: str, total: int, unit: str) -> None:
        self._console = console
        self._what = what
        self._total = total
        self._unit = unit
        self._started = self._told = time.monotonic()

    def done(self, count: int) -> None:
        now = time.monotonic()
        if now - self._told < _SECONDS_BETWEEN_LINES:
            return
        self._told = now
        rate = count / (now - self._started)
        left = (self._total - count) / rate
        self._console.print(
            f"{self._what}: {count}/{self._total} {self._unit}, {rate:.3g}/s, {left:.0f} s left"
        )

    def note(self, text: str) -> None:
        now = time.monotonic()
        if now - self._told >= _SECONDS_BETWEEN_LINES:
            self._told = now
            self._console.print(f"{self._what}: {text}")
