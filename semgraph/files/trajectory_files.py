"""Trajectories and their covariances as text files."""

from pathlib import Path

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.files.tables import (
    column_floats,
    column_stamps_ns,
    read_csv_rows,
    read_spaced_rows,
    stamp_text,
    write_text,
)

_TUM_COLUMNS = "timestamp tx ty tz qx qy qz qw"
_UPPER = np.triu_indices(3)
COVARIANCE_COLUMNS = (
    "stamp_s",
    "xx_m2",
    "xy_m2",
    "xtheta_m_rad",
    "yy_m2",
    "ytheta_m_rad",
    "thetatheta_rad2",
)


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Writes poses as `timestamp tx ty tz qx qy qz qw`: seconds, metres, quaternion xyzw.

    Times and positions come back exactly, headings within one rounding.

    Raises:
        SemgraphError: the file cannot be written.
    """
    lines = [f"# {_TUM_COLUMNS}"]
    half = 0.5 * trajectory.map_T_bases[:, 2]
    columns = np.column_stack([trajectory.map_T_bases[:, :2], np.sin(half), np.cos(half)])
    for stamp_ns, (x, y, qz, qw) in zip(
        trajectory.stamps_ns.tolist(), columns.tolist(), strict=True
    ):
        lines.append(f"{stamp_text(stamp_ns)} {x!r} {y!r} 0.0 0.0 0.0 {qz!r} {qw!r}")
    write_text(path, "\n".join(lines) + "\n")


def read_tum(path: Path) -> Trajectory:
    """The poses of a TUM file, seen from above: z, roll and pitch are left out.

    Raises:
        InputError: malformed, times that do not increase, or no unit quaternions.
    """
    rows = read_spaced_rows(path, len(_TUM_COLUMNS.split()))
    if not rows:
        return Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)))
    stamps_ns = column_stamps_ns(path, rows)
    values = column_floats(path, rows, slice(1, None))
    qx, qy, qz, qw = values[:, 3:].T
    with np.errstate(over="ignore"):
        no_units = ~(np.abs(np.sum(values[:, 3:] ** 2, axis=1) - 1.0) < 1e-2)
    if no_units.any():
        line = rows[int(np.argmax(no_units))].line
        raise InputError(f"{path} line {line}: expected a unit quaternion qx qy qz qw")
    planar = (qx == 0.0) & (qy == 0.0)
    theta = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy**2 + qz**2))
    theta[planar] = 2.0 * np.arctan2(qz[planar], qw[planar])
    theta = np.where(theta > np.pi, theta - 2.0 * np.pi, theta)
    theta = np.where(theta < -np.pi, theta + 2.0 * np.pi, theta)
    return Trajectory(stamps_ns, np.column_stack([values[:, :2], theta]))


def write_covariances(path: Path, trajectory: Trajectory, covariances: FloatArray) -> None:
    """Writes the upper triangle of each pose's (3, 3) covariance, in its own body frame.

    Raises:
        SemgraphError: the file cannot be written.
    """
    lines = [",".join(COVARIANCE_COLUMNS)]
    upper = covariances[:, *_UPPER].tolist()
    for stamp_ns, values in zip(trajectory.stamps_ns.tolist(), upper, strict=True):
        lines.append(",".join([stamp_text(stamp_ns), *(repr(value) for value in values)]))
    write_text(path, "\n".join(lines) + "\n")


def read_covariances(path: Path, trajectory: Trajectory) -> FloatArray:
    """(n, 3, 3) covariances of the trajectory's poses; a row of NaN where it is unknown.

    Raises:
        InputError: malformed, or other times than the trajectory's.
    """
    rows = read_csv_rows(path, COVARIANCE_COLUMNS)
    upper = column_floats(path, rows, slice(1, None), finite=False)
    if not np.array_equal(column_stamps_ns(path, rows), trajectory.stamps_ns):
        raise InputError(f"{path}: expected the times of the {len(trajectory)} smoothed poses")
    covariances = np.empty((len(rows), 3, 3))
    if rows:
        covariances[:, *_UPPER] = upper
        covariances[:, *_UPPER[::-1]] = upper
    return covariances
