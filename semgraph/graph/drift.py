"""How far things may be from where they were sighted before: what drift may have done."""

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import final

import numpy as np

from semgraph.arrays import FloatArray


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

    def sigmas_m(self, landmarks: Sequence[int]) -> FloatArray:
        """(n,) of each of these."""
        if self.beside is None:
            return np.full(len(landmarks), self.beside_m)
        is_beside = [landmark in self.beside for landmark in landmarks]
        return np.where(is_beside, self.beside_m, self.apart_m)

    @property
    def most_m(self) -> float:
        """Of anything."""
        return self.beside_m if self.beside is None else max(self.beside_m, self.apart_m)
