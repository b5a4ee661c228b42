"""How soon what was sighted is sighted again, learned from a run itself: the odds of what is next.

Things that are alike cannot be told by how they look, but what was in sight a moment ago is rather
in sight now than what was not, and one thing that is taken for two is in sight half as often.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.offline.batch import Batch

NEVER: Final = -1
# Ages of 1, 2 to 3, 4 to 7 scans and so on; the last class is of what was never sighted.
_CLASSES: Final = 12


@dataclass(frozen=True, slots=True, eq=False)
class SightHabits:
    """How probably a landmark is in a scan, by how many scans ago it was last.

    Attributes:
        by_age: (13,) of ages in octaves, then of what was never sighted.
    """

    by_age: FloatArray

    @classmethod
    def of(cls, batch: Batch, columns: IntArray, num_landmarks: int) -> Self:
        """Counted where perceptions (m,) are of landmarks `columns`, -1 for none."""
        hits, looks = np.full(_CLASSES + 1, 0.5), np.ones(_CLASSES + 1)
        last = np.full(num_landmarks, NEVER)
        for scan, seen in enumerate(_by_scan(batch, columns)):
            ages = _age_classes(scan, last)
            looks += np.bincount(ages, minlength=_CLASSES + 1)
            hits += np.bincount(ages[seen], minlength=_CLASSES + 1)
            last[seen] = scan
        return cls(hits / looks)

    def surprises(self, scan: int, last: IntArray) -> FloatArray:
        """(..., c) -2 ln of how probably a perception is of each landmark.

        Args:
            scan: it is in.
            last: (..., c) the scan that each landmark was last in, `NEVER` for none.
        """
        odds = self.by_age[_age_classes(scan, last)]
        surprises: FloatArray = -2.0 * np.log(odds / odds.sum(axis=-1, keepdims=True))
        return surprises

    def of_none(self, num_landmarks: int) -> float:
        """What a perception of nothing costs: as much as one of any landmark at random."""
        return 2.0 * float(np.log(max(num_landmarks, 1)))

    def total(self, batch: Batch, columns: IntArray, num_landmarks: int) -> float:
        """-2 ln of how probably perceptions (m,) are of landmarks `columns`, one by one."""
        last = np.full(num_landmarks, NEVER)
        total = self.of_none(num_landmarks) * int((columns < 0).sum())
        for scan, seen in enumerate(_by_scan(batch, columns)):
            if len(seen):
                total += float(self.surprises(scan, last)[seen].sum())
                last[seen] = scan
        return total


def _by_scan(batch: Batch, columns: IntArray) -> list[IntArray]:
    """The landmarks of each scan."""
    starts = np.searchsorted(batch.scans, np.arange(1, len(batch)))
    return [seen[seen >= 0] for seen in np.split(columns, starts)]


def _age_classes(scan: int, last: IntArray) -> IntArray:
    """(..., c) the class of each landmark's age."""
    octaves = np.log2(np.maximum(scan - last, 1)).astype(np.int64)
    classes: IntArray = np.where(last == NEVER, _CLASSES, np.minimum(octaves, _CLASSES - 1))
    return classes
