"""The probability that the robot is not where it is believed to be."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.geometry import Pose2

# What fits by chance fits again as long as the same things are in sight: as far as one sees.
_NEW_AFTER_M: Final = 15.0
# What does not fit, something that the map lacks, does not fit again from nearby.
_NEW_AGAINST_M: Final = 0.5
_LEAST_AGAINST: Final = 0.1
_LEAST: Final = 1e-12


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

    def weigh(self, evidence: float) -> None:
        """A scan speaks for here or for elsewhere, by the log of how much."""
        of_gone, of_wrong = evidence, evidence * min(self.driven_m / _NEW_AFTER_M, 1.0)
        if evidence < 0.0:
            new = float(np.clip(self.driven_m / _NEW_AGAINST_M, _LEAST_AGAINST, 1.0))
            of_gone = of_wrong = new * evidence
        self.driven_m = 0.0
        here = np.log(max(1.0 - self.probability, _LEAST))
        wrong = np.log(max(self.wrong, _LEAST)) - of_wrong
        gone = np.log(max(self.gone, _LEAST)) - of_gone
        total = np.logaddexp.reduce([here, wrong, gone])
        self.wrong, self.gone = float(np.exp(wrong - total)), float(np.exp(gone - total))
