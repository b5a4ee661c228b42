"""What the graph decided of its landmarks, when and why."""

from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from semgraph.landmarks import Kind


class What(Enum):
    """What may be decided of a landmark."""

    LOOP_CLOSED = "loop closed"
    RESUMED = "track resumed"
    DUPLICATE = "duplicate"
    TAKEN_BACK = "taken back"
    MOVING = "moving"
    GONE = "gone"
    LEFT_OUT = "left out"
    HANDED_OVER = "handed over"


MADE_ONE: Final = (What.LOOP_CLOSED, What.RESUMED, What.DUPLICATE)


@dataclass(frozen=True, slots=True)
class Decision:
    """One decision.

    Attributes:
        scan: after which it was made.
        what: was decided.
        kind, landmark: of what.
        other: the landmark that it was found to be, or no longer to be; -1 for none.
        log_odds: how sure, NaN where nothing was weighed.
        why: in words.
    """

    scan: int
    what: What
    kind: Kind
    landmark: int
    other: int = -1
    log_odds: float = float("nan")
    why: str = ""

    def __str__(self) -> str:
        where = f"{self.what.value} at scan {self.scan}: {self.kind.label} {self.landmark}"
        if self.what is What.LEFT_OUT:
            return f"{where}, {self.why} sightings fit nothing"
        if self.what is What.HANDED_OVER:
            return f"{where}, {self.why} are of {self.other}"
        verb = "is not" if self.what is What.TAKEN_BACK else "is"
        other = f" {verb} {self.other}" if self.other >= 0 else ""
        odds = f", log odds {self.log_odds:.1f}" if np.isfinite(self.log_odds) else ""
        why = f", {self.why}" if self.why else ""
        return f"{where}{other}{why}{odds}"


class DecisionLog:
    """Decisions in the order in which they were made.

    Attributes:
        scan: the last one, after which decisions are made.
    """

    def __init__(self) -> None:
        self.scan = -1
        self._decisions: list[Decision] = []

    def add(
        self,
        what: What,
        kind: Kind,
        landmark: int,
        other: int = -1,
        log_odds: float = float("nan"),
        why: str = "",
    ) -> None:
        """One more, after the last scan."""
        self._decisions.append(Decision(self.scan, what, kind, landmark, other, log_odds, why))

    def all(self) -> tuple[Decision, ...]:
        """All of them."""
        return tuple(self._decisions)
