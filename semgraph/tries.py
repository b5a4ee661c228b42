"""Many hypotheses followed several times: the most probable outcome is kept."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, final

import numpy as np

from semgraph.beside.graph_beside import GraphInProcess
from semgraph.errors import GraphError
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

# How often a try says how far it is.
_SCANS_A_NOTE: Final = 50


@final
class Tries:
    """It keeps what trackers of many hypotheses are shown, and makes the most of it in the end.

    With one hypothesis there is nothing to try again: it keeps and changes nothing.
    """

    def __init__(self, recording: Recording, settings: Settings) -> None:
        self._recording, self._settings = recording, settings
        self._count = settings.tracker.tries
        if num_hypotheses(recording, settings.tracker) == 1:
            self._count = 0
        self._shown: list[tuple[Perceptions, UncertainPose2 | None, tuple[View, ...]]] = []

    def add(
        self, seen: Perceptions, odometry: UncertainPose2 | None, views: Sequence[View]
    ) -> None:
        """What the tracker was shown, and the graph with it."""
        if self._count:
            self._shown.append((seen, odometry, tuple(views)))

    def best(
        self, smoothed: Smoothed, log: RunLog, note: Callable[[str], None]
    ) -> tuple[Smoothed, RunLog]:
        """Each outcome with its perceptions taken for landmarks anew; the most probable one.

        That of the run itself is the first; what came to nothing is said among its events.
        """
        if not self._count:
            return smoothed, log
        found: list[tuple[int, Smoothed, RunLog, Resighted]] = []
        told, count = list[str](), self._count
        started = time.monotonic()
        for number in range(count):
            done = partial(_tell, note, started, number, count)
            try:
                outcome = self._again(number, done) if number else (smoothed, log)
                resight = resighted(outcome[1], self._settings.smoother, note)
                found.append((number, *outcome, resight))
            except GraphError as error:
                told.append(f"try {number + 1} of {count} came to nothing: {error}")
        if not found:
            return replace(smoothed, events=(*smoothed.events, *told)), log
        number, its_smoothed, its_log, resight = min(found, key=lambda each: each[-1].misfit)
        if count > 1:
            told.append(f"try {number + 1} of {count} is the most probable")
        best = _as_smoothed(its_smoothed, resight, self._settings)
        return (
            replace(best, events=(*best.events, *told), online=smoothed.online),
            replace(its_log, trajectory=best.trajectory, landmarks=resight.belief.landmarks),
        )

    def _again(self, number: int, done: Callable[[float], None]) -> tuple[Smoothed, RunLog]:
        """The same with other random numbers.

        Args:
            number: of the try, from 1 on.
            done: told what share of it is.

        Raises:
            GraphError: nothing came of it.
        """
        seed = self._settings.tracker.seed + number
        tracker = tracker_of(
            self._recording, self._settings.tracker.model_copy(update={"seed": seed})
        )
        start = self._recording.map_T_start
        graph = GraphInProcess(self._settings.smoother, start)
        recorder = LogRecorder(self._settings.smoother.start(start))
        for scan, (seen, odometry, views) in enumerate(self._shown):
            if scan % _SCANS_A_NOTE == 0:
                done(scan / len(self._shown))
            step = tracker.step(seen, odometry)
            graph.add(step, seen, views)
            recorder.add(step, seen, views)
        smoothed = graph.finish(lambda _: None)
        if not len(smoothed.trajectory):
            raise GraphError("the graph was given up")
        return smoothed, recorder.log(smoothed.trajectory, smoothed.associations)


def _tell(
    note: Callable[[str], None], started_s: float, number: int, count: int, share: float
) -> None:
    """How far a try is, and how long all of them take yet at that pace."""
    done = (number + share) / count
    left_s = (time.monotonic() - started_s) * (1.0 - done) / done
    note(f"try {number + 1} of {count}, {share:.0%}, {left_s:.0f} s left")


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
