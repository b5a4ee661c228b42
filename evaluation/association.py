"""How well perceptions were put together: which of them are said to be of one thing, and are."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from semgraph.arrays import IntArray


@dataclass(frozen=True, slots=True)
class Association:
    """Counts of pairs of perceptions.

    Attributes:
        said: pairs said to be of one landmark.
        true: pairs that are of one true landmark.
        right: pairs that are both.
    """

    said: int
    true: int
    right: int

    @property
    def precision(self) -> float:
        """The share of what was said that is true; NaN where nothing was said."""
        return self.right / self.said if self.said else float("nan")

    @property
    def recall(self) -> float:
        """The share of what is true that was said; NaN where nothing is."""
        return self.right / self.true if self.true else float("nan")


def compare_associations(
    said: Mapping[int, IntArray], true: Mapping[int, IntArray]
) -> Association | None:
    """Pairs of perceptions over the whole run, counted; None where no scan can be compared.

    Two things taken for one cost precision, one taken for two costs recall, a loop that is not
    closed too. Each false perception (-1 in the truth) is a thing of its own. What was left open
    (-1 in what was said) is of nothing.

    Args:
        said: by stamp, the landmark of each perception (n,).
        true: the same, as it is; scans of other sizes are of raw measurements, and left out.
    Source: Manning, Raghavan and Schuetze 2008, section 16.3, pairs of a clustering.
    """
    shared = [stamp for stamp in said if stamp in true and len(said[stamp]) == len(true[stamp])]
    if not shared:
        return None
    landmarks = np.concatenate([said[stamp] for stamp in shared])
    rows = np.concatenate([true[stamp] for stamp in shared])
    is_said, is_real = landmarks >= 0, rows >= 0
    both = np.column_stack([landmarks, rows])[is_said & is_real]
    return Association(
        _num_pairs(landmarks[is_said][:, None]),
        _num_pairs(rows[is_real][:, None]),
        _num_pairs(both),
    )


def _num_pairs(labels: IntArray) -> int:
    """How many pairs of rows (n, k) are alike."""
    _, counts = np.unique(labels, axis=0, return_counts=True)
    return int((counts * (counts - 1) // 2).sum())
