"""Reads and writes plain recording folders, which anybody can write by hand.

`recording.toml` (see `plain_header.py`), then what there is of `odometry.csv`, `gnss.csv`,
`imu.csv`, `perceptions.csv` (see `plain_perceptions.py`), `scans.npz`, `truth.tum` and
`truth_landmarks.csv`. Columns come in any order. A `truth.tum` whose quaternions are all 0 0 0 0
knows no headings.
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from semgraph.arrays import BoolArray, FloatArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions
from semgraph.staging import staged_folder
from sensors.dead_reckoning import in_order_of_time, with_odometry_at
from sensors.files import is_there
from sensors.measurements import (
    GnssFix,
    ImuSample,
    LaserScan,
    Measurement,
    OdometryNoise,
    Recording,
    WheelOdometry,
)
from sensors.npz_files import load_npz
from sensors.plain_header import (
    HEADER_FILE,
    Header,
    PerceptionDefaults,
    TruthHeader,
    laser_values,
    read_header,
)
from sensors.plain_perceptions import (
    OPTIONAL_PERCEPTION_COLUMNS,
    PERCEPTION_COLUMNS,
    PERCEPTIONS_FILE,
    kind_codes,
    number_or_blank,
    perception_sets,
    positive_or,
    write_perceptions,
)
from sensors.stamps import seconds, stamps_ns
from sensors.text_table import Row, TextTable, write_csv
from sensors.truth import Source, TrueLandmarks, TruePath, Truth

ODOMETRY_FILE = "odometry.csv"
GNSS_FILE = "gnss.csv"
IMU_FILE = "imu.csv"
SCANS_FILE = "scans.npz"
TRUTH_FILE = "truth.tum"
TRUE_LANDMARKS_FILE = "truth_landmarks.csv"

ODOMETRY_COLUMNS = ("stamp_s", "x_m", "y_m", "yaw_rad")
GNSS_COLUMNS = ("stamp_s", "x_m", "y_m", "sigma_m")
IMU_COLUMNS = ("stamp_s", "yaw_rate_rad_s")
TRUE_LANDMARK_COLUMNS = ("x_m", "y_m", "kind")
LARGEST_M = 1e7
TUM_COLUMNS = ("stamp_s", "x", "y", "z", "qx", "qy", "qz", "qw")


class PlainOptions(BaseModel, extra="forbid", frozen=True):
    """Nothing to set: the folder says it all."""


def recognises(folder: Path) -> bool:
    """Whether a plain recording lies in the folder."""
    return is_there(folder / HEADER_FILE)


def read(path: Path, options: PlainOptions) -> Source:  # noqa: ARG001 - every reader takes options
    """The recording and truth of a plain folder; perceptions with the same stamp form one set.

    Odometry is interpolated at scans and perceptions that have none of their own.

    Raises:
        InputError: a file is damaged, a value out of its domain, or there is nothing to run.
    """
    header = read_header(path)
    sets = _sets(path, header.perceptions)
    scans = _scans(path, header)
    if not sets and not scans:
        raise InputError(
            f"{path}: expected {PERCEPTIONS_FILE} or {SCANS_FILE} with at least one record: "
            "nothing to run"
        )
    stamps = [p.stamp_ns for p in sets] + [scan.stamp_ns for scan in scans]
    odometry = with_odometry_at(np.unique(stamps), _odometry(path))
    noise = OdometryNoise(**header.vehicle.model_dump()) if header.vehicle else OdometryNoise()
    recording = Recording(
        name=header.name,
        measurements=in_order_of_time(odometry, _imu(path), _gnss(path), sets, scans),
        num_scans=len(sets) + len(scans),
        odometry_noise=noise if odometry else None,
        detectors=header.detectors or ({"trees-2d": {}} if scans else {}),
        map_T_start=Pose2(*header.start.map_T_start),
    )
    return Source(recording, Truth(_true_path(path, header.truth), _true_landmarks(path)))


def _table(
    path: Path, name: str, required: tuple[str, ...], optional: tuple[str, ...] = ()
) -> TextTable | None:
    """A table of the folder; None where it is not there."""
    file = path / name
    return TextTable.of_csv(file, required, optional) if is_there(file) else None


def _metres(table: TextTable, name: str) -> FloatArray:
    return table.numbers(name, above=-LARGEST_M, at_most=LARGEST_M)


def _odometry(path: Path) -> list[WheelOdometry]:
    table = _table(path, ODOMETRY_FILE, ODOMETRY_COLUMNS)
    if table is None:
        return []
    stamps = table.stamps_ns("stamp_s").tolist()
    poses = zip(
        _metres(table, "x_m").tolist(),
        _metres(table, "y_m").tolist(),
        _metres(table, "yaw_rad").tolist(),
        strict=True,
    )
    return [
        WheelOdometry(stamp_ns, Pose2(*pose)) for stamp_ns, pose in zip(stamps, poses, strict=True)
    ]


def _gnss(path: Path) -> list[GnssFix]:
    table = _table(path, GNSS_FILE, GNSS_COLUMNS)
    if table is None:
        return []
    stamps = table.stamps_ns("stamp_s").tolist()
    x, y = _metres(table, "x_m").tolist(), _metres(table, "y_m").tolist()
    sigmas = table.numbers("sigma_m", above=0.0, at_most=LARGEST_M).tolist()
    return [GnssFix(*values) for values in zip(stamps, x, y, sigmas, strict=True)]


def _imu(path: Path) -> list[ImuSample]:
    table = _table(path, IMU_FILE, IMU_COLUMNS)
    if table is None:
        return []
    stamps = table.stamps_ns("stamp_s").tolist()
    rates = table.numbers("yaw_rate_rad_s", above=-1e4, at_most=1e4).tolist()
    return [ImuSample(*values) for values in zip(stamps, rates, strict=True)]


def _sets(path: Path, defaults: PerceptionDefaults) -> list[Perceptions]:
    table = _table(path, PERCEPTIONS_FILE, PERCEPTION_COLUMNS, OPTIONAL_PERCEPTION_COLUMNS)
    return perception_sets(table, defaults) if table is not None else []


def _scans(path: Path, header: Header) -> list[LaserScan]:
    file = path / SCANS_FILE
    if not is_there(file):
        return []
    if header.laser is None:
        raise InputError(f"{path / HEADER_FILE}: expected [laser], since there is {SCANS_FILE}")
    arrays = load_npz(file, ("stamp_s", "ranges_m"), ("intensities",))
    times, ranges_m = arrays["stamp_s"].astype(np.float64), arrays["ranges_m"]
    intensities = arrays.get("intensities")
    n = len(times) if times.ndim == 1 else -1
    if n < 0 or ranges_m.ndim != 2 or len(ranges_m) != n or not ranges_m.shape[1]:
        raise InputError(
            f"{file}: expected stamp_s (n,) and ranges_m (n, m), "
            f"got {times.shape} and {ranges_m.shape}"
        )
    if intensities is not None and intensities.shape != ranges_m.shape:
        raise InputError(f"{file}: expected intensities {ranges_m.shape}, got {intensities.shape}")
    _refuse_records(file, "ranges_m", ranges_m, np.isfinite(ranges_m) & (ranges_m < 0.0))
    if intensities is not None:
        _refuse_records(file, "intensities", intensities, ~np.isfinite(intensities))
    geometry = header.laser.geometry()
    return [
        LaserScan(
            int(stamp_ns), geometry, ranges_m[k], None if intensities is None else intensities[k]
        )
        for k, stamp_ns in enumerate(stamps_ns(file, "stamp_s", times))
    ]


def _refuse_records(file: Path, name: str, values: FloatArray, bad: BoolArray) -> None:
    records = np.flatnonzero(bad.any(axis=1))
    if len(records):
        value = values[records[0]][bad[records[0]]][0]
        raise InputError(f"{file}: {name}: record {records[0] + 1} holds {value}")


def _true_path(path: Path, header: TruthHeader) -> TruePath | None:
    file = path / TRUTH_FILE
    if not is_there(file):
        return None
    table = TextTable.of_words(file, list(TUM_COLUMNS))
    quaternions = np.column_stack([table.numbers(name) for name in ("qx", "qy", "qz", "qw")])
    norms = np.linalg.norm(quaternions, axis=1)
    has_headings = bool((norms > 0.0).any())
    if has_headings:
        table.refuse(~(np.abs(norms - 1.0) < 0.01), "qw", "a unit quaternion")
    qx, qy, qz, qw = quaternions.T
    headings = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy**2 + qz**2))
    return TruePath(
        table.stamps_ns("stamp_s"),
        np.column_stack([_metres(table, "x"), _metres(table, "y")]),
        headings if has_headings else None,
        np.array(header.base_t_reference),
        header.has_outliers,
        header.sigma_m,
    )


def _true_landmarks(path: Path) -> TrueLandmarks | None:
    table = _table(path, TRUE_LANDMARKS_FILE, TRUE_LANDMARK_COLUMNS, ("diameter_m",))
    if table is None:
        return None
    positions = np.column_stack([_metres(table, "x_m"), _metres(table, "y_m")])
    return TrueLandmarks(positions, kind_codes(table), positive_or(table, "diameter_m", np.nan))


def write(source: Source, folder: Path) -> None:
    """Write a source as a plain recording folder: whole, or not at all.

    What the format has no place for is not written: correlations of range and bearing, and the
    truth's associations.

    Raises:
        InputError: the folder is there already, or the scans differ in geometry or number of
            beams.
        SemgraphError: the folder cannot be written.
    """
    try:
        if is_there(folder):
            raise InputError(f"{folder}: expected a new folder, it is there already")
        with staged_folder(folder, HEADER_FILE) as staging:
            _write_files(source, staging)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from error


def _write_files(source: Source, folder: Path) -> None:
    measurements = tuple(source.recording.measurements)
    scans = [m for m in measurements if isinstance(m, LaserScan)]
    _write_header(folder, source, scans)
    _write_motion(folder, measurements)
    sets = [m for m in measurements if isinstance(m, Perceptions)]
    if sets:
        write_perceptions(folder / PERCEPTIONS_FILE, sets)
    if scans:
        _write_scans(folder / SCANS_FILE, scans)
    _write_truth(folder, source.truth)


def _write_header(folder: Path, source: Source, scans: list[LaserScan]) -> None:
    import tomli_w

    recording, path = source.recording, source.truth.path
    header: dict[str, Any] = {"name": recording.name}
    header["detectors"] = {name: dict(values) for name, values in recording.detectors.items()}
    header["start"] = {"map_T_start": recording.map_T_start.as_array().tolist()}
    if recording.odometry_noise is not None:
        header["vehicle"] = asdict(recording.odometry_noise)
    if scans:
        header["laser"] = laser_values(scans[0].geometry)
    if path is not None:
        reference = path.base_t_reference.tolist()
        header["truth"] = {
            "base_t_reference": reference,
            "has_outliers": path.has_outliers,
            "sigma_m": path.sigma_m,
        }
    with (folder / HEADER_FILE).open("wb") as file:
        tomli_w.dump(header, file)


def _write_motion(folder: Path, measurements: tuple[Measurement, ...]) -> None:
    wheels = [
        (seconds(m.stamp_ns), m.odom_T_base.x, m.odom_T_base.y, m.odom_T_base.theta)
        for m in measurements
        if isinstance(m, WheelOdometry)
    ]
    fixes = [
        (seconds(m.stamp_ns), m.x_m, m.y_m, m.sigma_m)
        for m in measurements
        if isinstance(m, GnssFix)
    ]
    rates = [(seconds(m.stamp_ns), m.yaw_rate) for m in measurements if isinstance(m, ImuSample)]
    tables: tuple[tuple[str, tuple[str, ...], Sequence[Row]], ...] = (
        (ODOMETRY_FILE, ODOMETRY_COLUMNS, wheels),
        (GNSS_FILE, GNSS_COLUMNS, fixes),
        (IMU_FILE, IMU_COLUMNS, rates),
    )
    for name, columns, rows in tables:
        if rows:
            write_csv(folder / name, columns, rows)


def _write_scans(file: Path, scans: list[LaserScan]) -> None:
    has_intensities = [scan.intensities is not None for scan in scans]
    alike = {(scan.geometry, len(scan.ranges_m)) for scan in scans}
    if len(alike) > 1 or len(set(has_intensities)) > 1:
        raise InputError("expected scans of one geometry, all with or all without intensities")
    arrays = {
        "stamp_s": np.array([scan.stamp_ns for scan in scans]) / 1e9,
        "ranges_m": np.array([scan.ranges_m for scan in scans]),
    }
    if has_intensities[0]:
        arrays["intensities"] = np.array([scan.intensities for scan in scans])
    np.savez_compressed(file, allow_pickle=False, **arrays)


def _write_truth(folder: Path, truth: Truth) -> None:
    if truth.path is not None:
        path = truth.path
        half = 0.5 * path.headings if path.headings is not None else None
        zw = np.zeros((len(path.stamps_ns), 2))
        if half is not None:
            zw = np.column_stack([np.sin(half), np.cos(half)])
        poses = np.column_stack([path.world_t_reference, np.zeros((len(zw), 3)), zw]).tolist()
        lines = (
            " ".join([seconds(stamp_ns), *map(repr, pose)]) + "\n"
            for stamp_ns, pose in zip(path.stamps_ns.tolist(), poses, strict=True)
        )
        (folder / TRUTH_FILE).write_text("".join(lines), encoding="utf-8")
    if truth.landmarks is not None:
        landmarks = truth.landmarks
        rows = (
            (x, y, Kind(kind).label, number_or_blank(diameter_m))
            for (x, y), kind, diameter_m in zip(
                landmarks.world_t_landmarks.tolist(),
                landmarks.kinds.tolist(),
                landmarks.diameters_m.tolist(),
                strict=True,
            )
        )
        write_csv(folder / TRUE_LANDMARKS_FILE, (*TRUE_LANDMARK_COLUMNS, "diameter_m"), rows)
