"""The graph beside the fast estimator, wherever it runs, and what comes out of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, final

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2
from semgraph.landmarks import Gone, Landmark, Perceptions
from semgraph.smoother import Smoother, SmootherSettings
from sensors.views import View


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
    online: Online | None = None


class GraphBeside(Protocol):
    """It takes in scan after scan, and says in the end what it made of them."""

    def add(self, step: FastStep, perceptions: Perceptions, views: Sequence[View]) -> None:
        """One scan of the tracker: `Smoother.add`."""
        ...

    def finish(self, note: Callable[[str], None]) -> Smoothed:
        """All of it at its best; `note` is told what is being done."""
        ...


@final
class GraphInProcess:
    """In this process: each scan waits for it."""

    def __init__(self, settings: SmootherSettings, map_T_start: Pose2) -> None:
        self._smoother = Smoother(settings, map_T_start)

    def latest(self) -> Pose2:
        """As `Smoother.latest`."""
        return self._smoother.latest()

    def add(self, step: FastStep, perceptions: Perceptions, views: Sequence[View]) -> None:
        """As `GraphBeside`."""
        self._smoother.add(step, perceptions, views)

    def finish(self, note: Callable[[str], None]) -> Smoothed:
        """As `GraphBeside`."""
        smoother = self._smoother
        smoother.finish(note)
        # The events last: covariances may add one.
        return Smoothed(
            trajectory=smoother.trajectory(),
            covariances=smoother.covariances(),
            landmarks=smoother.landmarks(),
            gone=smoother.gone(),
            associations=smoother.associations(),
            events=smoother.events,
        )
