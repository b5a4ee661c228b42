"""What an estimator in a study says of a recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.landmarks import Landmark, Perceptions
from semgraph.settings import Settings
from sensors.truth import Source


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Path and map by one estimator.

    Attributes:
        trajectory: map_T_base at each moment.
        covariances: (n, 3, 3) of its poses, each in its own frame; NaN throughout where unknown,
            and of no entry where the estimator has none.
        landmarks: its map; empty where it makes none.
        associations: by the stamp of perceptions, the landmark id of each (n,), -1 for none.
        step_seconds: (n,) how long each moment took; empty where it works on all at once.
        closed_at_ns: when loops were closed.
        nis: (k,) normalised squares of the innovations that were used, of 2 degrees of freedom
            each; empty where the estimator has none.
        online: map_T_base at each moment as it was said at the time; None where nothing was. The
            trajectory itself may be a later and better answer.
        perceptions: what was found in raw measurements, moment by moment, to tell whether it was
            associated well; none where perceptions come ready, and nothing is to be found.
    """

    trajectory: Trajectory
    covariances: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)))
    landmarks: tuple[Landmark, ...] = ()
    associations: Mapping[int, IntArray] = field(default_factory=dict)
    step_seconds: FloatArray = field(default_factory=lambda: np.empty(0))
    closed_at_ns: tuple[int, ...] = ()
    nis: FloatArray = field(default_factory=lambda: np.empty(0))
    online: Trajectory | None = None
    perceptions: tuple[Perceptions, ...] = ()


class Estimator(Protocol):
    """A source in, an estimate out. Only the oracle may look at `source.truth`."""

    def __call__(self, source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
        """What it makes of the source; raises SemgraphError where it can make nothing."""
        ...
