"""The graph beside the fast estimator, wherever it runs."""

from collections.abc import Callable, Sequence
from typing import Protocol, final

from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2
from semgraph.graph.smoother import Smoother, SmootherSettings
from semgraph.landmarks import Perceptions
from semgraph.smoothed import Smoothed
from sensors.views import View


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
            decisions=smoother.decisions,
        )
