"""The loop of localization in a known map, and what it leaves behind."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastEstimator
from semgraph.files.tables import stamp_text, write_text
from semgraph.files.trajectory_files import write_tum
from semgraph.files.yaw_rates import YawRateLog
from semgraph.first_motion import tell_first_motion
from semgraph.geometry import Pose2
from semgraph.known_map.fixed_map import FixedMap
from semgraph.landmarks import Landmark
from semgraph.localizer import Localized, Localizer, Start, Use
from semgraph.moments import Moment, moments
from semgraph.offline.map_growth import Grown, Stretches
from semgraph.offline.refining import REPORT_CSV, write_changes
from semgraph.ordering import InOrder
from semgraph.perceiving import Perceiver
from semgraph.progress import Report
from semgraph.results import RunResult, write_files
from semgraph.settings import Settings
from sensors.measurements import Recording

QUALITY_CSV: Final = "quality.csv"
TRAJECTORY_PARTICLES_TUM: Final = "trajectory_particles.tum"
TRAJECTORY_LOCALIZED_TUM: Final = "trajectory_localized.tum"
QUALITY_COLUMNS: Final = ("stamp_s", "quality", "estimator", "particles")
# The fast estimator alone begins where the localizer is sure for the first time.
_SURE: Final = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class LocalizationResult:
    """What came out of a localization.

    Attributes:
        run: in the form of a run: `smoothed` is the combination's trajectory, `fast` that of the
            fast estimator alone, begun once at a sure pose; `landmarks` is the given map.
        localized: each pose of the combination.
        particles: the trajectory of the particle filter alone.
        particle_qualities: (n,) of its poses.
        grown: the run and its map together, if that was asked for and the robot was held.
    """

    run: RunResult
    localized: tuple[Localized, ...]
    particles: Trajectory
    particle_qualities: FloatArray
    grown: Grown | None = None

    def with_grown(self, grown: Grown) -> "LocalizationResult":
        """The same with the grown map, and the poses at its optimum where there are any."""
        rows = np.searchsorted(self.run.smoothed.stamps_ns, grown.trajectory.stamps_ns)
        poses = np.array(self.run.smoothed.map_T_bases)
        covariances = np.array(self.run.smoothed_covariances)
        poses[rows], covariances[rows] = grown.trajectory.map_T_bases, grown.covariances
        run = replace(
            self.run,
            smoothed=Trajectory(self.run.smoothed.stamps_ns, poses),
            smoothed_covariances=covariances,
            landmarks=grown.landmarks,
        )
        return replace(self, run=run, grown=grown)


def localize(
    recording: Recording,
    landmarks: tuple[Landmark, ...],
    start: Start,
    settings: Settings,
    perceiver: Perceiver,
    report: Report,
    effective_settings: dict[str, Any],
    stretches: Stretches | None = None,
) -> LocalizationResult:
    """Where the robot was in a given map, by both estimators together and by each alone.

    Args:
        recording: what the estimators may see.
        landmarks: of the map, which stays as it is.
        start: where the robot may be at first.
        settings: of the estimators.
        perceiver: for recordings of scans, clouds and images.
        report: told the number of scans done.
        effective_settings: kept beside the results.
        stretches: gathers what the map may grow by.

    Raises:
        InputError: measurements without a detector, nothing to run on, or an empty map.
    """
    started = time.perf_counter()
    three = _Three(FixedMap.of_landmarks(landmarks), settings, start)
    imu, ordered = YawRateLog(), InOrder(recording.measurements)
    tell_first_motion(recording, perceiver, settings.fast)
    for moment in moments(replace(recording, measurements=ordered), perceiver, imu):
        three.step(moment)
        if stretches is not None:
            found = three.localized[-1]
            stretches.add(moment.perceptions, moment.odometry, moment.views, found)
        perceiver.moved(*three.last_motion())
        report.done(len(three.localized))
    if not three.localized:
        raise InputError(f"{recording.name}: expected scans or perceptions, there are none")
    together = _trajectory(three.localized)
    run = RunResult(
        name=recording.name,
        smoothed=together,
        smoothed_covariances=np.array([each.map_T_base.covariance for each in three.localized]),
        fast=three.fast_trajectory(),
        landmarks=landmarks,
        fast_seconds=np.array(three.seconds),
        wall_seconds=time.perf_counter() - started,
        num_scans=len(together),
        events=(*three.localizer.events, *perceiver.events, *ordered.events),
        settings=effective_settings,
        imu=imu.yaw_rates(),
    )
    return LocalizationResult(
        run,
        tuple(three.localized),
        _trajectory(three.by_particles),
        np.array([each.quality for each in three.by_particles]),
    )


def write_localization(result: LocalizationResult, folder: Path) -> None:
    """Writes a run's files, and quality.csv and trajectory_particles.tum beside them.

    Of a grown map also report.csv, and where the robot was believed to be before.

    Raises:
        SemgraphError: a file cannot be written, or the settings are nothing that TOML can hold.
    """
    write_files(result.run, folder)
    write_tum(folder / TRAJECTORY_PARTICLES_TUM, result.particles)
    if result.grown is not None:
        write_tum(folder / TRAJECTORY_LOCALIZED_TUM, _trajectory(result.localized))
        write_changes(folder / REPORT_CSV, result.grown.changes)
    lines = [",".join(QUALITY_COLUMNS)]
    lines += [
        f"{stamp_text(each.stamp_ns)},{each.quality!r},{each.estimator.value},{each.num_particles}"
        for each in result.localized
    ]
    write_text(folder / QUALITY_CSV, "\n".join(lines) + "\n")


class _Three:
    """The combination, the particle filter alone, and the fast estimator alone."""

    def __init__(self, fixed_map: FixedMap, settings: Settings, start: Start) -> None:
        chosen = settings.localizer
        alone = chosen.model_copy(update={"use": Use.PARTICLES})
        self.localizer = Localizer(fixed_map, chosen, start)
        self.localized: list[Localized] = []
        self.by_particles: list[Localized] = []
        self.seconds: list[float] = []
        self._particles = Localizer(fixed_map, alone, start)
        self._fast = FastEstimator(chosen.fast, Pose2(), fixed_map.navigation_map())
        self._fast_stamps_ns: list[int] = []
        self._fast_poses: list[FloatArray] = []

    def step(self, moment: Moment) -> None:
        """The next moment for all three; the combination is timed."""
        before = time.perf_counter()
        found = self.localizer.step(moment.perceptions, moment.odometry)
        self.seconds.append(time.perf_counter() - before)
        self.localized.append(found)
        self.by_particles.append(self._particles.step(moment.perceptions, moment.odometry))
        self._step_fast(moment, found)

    def _step_fast(self, moment: Moment, found: Localized) -> None:
        if self._fast_poses:
            pose = self._fast.step(moment.perceptions, moment.odometry).map_T_base.pose
        elif found.quality >= _SURE:
            self._fast.restart(found.map_T_base, found.stamp_ns)
            pose = found.map_T_base.pose
        else:
            return
        self._fast_stamps_ns.append(found.stamp_ns)
        self._fast_poses.append(pose.as_array())

    def last_motion(self) -> tuple[Pose2, float]:
        """Between the last two poses, and the seconds; none where one of them is unsure."""
        last = self.localized[-2:]
        if len(last) < 2 or min(each.quality for each in last) < _SURE:
            return Pose2(), 0.0
        one, other = last
        moved = one.map_T_base.pose.between(other.map_T_base.pose)
        return moved, (other.stamp_ns - one.stamp_ns) * 1e-9

    def fast_trajectory(self) -> Trajectory:
        """Of the fast estimator alone, from where it began."""
        poses = np.array(self._fast_poses).reshape(-1, 3)
        return Trajectory(np.array(self._fast_stamps_ns, dtype=np.int64), poses)


def _trajectory(localized: Sequence[Localized]) -> Trajectory:
    return Trajectory(
        np.array([each.stamp_ns for each in localized], dtype=np.int64),
        np.array([each.map_T_base.pose.as_array() for each in localized]),
    )
