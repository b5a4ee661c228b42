"""Reads plain recording folders, which anybody can write by hand (`plain_writing.py` does too).

`recording.toml` (see `plain_header.py`), then what there is of `odometry.csv`, `gnss.csv`,
`imu.csv`, `perceptions.csv` (see `plain_perceptions.py`), `scans.npz` (`plain_scans.py`),
`depth.npz` and `images.npz` (`plain_images.py`), `truth.tum` and `truth_landmarks.csv`. Columns
come in any order. A `truth.tum` whose quaternions are all 0 0 0 0 knows no headings.
"""

import math
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from semgraph.landmarks import Perceptions
from sensors.dead_reckoning import in_order_of_time, with_odometry_at
from sensors.files import is_there
from sensors.measurements import (
    GnssFix,
    ImuSample,
    LaserScan,
    OdometryNoise,
    Recording,
    Tilt,
    WheelOdometry,
)
from sensors.plain_header import HEADER_FILE, Header, PerceptionDefaults, TruthHeader, read_header
from sensors.plain_images import (
    DEPTH_FILE,
    IMAGES_FILE,
    Images,
    read_camera_images,
    read_depth_images,
    with_images,
)
from sensors.plain_perceptions import (
    OPTIONAL_PERCEPTION_COLUMNS,
    PERCEPTION_COLUMNS,
    PERCEPTIONS_FILE,
    kind_codes,
    perception_sets,
    positive_or,
)
from sensors.plain_scans import SCANS_FILE, read_scans
from sensors.text_table import TextTable
from sensors.truth import Source, TrueLandmarks, TruePath, Truth

ODOMETRY_FILE = "odometry.csv"
GNSS_FILE = "gnss.csv"
IMU_FILE = "imu.csv"
TRUTH_FILE = "truth.tum"
TRUE_LANDMARKS_FILE = "truth_landmarks.csv"

ODOMETRY_COLUMNS = ("stamp_s", "x_m", "y_m", "yaw_rad")
GNSS_COLUMNS = ("stamp_s", "x_m", "y_m", "sigma_m")
IMU_COLUMNS = ("stamp_s", "yaw_rate_rad_s")
TILT_COLUMNS = ("roll_rad", "pitch_rad")
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
    sets, scans = _sets(path, header.perceptions), _scans(path, header)
    images = _images(path, header)
    stamps = [each.stamp_ns for each in sets] + [scan.stamp_ns for scan in scans]
    stamps += [stamp_ns for each in images for stamp_ns in each.stamps_ns.tolist()]
    if not stamps:
        raise InputError(
            f"{path}: expected {PERCEPTIONS_FILE}, {SCANS_FILE}, {DEPTH_FILE} or {IMAGES_FILE} "
            "with at least one record: nothing to run"
        )
    odometry = with_odometry_at(np.unique(stamps), _odometry(path))
    noise = OdometryNoise(**header.vehicle.model_dump()) if header.vehicle else OdometryNoise()
    small = in_order_of_time(odometry, _imu(path), _gnss(path), sets, scans)
    recording = Recording(
        name=header.name,
        measurements=with_images(small, images),
        num_scans=len(stamps),
        odometry_noise=noise if odometry else None,
        detectors=header.detectors or ({"trees-2d": {}} if scans else {}),
        filters=header.filters,
        map_T_start=Pose2(*header.start.map_T_start),
        num_hypotheses=header.num_hypotheses,
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
    table = _table(path, IMU_FILE, IMU_COLUMNS, TILT_COLUMNS)
    if table is None:
        return []
    stamps = table.stamps_ns("stamp_s").tolist()
    rates = table.numbers("yaw_rate_rad_s", above=-1e4, at_most=1e4).tolist()
    return [ImuSample(*values) for values in zip(stamps, rates, _tilts(table), strict=True)]


def _tilts(table: TextTable) -> list[Tilt | None]:
    """Roll and pitch of each row; None where both cells are empty."""
    rolls, pitches = (
        table.numbers(name, above=-1e4, at_most=1e4, or_none=True)
        if name in table.columns
        else np.full(len(table), np.nan)
        for name in TILT_COLUMNS
    )
    for name in set(TILT_COLUMNS) & set(table.columns):
        table.refuse(np.isnan(rolls) != np.isnan(pitches), name, "roll and pitch, or neither")
    return [
        None if math.isnan(roll) else Tilt(roll, pitch)
        for roll, pitch in zip(rolls.tolist(), pitches.tolist(), strict=True)
    ]


def _sets(path: Path, defaults: PerceptionDefaults) -> list[Perceptions]:
    table = _table(path, PERCEPTIONS_FILE, PERCEPTION_COLUMNS, OPTIONAL_PERCEPTION_COLUMNS)
    return perception_sets(table, defaults) if table is not None else []


def _scans(path: Path, header: Header) -> list[LaserScan]:
    file = path / SCANS_FILE
    if not is_there(file):
        return []
    if header.laser is None:
        raise InputError(f"{path / HEADER_FILE}: expected [laser], since there is {SCANS_FILE}")
    return read_scans(file, header.laser.geometry())


def _images(path: Path, header: Header) -> list[Images]:
    found = []
    for name, read_images in ((DEPTH_FILE, read_depth_images), (IMAGES_FILE, read_camera_images)):
        if is_there(path / name):
            if header.camera is None:
                raise InputError(f"{path / HEADER_FILE}: expected [camera], since there is {name}")
            found.append(read_images(path / name, header.camera.geometry()))
    return found


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
