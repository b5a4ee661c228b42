"""Writes plain recording folders, as `plain_folder.py` reads them."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from semgraph.errors import InputError
from semgraph.files.staging import staged_folder
from semgraph.landmarks import Kind, Perceptions
from sensors.files import is_there
from sensors.measurements import (
    CameraGeometry,
    CameraImage,
    DepthImage,
    GnssFix,
    ImuSample,
    LaserScan,
    Measurement,
    PointCloud,
    Tilt,
    WheelOdometry,
)
from sensors.plain_folder import (
    GNSS_COLUMNS,
    GNSS_FILE,
    IMU_COLUMNS,
    IMU_FILE,
    ODOMETRY_COLUMNS,
    ODOMETRY_FILE,
    TILT_COLUMNS,
    TRUE_LANDMARK_COLUMNS,
    TRUE_LANDMARKS_FILE,
    TRUTH_FILE,
)
from sensors.plain_header import HEADER_FILE, camera_values, laser_values
from sensors.plain_images import (
    DEPTH_ARRAY,
    DEPTH_FILE,
    GREY_ARRAY,
    IMAGES_FILE,
    Packed,
    packed_depth_image,
    write_images,
)
from sensors.plain_perceptions import (
    PERCEPTIONS_FILE,
    number_or_blank,
    write_perceptions,
)
from sensors.plain_scans import SCANS_FILE, write_scans
from sensors.stamps import seconds
from sensors.text_table import Row, write_csv
from sensors.truth import Source, Truth


def write(source: Source, folder: Path) -> None:
    """Write a source as a plain recording folder: whole, or not at all.

    What the format has no place for is not written: correlations of range and bearing, depths
    below a millimetre, and of the truth the associations, felled trees and who walked.

    Raises:
        InputError: the folder holds something already, the scans differ in geometry or number of
            beams, the images in their camera, or there are point clouds.
        SemgraphError: the folder cannot be written.
    """
    try:
        if is_there(folder) and not (folder.is_dir() and not any(folder.iterdir())):
            raise InputError(f"{folder}: expected a new or empty folder, it is there already")
        with staged_folder(folder, HEADER_FILE) as staging:
            _write_files(source, staging)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from error


@dataclass(frozen=True, slots=True)
class _Sorted:
    """The measurements of a source by the file that they go into; images packed as they come."""

    scans: list[LaserScan] = field(default_factory=list)
    sets: list[Perceptions] = field(default_factory=list)
    motion: list[Measurement] = field(default_factory=list)
    depth: list[Packed] = field(default_factory=list)
    images: list[Packed] = field(default_factory=list)
    cameras: set[CameraGeometry] = field(default_factory=set)

    def add(self, measurement: Measurement) -> None:
        """Puts one where it belongs."""
        match measurement:
            case LaserScan():
                self.scans.append(measurement)
            case Perceptions():
                self.sets.append(measurement)
            case DepthImage():
                self.depth.append(packed_depth_image(measurement))
                self.cameras.add(measurement.camera)
            case CameraImage(stamp_ns=stamp_ns, camera=camera, grey=grey, tilt=tilt):
                self.images.append((stamp_ns, grey, tilt))
                self.cameras.add(camera)
            case PointCloud():
                raise InputError("a plain recording folder has no place for point clouds")
            case _:
                self.motion.append(measurement)


def _write_files(source: Source, folder: Path) -> None:
    parts = _Sorted()
    for measurement in source.recording.measurements:
        parts.add(measurement)
    _write_header(folder, source, parts)
    _write_motion(folder, parts.motion)
    if parts.sets:
        write_perceptions(folder / PERCEPTIONS_FILE, parts.sets)
    if parts.scans:
        write_scans(folder / SCANS_FILE, parts.scans)
    if parts.depth:
        write_images(folder / DEPTH_FILE, DEPTH_ARRAY, parts.depth)
    if parts.images:
        write_images(folder / IMAGES_FILE, GREY_ARRAY, parts.images)
    _write_truth(folder, source.truth)


def _write_header(folder: Path, source: Source, parts: _Sorted) -> None:
    import tomli_w

    if len(parts.cameras) > 1:
        raise InputError(f"expected images of one camera, got {len(parts.cameras)} cameras")
    recording, path = source.recording, source.truth.path
    header: dict[str, Any] = {"name": recording.name}
    header["detectors"] = {name: dict(values) for name, values in recording.detectors.items()}
    header["start"] = {"map_T_start": recording.map_T_start.as_array().tolist()}
    header["filters"] = [dict(table) for table in recording.filters]
    header["num_hypotheses"] = recording.num_hypotheses
    if recording.odometry_noise is not None:
        header["vehicle"] = asdict(recording.odometry_noise)
    if parts.scans:
        header["laser"] = laser_values(parts.scans[0].geometry)
    for camera in parts.cameras:
        header["camera"] = camera_values(camera)
    if path is not None:
        reference = path.base_t_reference.tolist()
        header["truth"] = {
            "base_t_reference": reference,
            "has_outliers": path.has_outliers,
            "sigma_m": path.sigma_m,
        }
    with (folder / HEADER_FILE).open("wb") as file:
        tomli_w.dump(header, file)


def _write_motion(folder: Path, measurements: Sequence[Measurement]) -> None:
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
    rates = [
        (seconds(m.stamp_ns), m.yaw_rate, *_tilt_cells(m.tilt))
        for m in measurements
        if isinstance(m, ImuSample)
    ]
    tables: tuple[tuple[str, tuple[str, ...], Sequence[Row]], ...] = (
        (ODOMETRY_FILE, ODOMETRY_COLUMNS, wheels),
        (GNSS_FILE, GNSS_COLUMNS, fixes),
        (IMU_FILE, (*IMU_COLUMNS, *TILT_COLUMNS), rates),
    )
    for name, columns, rows in tables:
        if rows:
            write_csv(folder / name, columns, rows)


def _tilt_cells(tilt: Tilt | None) -> tuple[float | str, float | str]:
    return ("", "") if tilt is None else (tilt.roll, tilt.pitch)


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
