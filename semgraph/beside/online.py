"""The graph beside the fast estimator in a process of its own, so that no scan waits for it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic
from types import TracebackType
from typing import Final, Self, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.beside.smoothing_loop import Doing, End, Failed, Job, Scan, Taken
from semgraph.beside.spool import Spool
from semgraph.beside.worker import Worker, ended_by
from semgraph.errors import SemgraphError
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Perceptions
from semgraph.smoothed import Online, Smoothed
from sensors.views import View

_LOOK_S: Final = 0.05


class OnlineSettings(BaseModel):
    """Settings of the graph's process, which `--online` starts.

    Attributes:
        stall_s: after so long without a sign of life it is started anew.
        settle_s: the same in the end, where single computations take long.
        max_restarts: then it is given up, and the run goes on without.
        niceness: how far it steps back for the scan path.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    stall_s: float = Field(60.0, gt=0.0)
    settle_s: float = Field(1800.0, gt=0.0)
    max_restarts: int = Field(3, ge=0)
    niceness: int = Field(10, ge=0, le=19)


@final
class OnlineSmoother:
    """Hands scans to a Smoother in another process, and corrects the tracker's pose by its answers.

    The tracker's frame is odom: it drifts but never jumps. What the graph finds out moves
    `map_T_odom` alone, and `map_T_base = map_T_odom @ odom_T_base`.

    When the graph falls behind, the policy is *late rather than left out*: scans wait in the spool,
    which is on disk, and are taken in one by one, in order, in the Smoother's own steps. So what
    comes out in the end does not depend on how quick the machine was, nor on whether the process
    died in between: it is started anew, works through the spool from its start, and gets to the
    same bits. How far behind it was is in the results.

    A context: on leaving, the process is ended and the spool is gone.
    """

    def __init__(
        self, smoother: SmootherSettings, settings: OnlineSettings, map_T_start: Pose2
    ) -> None:
        self._settings = settings
        self._scans = Spool()
        self._scans.append(Job(smoother, map_T_start))
        self._known = _Known()
        self._events: list[str] = []
        self._num_restarts = 0
        self._has_ended = False
        self._doing = ""
        self._outcome: Smoothed | None = None
        self._worker: Worker | None = Worker(self._scans, settings.niceness)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._end_worker()
        self._scans.close()

    @property
    def map_T_base(self) -> Pose2:
        """Of the last scan, by what is known now."""
        return self._known.map_T_base

    @property
    def num_behind(self) -> int:
        """How many scans are not in the graph yet."""
        return self._known.num_behind

    @property
    def worker_pid(self) -> int | None:
        """Of the graph's process; None if it was given up or has done all."""
        return None if self._worker is None else self._worker.pid

    def add(self, step: FastStep, perceptions: Perceptions, views: Sequence[View]) -> None:
        """As `GraphBeside`; returns without waiting, whatever the other process does."""
        self._append(Scan(step, perceptions, tuple(views)))
        self._known.append(step)
        self.tend()
        self._known.report()

    def tend(self) -> None:
        """Takes in what the other process said, and sees to it that there is one.

        `add` does so too; who wants the latest pose between two scans calls it.
        """
        worker = self._worker
        if worker is None:
            return
        # First whether it has ended: what it said before is then there whole.
        exit_code = worker.exit_code()
        try:
            while self._worker is worker and (answer := worker.answer()) is not None:
                self._take(answer)
        except SemgraphError as error:
            self._restart(str(error))
        if self._worker is worker:
            self._look_after(worker, exit_code)

    def finish(self, note: Callable[[str], None]) -> Smoothed:
        """As `GraphBeside`; without a graph where it was lost, and `online.lost` says why."""
        self._has_ended = True
        self._append(End())
        while self._worker is not None:
            self._worker.wait(_LOOK_S)
            self.tend()
            note(self._known.outlook() or f"graph: {self._doing or 'settling'}")
        outcome = self._outcome or Smoothed()
        online = self._known.online(self._num_restarts)
        events = (*outcome.events, *self._events, online.summary)
        return replace(outcome, events=events, online=online)

    def _append(self, entry: Scan | End) -> None:
        if self._worker is None:
            return
        try:
            self._scans.append(entry)
        except SemgraphError as error:
            self._lose(str(error))

    def _look_after(self, worker: Worker, exit_code: int | None) -> None:
        is_settling = self._has_ended and not self._known.num_behind
        patience_s = self._settings.settle_s if is_settling else self._settings.stall_s
        if exit_code is not None:
            self._restart(ended_by(exit_code))
        elif worker.silent_s() > patience_s:
            self._restart(f"no sign of life for {patience_s:g} s")

    def _take(self, answer: Taken | Doing | Failed | Smoothed) -> None:
        match answer:
            case Taken():
                self._known.take(answer)
            case Doing(text):
                self._doing = text
            case Failed(reason, is_final):
                self._lose(reason) if is_final else self._restart(reason)
            case Smoothed():
                self._outcome = answer
                self._end_worker()

    def _restart(self, reason: str) -> None:
        """A new process; it works through the spool from its start."""
        self._end_worker()
        if self._num_restarts == self._settings.max_restarts:
            self._lose(f"{reason}, after {self._num_restarts} restarts (online.max_restarts)")
            return
        self._num_restarts += 1
        self._events.append(f"graph's process started anew {self._known.when}: {reason}")
        try:
            self._worker = Worker(self._scans, self._settings.niceness)
        except SemgraphError as error:
            self._lose(str(error))

    def _lose(self, reason: str) -> None:
        """The run goes on without the graph."""
        self._end_worker()
        self._known.lost = reason
        self._events.append(f"graph given up {self._known.when}: {reason}")

    def _end_worker(self) -> None:
        if self._worker is not None:
            self._worker.end()
            self._worker = None


