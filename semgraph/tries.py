"""Many hypotheses followed several times: the most probable outcome is kept."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from semgraph.beside.graph_beside import GraphInProcess
from semgraph.estimates import Trajectory
from semgraph.files.run_log import LogRecorder, RunLog
from semgraph.geometry import UncertainPose2
from semgraph.landmarks import Perceptions
from semgraph.offline.refinement import refined
from semgraph.offline.resighting import Resighted, resighted
from semgraph.settings import Settings
from semgraph.smoothed import Smoothed
from semgraph.tracking import num_hypotheses, tracker_of
from sensors.measurements import Recording
from sensors.views import View


class Tries(Protocol):
    """It keeps what trackers are shown, and makes the most of it in the end."""

    def add(
        self, seen: Perceptions, odometry: UncertainPose2 | None, views: Sequence[View]
    ) -> None:
        """What the tracker was shown, and the graph with it."""
        ...

    def best(
        self, smoothed: Smoothed, log: RunLog, note: Callable[[str], None]
    ) -> tuple[Smoothed, RunLog]:
        """The best outcome, of which the one of the run itself is the first."""
        ...


def tries_of(recording: Recording, settings: Settings) -> Tries:
    """Several with many hypotheses; with one there is nothing to try again."""
    if num_hypotheses(recording, settings.tracker) == 1:
        return _Once()
    return _Several(recording, settings)


class _Once:
    def add(
        self, seen: Perceptions, odometry: UncertainPose2 | None, views: Sequence[View]
    ) -> None:
        """Nothing is kept."""

    def best(
        self, smoothed: Smoothed, log: RunLog, note: Callable[[str], None]
    ) -> tuple[Smoothed, RunLog]:
        """As it is."""
        del note
        return smoothed, log


@dataclass(frozen=True, slots=True)
class _Several:
    _recording: Recording
    _settings: Settings
    _shown: list[tuple[Perceptions, UncertainPose2 | None, tuple[View, ...]]] = field(
        default_factory=list
    )

    def add(
        self, seen: Perceptions, odometry: UncertainPose2 | None, views: Sequence[View]
    ) -> None:
        """Keeps it."""
        self._shown.append((seen, odometry, tuple(views)))

    def best(
        self, smoothed: Smoothed, log: RunLog, note: Callable[[str], None]
    ) -> tuple[Smoothed, RunLog]:
        """Each outcome with its perceptions taken for landmarks anew; the most probable one.

        Raises:
            GraphError: a graph cannot be solved.
        """
        kept, least = (smoothed, log, resighted(log, self._settings.smoother, note)), 1
        for number in range(1, self._settings.tracker.tries):
            note(f"try {number + 1} of {self._settings.tracker.tries}")
            again = self._again(number)
            if again is None:
                continue
            found = resighted(again[1], self._settings.smoother, note)
            if found.misfit < kept[2].misfit:
                kept, least = (*again, found), number + 1
        told = f"try {least} of {self._settings.tracker.tries} is the most probable"
        best, its_log, found = kept
        outcome = _as_smoothed(best, found, self._settings)
        events = (*outcome.events, told) if self._settings.tracker.tries > 1 else outcome.events
        return (
            replace(outcome, events=events, online=smoothed.online),
            replace(its_log, trajectory=outcome.trajectory, landmarks=found.belief.landmarks),
        )

    def _again(self, number: int) -> tuple[Smoothed, RunLog] | None:
        """The same with other random numbers; None where nothing came of it."""
        seed = self._settings.tracker.seed + number
        tracker = tracker_of(
            self._recording, self._settings.tracker.model_copy(update={"seed": seed})
        )
        start = self._recording.map_T_start
        graph = GraphInProcess(self._settings.smoother, start)
        recorder = LogRecorder(self._settings.smoother.start(start))
        for seen, odometry, views in self._shown:
            step = tracker.step(seen, odometry)
            graph.add(step, seen, views)
            recorder.add(step, seen, views)
        smoothed = graph.finish(lambda _: None)
        if not len(smoothed.trajectory):
            return None
        return smoothed, recorder.log(smoothed.trajectory, smoothed.associations)


def _as_smoothed(smoothed: Smoothed, found: Resighted, settings: Settings) -> Smoothed:
    """What the graph said, with the path, the map and the associations found since."""
    result = refined(found.batch, found.belief, settings.smoother, found.changes)
    stamps_ns = found.batch.stamps_ns
    ends = np.searchsorted(found.batch.scans, np.arange(1, len(stamps_ns)))
    taken_for = np.split(found.belief.landmarks, ends)
    return replace(
        smoothed,
        trajectory=Trajectory(stamps_ns, found.belief.map_T_bases),
        covariances=result.pose_covariances,
        landmarks=result.landmarks,
        associations=dict(zip(stamps_ns.tolist(), taken_for, strict=True)),
    )
