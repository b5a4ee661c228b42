"""Measurements of which the large ones are made anew whenever they are asked."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from semgraph.arrays import IntArray
from sensors.measurements import Measurement


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Measurements in the order of time, that can be iterated again and are the same then.

    Attributes:
        samples: small ones, in the order of time.
        stamps_ns: (n,) of the large ones.
        measure: makes the k-th of them, always the same.
    """

    samples: Sequence[Measurement]
    stamps_ns: IntArray
    measure: Callable[[int], Measurement]

    def __iter__(self) -> Iterator[Measurement]:
        """Samples of the same time come first."""
        done = 0
        stamps = np.array([sample.stamp_ns for sample in self.samples], dtype=np.int64)
        for k, end in enumerate(np.searchsorted(stamps, self.stamps_ns, side="right").tolist()):
            yield from self.samples[done:end]
            yield self.measure(k)
            done = end
        yield from self.samples[done:]
