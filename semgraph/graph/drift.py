"""How far things may be from where they were sighted before: what drift may have done."""

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.measurement_model import CHI2_2DOF_999

# How many standard deviations what is seen may be from its other self, both so unsure, at 99.9 %.
_GATE: Final = float((2.0 * CHI2_2DOF_999) ** 0.5)


@final
@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Since a landmark was sighted, along the longest axis, as a standard deviation in m.

    Attributes:
        beside_m: of what hangs together with the last pose. How unsure all of that is of its place
            in the map does not matter, for it is the same for all.
        apart_m: of anything else, which only the map joins to it.
        beside: the landmarks that hang together with it; None for all.
    """

    beside_m: float
    apart_m: float
    beside: Set[int] | None = None

    def reaches_m(self, landmarks: Sequence[int]) -> FloatArray:
        """(n,) how far each of these may be from what is seen of it, at 99.9 %."""
        if self.beside is None:
            return np.full(len(landmarks), _GATE * self.beside_m)
        is_beside = [landmark in self.beside for landmark in landmarks]
        reaches_m: FloatArray = _GATE * np.where(is_beside, self.beside_m, self.apart_m)
        return reaches_m

    @property
    def reach_m(self) -> float:
        """Of anything."""
        return _GATE * (self.beside_m if self.beside is None else max(self.beside_m, self.apart_m))


def reach_of(covariance: FloatArray) -> float:
    """How far in m what is seen from a pose (3, 3) may be off, at 99.9 %."""
    return _GATE * sigma_m(covariance)


def sigma_m(covariance: FloatArray) -> float:
    """Of a pose's (3, 3) position, along its longest axis."""
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance[:2, :2])[-1], 0.0)))
