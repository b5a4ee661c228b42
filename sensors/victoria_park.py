"""Reads Victoria Park: trees as range, bearing and diameter, drive data and patchy GPS.

All files count one clock, in s or ms; the drive data of `aa3_dr.mat` are those of `u` and `time`.
"""

import math
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors import utility_car
from sensors.dead_reckoning import in_order_of_time, integrate
from sensors.files import is_there
from sensors.mat_files import MatArray, load_mat, numbers, vector
from sensors.measurements import Recording, WheelOdometry
from sensors.stamps import stamps_ns
from sensors.truth import Source, TruePath, Truth

DETECTIONS_FILE = "VictoriaParkSinSincronizar.mat"
GPS_FILE = "aa3_gpsx.mat"

MIN_RANGE_M = 4.0
"""What is nearer is the car itself."""
RANGE_LIMITS_M = np.array([5.0, 10.0, 15.0, 20.0, 30.0])
RANGE_SIGMAS_M = np.array([0.026, 0.035, 0.043, 0.054, 0.078, 0.101])
"""Range sigma up to each limit and beyond the last, measured within tracks of single trees."""
BEARING_SIGMA = math.radians(0.17)
DIAMETER_SIGMA_OF_LN = 0.24
"""sd(ln d) within tracks of single trees."""
BASE_T_ANTENNA = np.array([3.9, 0.5])
"""Above the laser, to 0.1 m: from tight turns (27 windows of 10 s and 22 of 20 s that turn by more
than 0.8 and 1.2 rad), where each window of the wheels' path alone is laid on GPS: (3.90, 0.47) and
(3.74, 0.50), bootstrapped 1-sigma (0.12, 0.06) and (0.12, 0.10). No estimator takes part.
"""
GPS_SIGMA_M = 0.35
"""From the turns between its chords of 10 to 40 m, beside what odometry errs."""


class VictoriaParkOptions(BaseModel, extra="forbid", frozen=True):
    """Nothing to set."""


def recognises(folder: Path) -> bool:
    """Whether Victoria Park's detections lie in the folder."""
    return is_there(folder / DETECTIONS_FILE)


def read(path: Path, options: VictoriaParkOptions) -> Source:  # noqa: ARG001 - every reader takes options
    """Victoria Park's trees from base, with GPS as truth (outliers of up to 137 m).

    Raises:
        InputError: a file is missing, damaged, or its arrays are not what they should be.
    """
    truth = Truth(_true_path(path / GPS_FILE))
    file = path / DETECTIONS_FILE
    arrays = load_mat(file, ("zt", "TLsr", "u", "time"))
    trees = _trees(file, arrays)
    odometry = _odometry(file, arrays, trees)
    recording = Recording(
        name="victoria-park",
        measurements=in_order_of_time(odometry, trees),
        num_scans=len(trees),
        odometry_noise=utility_car.ODOMETRY_NOISE,
    )
    return Source(recording, truth)


def _trees(file: Path, arrays: dict[str, MatArray]) -> list[Perceptions]:
    stamps = stamps_ns(file, "TLsr", vector(file, "TLsr", arrays["TLsr"]))
    cells = arrays["zt"]
    if not isinstance(cells, tuple) or not 0 < len(cells) == len(stamps):
        raise InputError(f"{file}: zt: expected one cell for each of the {len(stamps)} times")
    return [_perceptions(int(stamps[k]), _features(file, k, cells[k])) for k in range(len(cells))]


def _features(file: Path, k: int, cell: FloatArray) -> FloatArray:
    """(3, n) range, bearing, diameter of what is not the car itself."""
    if not cell.size:
        return np.zeros((3, 0))
    features = numbers(file, f"zt, cell {k + 1}", cell, (3, -1))
    if not (features[[0, 2]] > 0.0).all():
        raise InputError(f"{file}: zt, cell {k + 1}: expected ranges and diameters above 0 m")
    return features[:, features[0] >= MIN_RANGE_M]


def _perceptions(stamp_ns: int, features: FloatArray) -> Perceptions:
    ranges_m, bearings, diameters_m = features
    range_sigmas_m = RANGE_SIGMAS_M[np.searchsorted(RANGE_LIMITS_M, ranges_m)]
    return Perceptions.from_arrays(
        stamp_ns,
        Kind.TREE,
        ranges_m,
        bearings - math.pi / 2,
        polar_covariances(range_sigmas_m, np.full(len(ranges_m), BEARING_SIGMA)),
        diameters_m=diameters_m,
        diameter_sigmas_m=DIAMETER_SIGMA_OF_LN * diameters_m,
    ).seen_from(utility_car.BASE_T_LASER)


def _odometry(
    file: Path, arrays: dict[str, MatArray], trees: list[Perceptions]
) -> list[WheelOdometry]:
    speeds, steering = numbers(file, "u", arrays["u"], (2, -1))
    stamps = stamps_ns(file, "time", vector(file, "time", arrays["time"]))
    twists = utility_car.twists(file, stamps, speeds, steering)
    return integrate(twists, np.array([perceptions.stamp_ns for perceptions in trees]))


def _true_path(file: Path) -> TruePath:
    arrays = load_mat(file, ("timeGps", "Lo_m", "La_m"))
    milliseconds, east, north = (vector(file, name, array) for name, array in arrays.items())
    if not len(milliseconds) == len(east) == len(north):
        raise InputError(f"{file}: expected as many Lo_m and La_m as timeGps")
    return TruePath(
        stamps_ns(file, "timeGps", milliseconds / 1e3),
        np.column_stack([east, north]),
        base_t_reference=BASE_T_ANTENNA,
        has_outliers=True,
        sigma_m=GPS_SIGMA_M,
    )
