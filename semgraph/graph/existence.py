"""Whether a landmark is there: log odds from being seen, and from not being seen where it should.

Source: the log-odds form of Bayes' rule for one thing that is there or not.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from semgraph.geometry import Pose2

_CLUTTER: Final = 0.05
_START: Final = -1.0
_LIMIT: Final = 4.5
_THERE: Final = 2.2
# Two looks from places nearer than this are one look: what hides a thing hides it in both.
_APART_M: Final = 0.3
# Before anything is known: detected in 85 of 100 looks, and as sure of it as after so many looks.
_DETECTED: Final = 0.85
_LOOKS_BEFORE: Final = 10.0
# How many looks at others weigh as much as the looks at a landmark itself.
_LOOKS_AT_OTHERS: Final = 10.0
_HIT: Final = float(np.log(_DETECTED / _CLUTTER))


@dataclass(slots=True)
class Tally:
    """How often things that should be seen were seen."""

    hits: float = 0.0
    looks: float = 0.0

    def count(self, *, is_hit: bool) -> None:
        """One look more."""
        self.hits += is_hit
        self.looks += 1.0

    def rate(self, prior: float = _DETECTED, weight: float = _LOOKS_BEFORE) -> float:
        """The probability of being seen; before any look the prior."""
        return (self.hits + prior * weight) / (self.looks + weight)


def _logit(probability: float) -> float:
    return float(np.log(probability / (1.0 - probability)))


@dataclass(slots=True)
class Evidence:
    """What the reliabilities of perceptions say of what they were perceptions of.

    A reliability is the probability that such a perception is right, so whatever is perceived with
    less than is usual is less probable than usual, however often. All looks at one thing are worth
    two that are independent: by Bayes' rule its log odds are u + 2 (m - u), where u are those of
    the usual reliability and m the mean of its own.
    """

    num_looks: int = 0
    sum_log_odds: float = 0.0

    def look(self, reliability: float) -> None:
        """One perception of this reliability."""
        self.num_looks += 1
        self.sum_log_odds += _logit(min(max(reliability, 0.01), 0.999))

    def absorb(self, other: "Evidence") -> None:
        """All perceptions of both."""
        self.num_looks += other.num_looks
        self.sum_log_odds += other.sum_log_odds

    def reliability(self, usual: float) -> float:
        """The probability that the thing is what it was perceived as.

        Args:
            usual: mean reliability of all perceptions of its kind.
        """
        mean = self.sum_log_odds / max(self.num_looks, 1)
        return float(1.0 / (1.0 + np.exp(_logit(min(max(usual, 0.01), 0.999)) - 2.0 * mean)))


@dataclass(slots=True)
class Existence:
    """What is believed of one landmark; looks count once every 0.3 m driven.

    Attributes:
        log_odds: of being there.
        tally: its own looks.
        num_misses: looks in vain since it was last seen.
        was_there: whether it was believed to be there at any time.
    """

    log_odds: float = _START
    tally: Tally = field(default_factory=Tally)
    num_misses: int = 0
    was_there: bool = False
    _last_hit: Pose2 | None = None
    _last_miss: Pose2 | None = None

    @property
    def is_there(self) -> bool:
        """More probable than nine to one."""
        return self.log_odds > _THERE

    @property
    def is_gone(self) -> bool:
        """Its absence is more probable than nine to one."""
        return self.log_odds < -_THERE

    def hit(self, odom_T_base: Pose2, reliability: float, of_kind: Tally) -> None:
        """It was perceived; an unreliable perception says little.

        Args:
            odom_T_base: from where.
            reliability: of the perception.
            of_kind: looks at all things of its kind, where this one is counted in.
        """
        if _is_near(self._last_hit, odom_T_base):
            return
        self._last_hit = odom_T_base
        self.num_misses = 0
        self._count(of_kind, is_hit=True)
        doubt = _logit(min(max(reliability, 0.01), _DETECTED)) - _logit(_DETECTED)
        self.log_odds = min(self.log_odds + max(_HIT + doubt, 0.0), _LIMIT)
        self.was_there |= self.is_there

    def miss(self, odom_T_base: Pose2, of_kind: Tally, *, passed: bool) -> None:
        """It was not perceived, although nothing was before its place.

        Where beams went right through, it is not there. Where they met something, a detector only
        did not make it out: that says the less, the less often it, and its kind, are perceived
        where they should be, and nothing against what is known to be there.
        """
        if _is_near(self._last_miss, odom_T_base):
            return
        detected = _DETECTED
        if not passed:
            detected = min(self.tally.rate(of_kind.rate(), _LOOKS_AT_OTHERS), _DETECTED)
            self._count(of_kind, is_hit=False)
            if self.is_there:
                return
        self._last_miss = odom_T_base
        self.num_misses += 1
        change = float(np.log((1.0 - detected) / (1.0 - _CLUTTER)))
        self.log_odds = max(self.log_odds + min(change, 0.0), -_LIMIT)

    def absorb(self, other: "Existence") -> None:
        """Both are one: what says more for it holds, since it was looked for at one place only."""
        self.log_odds = max(self.log_odds, other.log_odds)
        self.was_there |= other.was_there
        self.tally.hits += other.tally.hits
        self.tally.looks += other.tally.looks

    def _count(self, of_kind: Tally, *, is_hit: bool) -> None:
        for tally in (self.tally, of_kind):
            tally.count(is_hit=is_hit)


def _is_near(before: Pose2 | None, now: Pose2) -> bool:
    return before is not None and float(np.hypot(now.x - before.x, now.y - before.y)) < _APART_M
