"""What came out of the graph: in the end, and in time."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.decisions import Decision
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.landmarks import Gone, Landmark


@dataclass(frozen=True, slots=True, eq=False)
class Online:
    """What was known of the graph in time, while the run went on.

    Attributes:
        trajectory: at each scan, by the corrections that had come by then.
        delays_s: (k,) of each correction, from the scan that it is of until it was in force.
        lags: (n,) how many scans the graph was behind at each scan.
        num_restarts: how often its process was started anew.
        lost: why there is no graph in the end; empty where there is one.

    Raises:
        InputError: shapes disagree, or a negative delay or lag.
    """

    trajectory: Trajectory
    delays_s: FloatArray
    lags: IntArray
    num_restarts: int = 0
    lost: str = ""

    def __post_init__(self) -> None:
        delays_s = frozen_floats("delays", self.delays_s, (None,))
        lags = frozen_ints("lags", self.lags, (len(self.trajectory),))
        if not ((delays_s >= 0.0).all() and (lags >= 0).all() and self.num_restarts >= 0):
            raise InputError("online: expected no negative delay, lag or number of restarts")
        object.__setattr__(self, "delays_s", delays_s)
        object.__setattr__(self, "lags", lags)

    @property
    def summary(self) -> str:
        """How late it was, in a line."""
        if not len(self.delays_s):
            return "online: no correction came"
        median_s, worst_s = np.median(self.delays_s), self.delays_s.max()
        return (
            f"online: corrections in force after {median_s:.3f} s (median), {worst_s:.3f} s at "
            f"most; graph at most {self.lags.max(initial=0)} scans behind, started anew "
            f"{self.num_restarts} times"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """What the graph says in the end; the attributes are those of `results.RunResult`."""

    trajectory: Trajectory = field(
        default_factory=lambda: Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)))
    )
    covariances: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)))
    landmarks: tuple[Landmark, ...] = ()
    gone: tuple[Gone, ...] = ()
    associations: Mapping[int, IntArray] = field(default_factory=dict)
    events: tuple[str, ...] = ()
    decisions: tuple[Decision, ...] = ()
    online: Online | None = None
