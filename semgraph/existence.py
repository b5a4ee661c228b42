"""Whether a landmark is there: log odds from being seen, and from not being seen where it should.

Source: the log-odds form of Bayes' rule for one thing that is there or not.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.geometry import Pose2

_DETECTED: Final = 0.85
_CLUTTER: Final = 0.05
_START: Final = -1.0
_LIMIT: Final = 5.0
_THERE: Final = 2.2
# Two looks from places nearer than this are one look: what hides a thing hides it in both.
_APART_M: Final = 0.3
_HIT: Final = float(np.log(_DETECTED / _CLUTTER))
_MISS: Final = float(np.log((1.0 - _DETECTED) / (1.0 - _CLUTTER)))


def _logit(probability: float) -> float:
    return float(np.log(probability / (1.0 - probability)))


@dataclass(slots=True)
class Existence:
    """What is believed of one landmark; looks count once every 0.3 m driven."""

    log_odds: float = _START
    _last_hit: Pose2 | None = None
    _last_miss: Pose2 | None = None

    @property
    def is_there(self) -> bool:
        """More probable than nine to one."""
        return self.log_odds > _THERE

    @property
    def is_gone(self) -> bool:
        """Its absence is more probable than nine to one, after it was there or seemed to be."""
        return self.log_odds < -_THERE

    def hit(self, odom_T_base: Pose2, reliability: float) -> None:
        """It was perceived; an unreliable perception says little."""
        if _is_near(self._last_hit, odom_T_base):
            return
        self._last_hit = odom_T_base
        doubt = _logit(min(max(reliability, 0.01), _DETECTED)) - _logit(_DETECTED)
        self.log_odds = min(self.log_odds + max(_HIT + doubt, 0.0), _LIMIT)

    def miss(self, odom_T_base: Pose2) -> None:
        """It was not perceived, although nothing was before its place."""
        if _is_near(self._last_miss, odom_T_base):
            return
        self._last_miss = odom_T_base
        self.log_odds = max(self.log_odds + _MISS, -_LIMIT)

    def absorb(self, other: "Existence") -> None:
        """Both are one: what says more for it holds, since it was looked for at one place only."""
        self.log_odds = max(self.log_odds, other.log_odds)


def _is_near(before: Pose2 | None, now: Pose2) -> bool:
    return before is not None and float(np.hypot(now.x - before.x, now.y - before.y)) < _APART_M
