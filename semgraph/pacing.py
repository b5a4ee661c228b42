"""A recording played in time."""

import math
import time
from typing import final

from semgraph.errors import InputError


@final
class Pace:
    """Holds measurements back until their time has come, at `speed` times real time.

    Raises:
        InputError: the speed is not positive; infinite is as fast as it goes.
    """

    def __init__(self, speed: float = math.inf) -> None:
        if not speed > 0.0:
            raise InputError(f"--speed {speed:g}: expected a positive number")
        self._speed = speed
        self._started_s = 0.0
        self._first_ns: int | None = None
        self._late_s = self._let_go_s = 0.0

    @property
    def let_go_s(self) -> float:
        """When the last measurement was let go, on the monotonic clock."""
        return self._let_go_s

    @property
    def late_s(self) -> float:
        """By how much a measurement was taken later than its time, at most."""
        return self._late_s

    @property
    def events(self) -> tuple[str, ...]:
        """How well the scan path kept up; nothing where it was not held back."""
        if math.isinf(self._speed):
            return ()
        return (f"played at {self._speed:g} times real time, late by at most {self._late_s:.3f} s",)

    def wait(self, stamp_ns: int) -> None:
        """Returns when a measurement of this stamp would be there."""
        now_s = time.monotonic()
        if self._first_ns is None:
            self._first_ns, self._started_s = stamp_ns, now_s
        due_s = self._started_s + (stamp_ns - self._first_ns) * 1e-9 / self._speed
        if due_s > now_s:
            time.sleep(due_s - now_s)
        elif math.isfinite(self._speed):
            self._late_s = max(self._late_s, now_s - due_s)
        self._let_go_s = time.monotonic()
