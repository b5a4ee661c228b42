"""What was measured in a run, as numbers: all that a batch needs, in `log.npz`."""

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError, SemgraphError
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Perceptions, concatenate
from sensors.npz_files import load_npz
from sensors.views import View

if TYPE_CHECKING:
    from semgraph.fast_estimator import FastStep

LOG_NPZ: Final = "log.npz"
# Looks from places nearer than this are one look.
_LOOKS_APART_M: Final = 0.3
_SEEN: Final = (
    *("kinds", "ranges_m", "bearings", "covariances", "diameters_m", "diameter_sigmas_m"),
    "reliabilities",
)
# Earlier logs have none.
_COMMON_SHARES: Final = "common_shares"
_VIEWS: Final = ("view_scans", "view_sensors", "view_beams", "view_num_beams", "view_clear_m")
_ARRAYS: Final = (
    *("stamps_ns", "map_T_bases", "start", "start_covariance", "motions", "motion_covariances"),
    *("scans", "landmarks", *_SEEN, "identities", "identity_names", *_VIEWS),
)


@dataclass(frozen=True, slots=True, eq=False)
class RunLog:
    """All measurements of a run, and what they were taken for.

    Attributes:
        trajectory: the run's own estimate, a pose at each scan.
        start: map_T_start, before the first motion.
        motions: (n, 3) last_T_current; the first leads from the start to scan 0.
        motion_covariances: (n, 3, 3), each in the frame at its end.
        seen: the perceptions of all scans, one after the other; its stamp says nothing.
        scans: (m,) of each perception, in order.
        landmarks: (m,) that each was taken for, -1 for none.
        views: how far lasers saw, with the scan, one every 0.3 m driven.

    Raises:
        InputError: shapes disagree, or a value is out of its domain.
    """

    trajectory: Trajectory
    start: UncertainPose2
    motions: FloatArray
    motion_covariances: FloatArray
    seen: Perceptions
    scans: IntArray
    landmarks: IntArray
    views: tuple[tuple[int, View], ...] = ()

    def __post_init__(self) -> None:
        n, m = len(self.trajectory), len(self.seen)
        for name, shape in (("motions", (n, 3)), ("motion_covariances", (n, 3, 3))):
            object.__setattr__(self, name, frozen_floats(name, getattr(self, name), shape))
        for name in ("scans", "landmarks"):
            object.__setattr__(self, name, frozen_ints(name, getattr(self, name), (m,)))
        if n == 0:
            raise InputError("log: expected scans, there are none")
        if not (np.diff(self.scans) >= 0).all() or not _within(self.scans, n):
            raise InputError(f"scans: expected numbers below {n} in order")
        if not _within(self.landmarks + 1, 2**31):
            raise InputError("landmarks: expected -1 or a number below 2^31")
        _check_definite(self.motion_covariances)
        _check_definite(self.start.covariance[None])
        if not _within(np.array([scan for scan, _ in self.views], dtype=np.int64), n):
            raise InputError(f"views: expected scans below {n}")

    def motion(self, scan: int) -> UncertainPose2:
        """last_T_current of one scan."""
        pose = Pose2.from_array(self.motions[scan])
        return UncertainPose2(pose, self.motion_covariances[scan])


@final
class LogRecorder:
    """Gathers a run's measurements, scan by scan."""

    def __init__(self, start: UncertainPose2) -> None:
        self._start = start
        self._steps: list[UncertainPose2] = []
        self._seen: list[Perceptions] = []
        self._views: list[tuple[int, View]] = []
        self._looked_from: Pose2 | None = None

    def add(self, step: "FastStep", perceptions: Perceptions, views: Sequence[View]) -> None:
        """One scan of the tracker; of views one every 0.3 m is kept."""
        base, last = step.map_T_base.pose, self._looked_from
        is_apart = last is None or np.hypot(base.x - last.x, base.y - last.y) >= _LOOKS_APART_M
        if views and is_apart:
            self._views += [(len(self._steps), view) for view in views]
            self._looked_from = base
        self._steps.append(step.motion)
        self._seen.append(perceptions)

    def log(self, trajectory: Trajectory, associations: Mapping[int, IntArray]) -> RunLog:
        """Of the whole run.

        Args:
            trajectory: a pose at each scan.
            associations: by stamp, the landmark of each perception.
        """
        found = [associations[each.stamp_ns] for each in self._seen]
        return RunLog(
            trajectory,
            self._start,
            np.array([step.pose.as_array() for step in self._steps]),
            np.array([step.covariance for step in self._steps]),
            concatenate(0, self._seen),
            np.repeat(np.arange(len(self._seen)), [len(each) for each in self._seen]),
            np.concatenate([np.zeros(0, dtype=np.int64), *found]),
            tuple(self._views),
        )


