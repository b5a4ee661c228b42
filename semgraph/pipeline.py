"""The loop: measurements in, a followed and smoothed run out. It knows all stages, no device."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastEstimator
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Perceptions, concatenate
from semgraph.motion_model import OdometryAccumulator
from semgraph.perceiving import Perceiver
from semgraph.progress import Report
from semgraph.results import RunResult
from semgraph.settings import Settings
from semgraph.smoother import Smoother
from sensors.measurements import ImuSample, LaserScan, Raw, Recording, WheelOdometry
from sensors.views import View

# One moment: what was perceived, the wheels' motion since the moment before, how far lasers saw.
Moment = tuple[Perceptions, UncertainPose2 | None, tuple[View, ...]]


def run(
    recording: Recording,
    settings: Settings,
    perceiver: Perceiver,
    report: Report,
    effective_settings: dict[str, Any],
) -> RunResult:
    """The trajectories and the map of a recording.

    Args:
        recording: what the estimators may see.
        settings: of the estimators.
        perceiver: for recordings of scans, clouds and images.
        report: told the number of scans done, then what settles.
        effective_settings: kept beside the results.

    Raises:
        InputError: measurements without a detector, or nothing to run on.
        GraphError: the graph cannot be solved, not even from its own log.
    """
    started = time.perf_counter()
    fast = FastEstimator(settings.fast, recording.map_T_start)
    tracker = FastEstimator(settings.tracker, recording.map_T_start)
    smoother = Smoother(settings.smoother, recording.map_T_start)
    stamps_ns: list[int] = []
    poses: list[np.ndarray] = []
    fast_seconds: list[float] = []
    for perceptions, odometry, views in moments(recording, perceiver):
        before = time.perf_counter()
        step = fast.step(perceptions, odometry)
        fast_seconds.append(time.perf_counter() - before)
        if poses:
            moved = Pose2(*poses[-1]).between(step.map_T_base.pose)
            perceiver.moved(moved, (perceptions.stamp_ns - stamps_ns[-1]) * 1e-9)
        smoother.add(tracker.step(perceptions, odometry), perceptions, views)
        stamps_ns.append(perceptions.stamp_ns)
        poses.append(step.map_T_base.pose.as_array())
        report.done(len(stamps_ns))
    if not stamps_ns:
        raise InputError(f"{recording.name}: expected scans or perceptions, there are none")
    smoother.finish(report.note)
    return RunResult(
        name=recording.name,
        smoothed=smoother.trajectory(),
        smoothed_covariances=smoother.covariances(),
        fast=Trajectory(np.array(stamps_ns), np.array(poses)),
        landmarks=smoother.landmarks(),
        fast_seconds=np.array(fast_seconds),
        wall_seconds=time.perf_counter() - started,
        num_scans=len(stamps_ns),
        events=(*smoother.events, *perceiver.events),
        settings=effective_settings,
        fast_landmarks=tuple(fast.navigation_map),
        gone=smoother.gone(),
    )


def moments(recording: Recording, perceiver: Perceiver) -> Iterator[Moment]:
    """What the estimators see, moment by moment, relative to base.

    Raises:
        InputError: a measurement, and no detector for it.
    """
    noise = recording.odometry_noise
    wheels = OdometryAccumulator(noise) if noise is not None else None
    now = _Now()
    for measurement in recording.measurements:
        if now.parts and measurement.stamp_ns != now.parts[0].stamp_ns:
            yield now.take(wheels)
        if isinstance(measurement, WheelOdometry) and wheels is not None:
            wheels.add(measurement)
        elif isinstance(measurement, ImuSample):
            perceiver.lean(measurement)
        elif isinstance(measurement, Perceptions):
            now.parts.append(measurement)
        elif isinstance(measurement, Raw):
            now.parts.append(perceiver.perceive(measurement))
            if isinstance(measurement, LaserScan):
                now.views.append(View.of_scan(measurement))
    if now.parts:
        yield now.take(wheels)


@dataclass(slots=True)
class _Now:
    """What the sensors showed at one time."""

    parts: list[Perceptions] = field(default_factory=list)
    views: list[View] = field(default_factory=list)

    def take(self, wheels: OdometryAccumulator | None) -> Moment:
        """All of it, and the motion up to now."""
        parts, views = self.parts, tuple(self.views)
        self.parts, self.views = [], []
        perceptions = parts[0] if len(parts) == 1 else concatenate(parts[0].stamp_ns, parts)
        return perceptions, wheels.take() if wheels is not None else None, views
