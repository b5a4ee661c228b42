"""The probability that the robot is not where it is believed to be."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2

# What fits by chance fits again as long as the same things are in sight: as far as one sees.
_NEW_AFTER_M: Final = 15.0
# What does not fit, something that the map lacks, does not fit again from nearby. It speaks in full
# once it is confirmed: seen once it may be nothing.
_NEW_AGAINST_M: Final = 1.0
_LEAST_AGAINST: Final = 0.1
# What is perceived as near as this to what was perceived before is the same.
_SAME_M: Final = 0.5
_MOST_LATELY: Final = 500
_LEAST: Final = 1e-12
# Of so many scans it is remembered how much there was in sight.
_REMEMBERED: Final = 50
# How much is hidden differs from place to place: what numbers say is half believed, to a limit.
_BELIEVED: Final = 0.5
_MOST_BY_NUMBERS: Final = 3.0


@dataclass(slots=True)
class Elsewhere:
    """Two probabilities, followed by Bayes' rule: of a wrong place, and of having been carried off.

    Anywhere else, what is perceived is as likely as in the mean of all places of the map. Who was
    carried off finds nothing where it is expected: every scan that fits speaks against that. A
    wrong place that fitted by chance fits again: only what is seen for the first time does.

    Attributes:
        wrong: that the robot never was where it is believed to be.
        gone: that it was, and is no longer.
        driven_m: since the scan before; infinite before the first.
    """

    wrong: float
    gone: float = 0.0
    driven_m: float = np.inf

    @property
    def probability(self) -> float:
        """Of being elsewhere."""
        return self.wrong + self.gone

    def move(self, motion: Pose2, carried_off: float) -> None:
        """The robot moved, or was carried off by this probability."""
        self.gone += (1.0 - self.probability) * carried_off
        self.driven_m += float(np.hypot(motion.x, motion.y))

    def weigh(self, evidence: float, share_confirmed: float = 0.0) -> None:
        """A scan speaks for here or for elsewhere, by the log of how much.

        Args:
            evidence: positive if for here.
            share_confirmed: of what is perceived, that is seen for the second time lately.
        """
        of_gone, of_wrong = evidence, evidence * min(self.driven_m / _NEW_AFTER_M, 1.0)
        if evidence < 0.0:
            again = float(np.clip(self.driven_m / _NEW_AGAINST_M, _LEAST_AGAINST, 1.0))
            new = share_confirmed + (1.0 - share_confirmed) * again
            of_gone = of_wrong = new * evidence
        self.driven_m = 0.0
        here = np.log(max(1.0 - self.probability, _LEAST))
        wrong = np.log(max(self.wrong, _LEAST)) - of_wrong
        gone = np.log(max(self.gone, _LEAST)) - of_gone
        total = np.logaddexp.reduce([here, wrong, gone])
        self.wrong, self.gone = float(np.exp(wrong - total)), float(np.exp(gone - total))


@dataclass(slots=True)
class UsualSight:
    """How many things are usually in sight, and how far and to the sides one sees."""

    number: float = 0.0
    reach_m: float = 0.0
    half_field: float = 0.0
    _num_scans: int = 0

    def add(self, ranges_m: FloatArray, bearings: FloatArray) -> None:
        """One scan more, with what is perceived at these ranges and bearings (k,)."""
        self._num_scans = min(self._num_scans + 1, _REMEMBERED)
        share = 1.0 / self._num_scans
        self.number += share * (len(ranges_m) - self.number)
        self.reach_m = max(float(ranges_m.max(initial=0.0)), (1.0 - share) * self.reach_m)
        widest = float(np.abs(bearings).max(initial=0.0))
        self.half_field = max(widest, (1.0 - share) * self.half_field)

    def evidence(self, sparseness: float) -> float:
        """Log of how much better few things are explained where there are few.

        By Poisson's law, for as many things as usually in sight.

        Args:
            sparseness: 1 where there is no landmark in reach, 0 where there are as many as in the
                mean of all places of the map, negative where there are more.
        """
        by_numbers = _BELIEVED * self.number * sparseness
        return float(np.clip(by_numbers, -_MOST_BY_NUMBERS, _MOST_BY_NUMBERS))


class PerceivedLately:
    """What was perceived during the last metre, as seen from here, and for which time."""

    def __init__(self) -> None:
        self._base_t = np.zeros((0, 2))
        self._driven_m = np.zeros(0)
        self._times = np.zeros(0, dtype=np.int64)

    def share_confirmed(self, base_t: FloatArray, motion: Pose2) -> float:
        """Of what is perceived (k, 2) after a motion, how much for the second time."""
        before = motion.inverse().transform(self._base_t)
        driven_m = self._driven_m + float(np.hypot(motion.x, motion.y))
        is_same = np.linalg.norm(base_t[:, None] - before, axis=2) <= _SAME_M
        times = 1 + np.where(is_same, self._times, 0).max(axis=1, initial=0)
        kept = driven_m <= _NEW_AGAINST_M
        self._base_t = np.vstack([before[kept], base_t])[-_MOST_LATELY:]
        self._driven_m = np.append(driven_m[kept], np.zeros(len(base_t)))[-_MOST_LATELY:]
        self._times = np.append(self._times[kept], times)[-_MOST_LATELY:]
        return float((times == 2).mean()) if len(base_t) else 0.0
