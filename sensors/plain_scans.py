"""The scans `scans.npz` of a plain recording folder."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.errors import InputError
from sensors.measurements import LaserScan, ScannerGeometry
from sensors.npz_files import load_npz
from sensors.stamps import stamps_ns

SCANS_FILE = "scans.npz"


def read_scans(file: Path, geometry: ScannerGeometry) -> list[LaserScan]:
    """The scans of a file of stamp_s (n,), ranges_m (n, m) and perhaps intensities (n, m).

    Raises:
        InputError: damaged, too big, shapes disagree, a negative range, or times that run back.
    """
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


def write_scans(file: Path, scans: Sequence[LaserScan]) -> None:
    """Writes scans of one geometry.

    Raises:
        InputError: they differ in geometry, number of beams, or in whether they have intensities.
    """
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
