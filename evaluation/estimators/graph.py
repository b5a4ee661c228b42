"""The graph: online with iSAM2 in this process, and refined offline when the run is over."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evaluation.estimators.driving import Drive, Step, drive
from evaluation.estimators.estimate import Estimate
from semgraph.arrays import FloatArray
from semgraph.beside.graph_beside import GraphInProcess
from semgraph.decisions import What
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastStep
from semgraph.files.run_log import LogRecorder, RunLog
from semgraph.geometry import Pose2
from semgraph.moments import Moment
from semgraph.offline.refining import refine_sessions
from semgraph.progress import Silence
from semgraph.settings import Settings
from semgraph.smoothed import Smoothed
from semgraph.tracking import tracker_of
from sensors.truth import Source

# What the graph is told of a step, by the tracker's pose before it.
Told = Callable[[FastStep, Pose2], FastStep]


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """What the graph made of a source, in time and in the end."""

    drive: Drive
    online: Trajectory
    smoothed: Smoothed
    log: RunLog


def smoothed(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """Path and map by the graph beside the tracker, in the end."""
    del rng
    return smoothed_with(source, settings, lambda step, _: step)


def smoothed_with(source: Source, settings: Settings, told: Told) -> Estimate:
    """The same by a graph that is told something else of each step."""
    run = _smooth(source, settings, told)
    made = run.smoothed
    return Estimate(
        made.trajectory,
        made.covariances,
        made.landmarks,
        made.associations,
        np.array(run.drive.seconds),
        _closed_at_ns(run),
        online=run.online,
        perceptions=tuple(run.drive.perceptions),
    )


def refined(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """Path and map by the batch over the run's log, associations decided anew."""
    del rng
    run = _smooth(source, settings, lambda step, _: step)
    session = (source.recording.name, run.log)
    found = refine_sessions([session], settings.smoother, None, None, Silence().note)
    ends = np.searchsorted(run.log.scans, np.arange(1, len(run.log.trajectory)))
    landmark_ids = np.split(found.refined.belief.landmarks, ends)
    return Estimate(
        found.trajectories[0],
        found.refined.pose_covariances,
        found.refined.landmarks,
        dict(zip(run.drive.stamps_ns, landmark_ids, strict=True)),
        perceptions=tuple(run.drive.perceptions),
    )


def _smooth(source: Source, settings: Settings, told: Told) -> _Run:
    map_T_start = map_T_last = source.recording.map_T_start
    tracker = tracker_of(source.recording, settings.tracker)
    graph = GraphInProcess(settings.smoother, map_T_start)
    recorder, latest = LogRecorder(settings.smoother.start(map_T_start)), list[FloatArray]()

    def step(moment: Moment) -> Step:
        nonlocal map_T_last
        followed = tracker.step(moment.perceptions, moment.odometry)
        tracked = told(followed, map_T_last)
        map_T_last = followed.map_T_base.pose
        graph.add(tracked, moment.perceptions, moment.views)
        recorder.add(tracked, moment.perceptions, moment.views)
        latest.append(graph.latest().as_array())
        return Step(tracked.map_T_base, tracked.landmark_ids)

    said = drive(source, settings, step)
    made = graph.finish(Silence().note)
    if not len(made.trajectory):
        raise InputError(f"{source.recording.name}: the graph came to no path")
    online = Trajectory(np.array(said.stamps_ns, dtype=np.int64), np.array(latest))
    return _Run(said, online, made, recorder.log(made.trajectory, made.associations))


def _closed_at_ns(run: _Run) -> tuple[int, ...]:
    return tuple(
        run.drive.stamps_ns[decision.scan]
        for decision in run.smoothed.decisions
        if decision.what is What.LOOP_CLOSED
    )