@dataclass(slots=True)
class _Known:
    """What the scan path knows of the graph.

    Attributes:
        lost: why there is no graph any more.
    """

    lost: str = ""
    _map_T_odom: Pose2 = field(default_factory=Pose2)
    _odom_T_base: Pose2 = field(default_factory=Pose2)
    _num_taken: int = 0
    _appended_s: list[float] = field(default_factory=list)
    _stamps_ns: list[int] = field(default_factory=list)
    _poses: list[Pose2] = field(default_factory=list)
    _lags: list[int] = field(default_factory=list)
    _delays_s: list[float] = field(default_factory=list)

    @property
    def map_T_base(self) -> Pose2:
        return self._map_T_odom @ self._odom_T_base

    @property
    def num_behind(self) -> int:
        return len(self._stamps_ns) - self._num_taken

    @property
    def when(self) -> str:
        return f"at scan {len(self._stamps_ns) - 1}, {self.num_behind} scans behind"

    def append(self, step: FastStep) -> None:
        """A scan that was handed over."""
        self._appended_s.append(monotonic())
        self._stamps_ns.append(step.stamp_ns)
        self._odom_T_base = step.map_T_base.pose

    def take(self, taken: Taken) -> None:
        """A correction, unless it is an old one of the log replayed."""
        if taken.scan >= self._num_taken:
            self._num_taken = taken.scan + 1
            self._map_T_odom = taken.map_T_odom
            self._delays_s.append(monotonic() - self._appended_s[taken.scan])

    def report(self) -> None:
        """What is said of the last scan, now."""
        self._poses.append(self.map_T_base)
        self._lags.append(self.num_behind)

    def outlook(self) -> str:
        """How long the graph still needs for what it has not taken in; empty if it has all."""
        if not self.num_behind or not self._num_taken:
            return ""
        rate = self._num_taken / (monotonic() - self._appended_s[0])
        left_s = self.num_behind / rate
        return f"graph {self.num_behind} scans behind, {rate:.3g}/s, {left_s:.0f} s left"

    def online(self, num_restarts: int) -> Online:
        poses = np.array([pose.as_array() for pose in self._poses]).reshape(-1, 3)
        return Online(
            Trajectory(np.array(self._stamps_ns, dtype=np.int64), poses),
            np.array(self._delays_s),
            np.array(self._lags, dtype=np.int64),
            num_restarts,
            self.lost,
        )