def write_log(path: Path, log: RunLog) -> None:
    """Writes a log; every number but a view's (32 bit) comes back exactly.

    Raises:
        SemgraphError: the file cannot be written.
    """
    names, codes = np.unique(log.seen.identities, return_inverse=True)
    text = json.dumps([str(name) for name in names]).encode()
    views = [view for _, view in log.views]
    beams = [np.zeros(0), *(view.clear_m for view in views)]
    arrays: dict[str, NDArray[Any]] = {
        "stamps_ns": log.trajectory.stamps_ns,
        "map_T_bases": log.trajectory.map_T_bases,
        "start": log.start.pose.as_array(),
        "start_covariance": log.start.covariance,
        "motions": log.motions,
        "motion_covariances": log.motion_covariances,
        "scans": log.scans,
        "landmarks": log.landmarks,
        "identities": codes.astype(np.int64),
        "identity_names": np.frombuffer(text, dtype=np.uint8),
        "view_scans": np.array([scan for scan, _ in log.views], dtype=np.int64),
        "view_sensors": np.array([view.base_T_sensor.as_array() for view in views]).reshape(-1, 3),
        "view_beams": np.array([[view.first, view.increment] for view in views]).reshape(-1, 2),
        "view_num_beams": np.array([len(view.clear_m) for view in views], dtype=np.int64),
        "view_clear_m": np.concatenate(beams).astype(np.float32),
        **{name: getattr(log.seen, name) for name in (*_SEEN, _COMMON_SHARES)},
    }
    try:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, np.ascontiguousarray(array), version=(1, 0))
    except OSError as error:
        raise SemgraphError(f"{path}: cannot be written: {error.strerror}") from error


def read_log(path: Path) -> RunLog:
    """The log of a run.

    Raises:
        InputError: there is none, it is damaged or too big, or holds what no run could log.
    """
    arrays = load_npz(path, _ARRAYS, (_COMMON_SHARES,))
    try:
        return _log(arrays)
    except (InputError, ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: {error}") from error


def _log(arrays: Mapping[str, NDArray[Any]]) -> RunLog:
    m = len(np.atleast_1d(arrays["ranges_m"]))
    start = UncertainPose2(
        Pose2.from_array(frozen_floats("start", arrays["start"], (3,))), arrays["start_covariance"]
    )
    columns = {name: arrays[name] for name in _SEEN}
    columns[_COMMON_SHARES] = arrays.get(_COMMON_SHARES, np.zeros(m))
    columns["kinds"] = frozen_ints("kinds", columns["kinds"], (m,))
    seen = Perceptions(stamp_ns=0, identities=_identities(arrays, m), **columns)
    return RunLog(
        Trajectory(arrays["stamps_ns"], arrays["map_T_bases"]),
        start,
        arrays["motions"],
        arrays["motion_covariances"],
        seen,
        arrays["scans"],
        arrays["landmarks"],
        _views(arrays),
    )


def _identities(arrays: Mapping[str, NDArray[Any]], m: int) -> NDArray[np.str_]:
    codes = frozen_ints("identities", arrays["identities"], (m,))
    names = json.loads(arrays["identity_names"].astype(np.uint8).tobytes())
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError("identity_names: expected a list of texts")
    if not _within(codes, len(names)):
        raise InputError(f"identities: expected numbers below {len(names)}")
    return np.array([*names, ""], dtype=np.str_)[codes]


def _views(arrays: Mapping[str, NDArray[Any]]) -> tuple[tuple[int, View], ...]:
    v = len(np.atleast_1d(arrays["view_scans"]))
    scans = frozen_ints("view_scans", arrays["view_scans"], (v,))
    sensors = frozen_floats("view_sensors", arrays["view_sensors"], (v, 3))
    beams = frozen_floats("view_beams", arrays["view_beams"], (v, 2))
    counts = frozen_ints("view_num_beams", arrays["view_num_beams"], (v,))
    clear_m = frozen_floats("view_clear_m", arrays["view_clear_m"], (None,))
    if not (_within(counts, len(clear_m) + 1) and counts.sum() == len(clear_m)):
        raise InputError(f"view_num_beams: expected {len(clear_m)} in all")
    if not ((beams[:, 1] > 0.0).all() and (np.abs(beams) < 10.0).all() and (clear_m >= 0.0).all()):
        raise InputError("views: expected increments above 0 rad and distances of at least 0 m")
    parts = np.split(clear_m, np.cumsum(counts)[:-1]) if v else []
    return tuple(
        (int(scan), View(Pose2.from_array(sensor), float(first), float(increment), part))
        for scan, sensor, (first, increment), part in zip(scans, sensors, beams, parts, strict=True)
    )


def _within(values: IntArray, end: int) -> bool:
    return bool(((values >= 0) & (values < end)).all())


def _check_definite(covariances: FloatArray) -> None:
    """Raises InputError where one of (n, 3, 3) is not symmetric positive definite."""
    scales = np.abs(covariances).max(axis=(1, 2), initial=0.0)[:, None, None]
    symmetric = np.abs(covariances - covariances.transpose(0, 2, 1)) <= 1e-9 * scales
    try:
        np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError:
        raise InputError("motion covariances: expected positive definite ones") from None
    if not symmetric.all():
        raise InputError("motion covariances: expected symmetric ones")
