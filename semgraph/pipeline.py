"""The loop: measurements in, a followed and smoothed run out. It knows all stages, no device."""

import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from semgraph.beside.graph_beside import GraphBeside, GraphInProcess
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastEstimator, FastStep
from semgraph.files.run_log import LogRecorder
from semgraph.files.yaw_rates import YawRateLog
from semgraph.first_motion import tell_first_motion
from semgraph.geometry import Pose2
from semgraph.moments import Moment, moments
from semgraph.navigation_map import NavigationMap
from semgraph.ordering import InOrder
from semgraph.pacing import Pace
from semgraph.perceiving import Perceiver
from semgraph.progress import Report
from semgraph.results import RunResult
from semgraph.settings import Settings
from semgraph.trace import Trace
from semgraph.tracking import tracker_of
from semgraph.tries import Tries
from sensors.measurements import Recording


def run(
    recording: Recording,
    settings: Settings,
    perceiver: Perceiver,
    report: Report,
    effective_settings: dict[str, Any],
    trace: Trace | None = None,
    graph: GraphBeside | None = None,
    pace: Pace | None = None,
) -> RunResult:
    """The trajectories and the map of a recording.

    Args:
        recording: what the estimators may see.
        settings: of the estimators.
        perceiver: for recordings of scans, clouds and images.
        report: told the number of scans done, then what settles.
        effective_settings: kept beside the results.
        trace: told what was shown, for those who look at it afterwards.
        graph: beside the fast estimator; None for one in this process.
        pace: at which the recording is played; None for as fast as it goes.

    Raises:
        InputError: measurements without a detector, or nothing to run on.
        GraphError: the graph cannot be solved, not even from its own log.
    """
    started = time.perf_counter()
    fast = _Fast(FastEstimator(settings.fast, recording.map_T_start))
    tracker = tracker_of(recording, settings.tracker)
    graph = graph or GraphInProcess(settings.smoother, recording.map_T_start)
    recorder = LogRecorder(settings.smoother.start(recording.map_T_start))
    tries = Tries(recording, settings)
    tell_first_motion(recording, perceiver, settings.fast)
    imu, ordered = YawRateLog(), InOrder(recording.measurements)
    for moment in moments(replace(recording, measurements=ordered), perceiver, imu, pace):
        seen, odom_T_base = moment.perceptions, moment.odom_T_base
        step = fast.step(moment)
        perceiver.moved(*fast.last_motion)
        tracked = tracker.step(seen, moment.odometry)
        graph.add(tracked, seen, moment.views)
        recorder.add(tracked, seen, moment.views)
        tries.add(seen, moment.odometry, moment.views)
        if trace is not None:
            trace.add(moment.measurements, seen, odom_T_base, step, fast.navigation_map)
        report.done(len(fast))
    if not len(fast):
        raise InputError(f"{recording.name}: expected scans or perceptions, there are none")
    smoothed, log = graph.finish(report.note), None
    if len(smoothed.trajectory):
        log = recorder.log(smoothed.trajectory, smoothed.associations)
        smoothed, log = tries.best(smoothed, log, report.note)
    return RunResult(
        name=recording.name,
        smoothed=smoothed.trajectory,
        smoothed_covariances=smoothed.covariances,
        fast=fast.trajectory(),
        landmarks=smoothed.landmarks,
        fast_seconds=np.array(fast.seconds),
        wall_seconds=time.perf_counter() - started,
        num_scans=len(fast),
        events=(
            *smoothed.events,
            *perceiver.events,
            *ordered.events,
            *(trace.events if trace else ()),
            *(pace.events if pace else ()),
        ),
        settings=effective_settings,
        fast_landmarks=tuple(fast.navigation_map),
        gone=smoothed.gone,
        imu=imu.yaw_rates(),
        associations=smoothed.associations,
        decisions=smoothed.decisions,
        online=smoothed.online,
        log=log,
    )


@dataclass(slots=True)
class _Fast:
    """The fast estimator, what it said so far, and how long each step took.

    Attributes:
        last_motion: between its last two poses, and the seconds between; 0 s at the start.
    """

    _estimator: FastEstimator
    seconds: list[float] = field(default_factory=list)
    last_motion: tuple[Pose2, float] = (Pose2(), 0.0)
    _stamps_ns: list[int] = field(default_factory=list)
    _poses: list[Pose2] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._stamps_ns)

    @property
    def navigation_map(self) -> NavigationMap:
        """Its own map."""
        return self._estimator.navigation_map

    def step(self, moment: Moment) -> FastStep:
        """The next moment, timed."""
        before = time.perf_counter()
        step = self._estimator.step(moment.perceptions, moment.odometry)
        self.seconds.append(time.perf_counter() - before)
        if self._poses:
            moved = self._poses[-1].between(step.map_T_base.pose)
            self.last_motion = moved, (step.stamp_ns - self._stamps_ns[-1]) * 1e-9
        self._stamps_ns.append(step.stamp_ns)
        self._poses.append(step.map_T_base.pose)
        return step

    def trajectory(self) -> Trajectory:
        """Of all steps."""
        poses = [pose.as_array() for pose in self._poses]
        return Trajectory(np.array(self._stamps_ns), np.array(poses))
