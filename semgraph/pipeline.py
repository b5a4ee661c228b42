"""The loop: measurements in, a followed and smoothed run out. It knows all stages, no device."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from detectors.detector import Detector
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastEstimator
from semgraph.geometry import UncertainPose2
from semgraph.landmarks import Perceptions
from semgraph.motion_model import OdometryAccumulator
from semgraph.progress import Report
from semgraph.results import RunResult
from semgraph.settings import Settings
from semgraph.smoother import Smoother
from sensors.measurements import LaserScan, Recording, WheelOdometry

# One moment: what was perceived, and the wheels' motion since the moment before.
Moment = tuple[Perceptions, UncertainPose2 | None]


def run(
    recording: Recording,
    settings: Settings,
    detector: Detector[Any] | None,
    report: Report,
    effective_settings: dict[str, Any],
) -> RunResult:
    """The trajectories and the map of a recording.

    Args:
        recording: what the estimators may see.
        settings: of the estimators.
        detector: for recordings of scans.
        report: told the number of scans done, then what settles.
        effective_settings: kept beside the results.

    Raises:
        InputError: scans without a detector, or nothing to run on.
        GraphError: the graph cannot be solved, not even from its own log.
    """
    started = time.perf_counter()
    fast = FastEstimator(settings.fast, recording.map_T_start)
    tracker = FastEstimator(settings.tracker, recording.map_T_start)
    smoother = Smoother(settings.smoother, recording.map_T_start)
    stamps_ns: list[int] = []
    poses: list[np.ndarray] = []
    fast_seconds: list[float] = []
    for perceptions, odometry in moments(recording, detector):
        before = time.perf_counter()
        step = fast.step(perceptions, odometry)
        fast_seconds.append(time.perf_counter() - before)
        smoother.add(tracker.step(perceptions, odometry), perceptions)
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
        events=smoother.events,
        settings=effective_settings,
        fast_landmarks=tuple(fast.navigation_map),
    )


def moments(recording: Recording, detector: Detector[Any] | None) -> Iterator[Moment]:
    """What the estimators see, scan by scan, relative to base.

    Raises:
        InputError: a scan, and no detector for it.
    """
    noise = recording.odometry_noise
    wheels = OdometryAccumulator(noise) if noise is not None else None
    for measurement in recording.measurements:
        if isinstance(measurement, WheelOdometry) and wheels is not None:
            wheels.add(measurement)
        elif isinstance(measurement, Perceptions | LaserScan):
            perceptions = _perceive(measurement, detector, recording.name)
            yield perceptions, wheels.take() if wheels is not None else None


def _perceive(
    measurement: Perceptions | LaserScan, detector: Detector[Any] | None, name: str
) -> Perceptions:
    if isinstance(measurement, Perceptions):
        return measurement
    if detector is None:
        raise InputError(f"{name}: expected a detector for its scans; name one in recording.toml")
    return detector.detect(measurement).seen_from(measurement.geometry.base_T_laser)
