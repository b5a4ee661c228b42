"""What a run leaves behind: written whole or not at all, and read again."""

import copy
import json
import tomllib
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import tomli_w
from pydantic import BaseModel

from semgraph.arrays import FloatArray, IntArray, frozen_floats
from semgraph.decisions import Decision
from semgraph.errors import InputError, SettingsError
from semgraph.estimates import Trajectory
from semgraph.files.decision_files import read_decisions, write_decisions
from semgraph.files.json_files import STRICT, read_json
from semgraph.files.map_files import read_map_json, write_map_csv, write_map_json
from semgraph.files.run_log import LOG_NPZ, RunLog, write_log
from semgraph.files.staging import staged_folder
from semgraph.files.tables import read_text, write_text
from semgraph.files.trajectory_files import read_covariances, read_tum, write_covariances, write_tum
from semgraph.files.yaw_rates import YawRates, read_yaw_rates, write_yaw_rates
from semgraph.landmarks import Gone, Landmark
from semgraph.smoothed import Online

RUN_JSON = "run.json"
TRAJECTORY_TUM = "trajectory.tum"
TRAJECTORY_FAST_TUM = "trajectory_fast.tum"
TRAJECTORY_ONLINE_TUM = "trajectory_online.tum"
TRAJECTORY_COVARIANCE_CSV = "trajectory_covariance.csv"
MAP_JSON = "map.json"
MAP_CSV = "map.csv"
MAP_FAST_JSON = "map_fast.json"
SETTINGS_TOML = "settings.toml"
EVENTS_LOG = "events.log"
DECISIONS_CSV = "decisions.csv"
IMU_CSV = "imu.csv"

# How an event begins that tells of a loop closure; evaluation counts them.
LOOP_CLOSED = "loop closed"


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """What came out of a run.

    Attributes:
        name: of the recording.
        smoothed: the graph's trajectory.
        smoothed_covariances: (n, 3, 3) of its poses, each in its own body frame; NaN throughout
            where unknown.
        fast: the fast estimator's trajectory.
        landmarks: the confirmed map.
        fast_seconds: (k,) how long the fast estimator took for each scan.
        wall_seconds: how long the run took.
        num_scans: how many scans or perceptions were taken in.
        events: decisions worth telling (loop closures, rebuilds), each made one line.
        settings: the effective ones, nested, as TOML can hold them.
        fast_landmarks: the fast estimator's own map.
        gone: what was in the map and is no longer there.
        imu: the yaw rates that an inertial sensor measured; none where there was none.
        associations: by the stamp of perceptions, the landmark of each (n,), -1 for none; of a
            run just made, no file keeps them.
        decisions: of landmarks, in order; also among the events.
        online: what was known of the graph in time; None of a run whose graph was not beside it.
        log: what was measured; of a run just made, `run_log.read_log` reads it again.

    Raises:
        InputError: shapes disagree, or a value is out of its domain.
    """

    name: str
    smoothed: Trajectory
    smoothed_covariances: FloatArray
    fast: Trajectory
    landmarks: tuple[Landmark, ...]
    fast_seconds: FloatArray
    wall_seconds: float
    num_scans: int
    events: tuple[str, ...] = ()
    decisions: tuple[Decision, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)
    fast_landmarks: tuple[Landmark, ...] = ()
    gone: tuple[Gone, ...] = ()
    imu: YawRates = field(default_factory=YawRates)
    associations: Mapping[int, IntArray] = field(default_factory=dict)
    online: Online | None = None
    log: RunLog | None = None

    def __post_init__(self) -> None:
        covariances = _frozen_covariances(self.smoothed_covariances, len(self.smoothed))
        object.__setattr__(self, "smoothed_covariances", covariances)
        seconds = frozen_floats("fast seconds", self.fast_seconds, (None,))
        object.__setattr__(self, "fast_seconds", seconds)
        if not (seconds >= 0.0).all() or not 0.0 <= self.wall_seconds < np.inf:
            raise InputError("run: expected durations of at least 0 s")
        if self.num_scans < 0:
            raise InputError(f"run: expected a number of scans, got {self.num_scans}")
        object.__setattr__(self, "events", tuple(" ".join(event.split()) for event in self.events))
        object.__setattr__(self, "settings", copy.deepcopy(self.settings))


class _Online(BaseModel):
    model_config = STRICT
    num_poses: int
    num_restarts: int
    lost: str
    delays_s: list[float]
    lags: list[int]

    @classmethod
    def of(cls, online: Online) -> Self:
        return cls(
            num_poses=len(online.trajectory),
            num_restarts=online.num_restarts,
            lost=online.lost,
            delays_s=online.delays_s.tolist(),
            lags=online.lags.tolist(),
        )

    def read(self, folder: Path) -> Online:
        path = folder / TRAJECTORY_ONLINE_TUM
        trajectory = read_tum(path)
        _check_count(path, self.num_poses, len(trajectory))
        delays_s, lags = np.array(self.delays_s, dtype=float), np.array(self.lags, dtype=np.int64)
        return Online(trajectory, delays_s, lags, self.num_restarts, self.lost)


class _Run(BaseModel):
    model_config = STRICT
    name: str
    num_scans: int
    num_poses: int
    num_fast_poses: int
    num_landmarks: int
    num_yaw_rates: int = 0
    wall_seconds: float
    fast_seconds: list[float]
    online: _Online | None = None


def write(result: RunResult, folder: Path) -> None:
    """Writes a run's files into a new, an empty, or an earlier run's folder; all or none.

    Raises:
        SemgraphError: the folder cannot be written, or holds something else.
    """
    with staged_results(folder) as staging:
        write_files(result, staging)


def staged_results(folder: Path) -> AbstractContextManager[Path]:
    """A fresh folder that becomes `folder` when the block ends well: `staging.staged_folder`."""
    return staged_folder(folder, RUN_JSON)


def write_files(result: RunResult, folder: Path) -> None:
    """Writes a run's files into a folder that is there.

    Raises:
        SemgraphError: a file cannot be written, or the settings are nothing that TOML can hold.
    """
    write_tum(folder / TRAJECTORY_TUM, result.smoothed)
    write_covariances(
        folder / TRAJECTORY_COVARIANCE_CSV, result.smoothed, result.smoothed_covariances
    )
    write_tum(folder / TRAJECTORY_FAST_TUM, result.fast)
    write_map_json(folder / MAP_JSON, result.landmarks)
    write_map_csv(folder / MAP_CSV, result.landmarks)
    write_map_json(folder / MAP_FAST_JSON, result.fast_landmarks)
    write_settings(folder, result.settings)
    write_decisions(folder / DECISIONS_CSV, result.decisions)
    write_text(folder / EVENTS_LOG, "".join(f"{event}\n" for event in result.events))
    if result.log is not None:
        write_log(folder / LOG_NPZ, result.log)
    if len(result.imu):
        write_yaw_rates(folder / IMU_CSV, result.imu)
    if result.online is not None:
        write_tum(folder / TRAJECTORY_ONLINE_TUM, result.online.trajectory)
    run = _Run(
        name=result.name,
        num_scans=int(result.num_scans),
        num_poses=len(result.smoothed),
        num_fast_poses=len(result.fast),
        num_landmarks=len(result.landmarks),
        num_yaw_rates=len(result.imu),
        wall_seconds=float(result.wall_seconds),
        fast_seconds=result.fast_seconds.tolist(),
        online=_Online.of(result.online) if result.online is not None else None,
    )
    write_text(folder / RUN_JSON, json.dumps(run.model_dump(exclude_none=True), indent=1) + "\n")


def read(folder: Path) -> RunResult:
    """A run's result, from its files.

    Raises:
        InputError: a file is missing, cut short or malformed.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected the folder of a run, there is none")
    run = read_json(folder / RUN_JSON, _Run)
    smoothed = read_tum(folder / TRAJECTORY_TUM)
    fast = read_tum(folder / TRAJECTORY_FAST_TUM)
    landmarks = read_map_json(folder / MAP_JSON)
    imu = read_yaw_rates(folder / IMU_CSV) if run.num_yaw_rates else YawRates()
    for name, promised, count in (
        (TRAJECTORY_TUM, run.num_poses, len(smoothed)),
        (TRAJECTORY_FAST_TUM, run.num_fast_poses, len(fast)),
        (MAP_JSON, run.num_landmarks, len(landmarks)),
        (IMU_CSV, run.num_yaw_rates, len(imu)),
    ):
        _check_count(folder / name, promised, count)
    try:
        return RunResult(
            name=run.name,
            smoothed=smoothed,
            smoothed_covariances=read_covariances(folder / TRAJECTORY_COVARIANCE_CSV, smoothed),
            fast=fast,
            landmarks=landmarks,
            fast_seconds=np.array(run.fast_seconds, dtype=np.float64),
            wall_seconds=run.wall_seconds,
            num_scans=run.num_scans,
            events=tuple(read_text(folder / EVENTS_LOG).splitlines()),
            decisions=read_decisions(folder / DECISIONS_CSV),
            settings=read_toml(folder / SETTINGS_TOML),
            fast_landmarks=read_map_json(folder / MAP_FAST_JSON),
            imu=imu,
            online=run.online.read(folder) if run.online is not None else None,
        )
    except InputError as error:
        raise InputError(error if str(folder) in str(error) else f"{folder}: {error}") from error


def _check_count(path: Path, promised: int, count: int) -> None:
    if promised != count:
        raise InputError(f"{path}: expected {promised} entries as {RUN_JSON} says, got {count}")


def write_settings(folder: Path, settings: dict[str, Any]) -> None:
    """Writes settings.toml.

    Raises:
        SettingsError: they are nothing that TOML can hold.
        SemgraphError: the file cannot be written.
    """
    write_text(folder / SETTINGS_TOML, _settings_text(settings))


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file's tables.

    Raises:
        InputError: missing or malformed.
    """
    try:
        return tomllib.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected TOML: {error}") from error


def _settings_text(settings: dict[str, Any]) -> str:
    try:
        return tomli_w.dumps(settings)
    except (TypeError, ValueError) as error:
        raise SettingsError(f"settings: expected what TOML can hold: {error}") from error


def _frozen_covariances(values: FloatArray, num_poses: int) -> FloatArray:
    covariances = frozen_floats("smoothed covariances", values, (num_poses, 3, 3), finite=False)
    unknown = np.isnan(covariances).all(axis=(1, 2))
    known = covariances[~unknown]
    if not np.isfinite(known).all():
        raise InputError("smoothed covariances: expected finite matrices, or NaN throughout")
    scales = np.abs(known).max(axis=(1, 2), initial=0.0)[:, None, None]
    transposed = known.transpose(0, 2, 1)
    if not (np.abs(known - transposed) <= 1e-6 * scales).all():
        raise InputError("smoothed covariances: expected symmetric matrices")
    symmetric = np.array(covariances)
    symmetric[~unknown] = 0.5 * (known + transposed)
    symmetric.flags.writeable = False
    return symmetric
