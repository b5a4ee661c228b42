"""Reads Nebot's car park: raw laser scans with reflectors, drive data, GPS and 15 beacons."""

import math
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from semgraph.arrays import IntArray
from semgraph.errors import InputError
from semgraph.landmarks import Kind
from sensors import utility_car
from sensors.dead_reckoning import in_order_of_time, integrate
from sensors.files import is_there
from sensors.mat_files import MatArray, load_mat, numbers, vector
from sensors.measurements import GnssFix, LaserScan, Recording, ScannerGeometry, WheelOdometry
from sensors.stamps import stamps_ns
from sensors.truth import Source, TrueLandmarks, TruePath, Truth

DATA_FILE = "data_set.mat"
BEACONS_FILE = "beac_juan3.mat"
GNSS_SIGMA_M = 0.05
"""Stated: kinematic GPS, good to centimetres."""
NO_RETURN_M = 81.8
"""An LMS says 81.83 m and above for an error or no return."""

GEOMETRY = ScannerGeometry(
    angle_min=-math.pi / 2,
    angle_increment=math.radians(0.5),
    range_min_m=0.0,
    range_max_m=NO_RETURN_M,
    base_T_laser=utility_car.BASE_T_LASER,
)


class CarParkOptions(BaseModel, extra="forbid", frozen=True):
    """What a user may set: `gnss` gives the estimator the GPS, which else only judges."""

    gnss: bool = False


def recognises(folder: Path) -> bool:
    """Whether the car park lies in the folder."""
    return is_there(folder / DATA_FILE)


def read(path: Path, options: CarParkOptions) -> Source:
    """The car park with GPS and surveyed beacons as truth.

    Scans are in the laser's frame; odometry is that of the rear axle. GPS is the laser's place.

    Raises:
        InputError: a file is missing, damaged, or its arrays are not what they should be.
    """
    file = path / DATA_FILE
    names = ("Laser", "Intensity", "TimeLaser", "Velocity", "Steering", "Time_VS")
    arrays = load_mat(file, (*names, "GPSLon", "GPSLat", "TimeGPS"))
    scans = _scans(file, arrays)
    true_path = _true_path(file, arrays)
    fixes = _fixes(true_path) if options.gnss else []
    odometry = _odometry(file, arrays, np.array([scan.stamp_ns for scan in scans]))
    recording = Recording(
        name="car-park",
        measurements=in_order_of_time(odometry, fixes, scans),
        num_scans=len(scans),
        odometry_noise=utility_car.ODOMETRY_NOISE,
        detectors={"reflectors": {}},
    )
    return Source(recording, Truth(true_path, _beacons(path / BEACONS_FILE)))


def _scans(file: Path, arrays: dict[str, MatArray]) -> list[LaserScan]:
    stamps = stamps_ns(file, "TimeLaser", vector(file, "TimeLaser", arrays["TimeLaser"]))
    n = len(stamps)
    if not n:
        raise InputError(f"{file}: expected at least one scan, there is none")
    ranges_m = numbers(file, "Laser", arrays["Laser"], (n, 361))
    intensities = numbers(file, "Intensity", arrays["Intensity"], (n, 361))
    if (ranges_m < 0.0).any():
        record = np.flatnonzero((ranges_m < 0.0).any(axis=1))[0] + 1
        raise InputError(f"{file}: Laser: expected ranges >= 0 m, record {record} has less")
    ranges_m[ranges_m >= NO_RETURN_M] = np.inf
    return [LaserScan(int(stamps[k]), GEOMETRY, ranges_m[k], intensities[k]) for k in range(n)]


def _odometry(
    file: Path, arrays: dict[str, MatArray], scan_stamps_ns: IntArray
) -> list[WheelOdometry]:
    seconds, speeds, steering = (
        vector(file, name, arrays[name]) for name in ("Time_VS", "Velocity", "Steering")
    )
    stamps = stamps_ns(file, "Time_VS", seconds)
    twists = utility_car.twists(file, stamps, speeds, steering)
    return integrate(twists, scan_stamps_ns)


def _true_path(file: Path, arrays: dict[str, MatArray]) -> TruePath:
    seconds, east, north = (
        vector(file, name, arrays[name]) for name in ("TimeGPS", "GPSLon", "GPSLat")
    )
    if not len(seconds) == len(east) == len(north):
        raise InputError(f"{file}: expected as many GPSLon and GPSLat as TimeGPS")
    laser = utility_car.BASE_T_LASER
    return TruePath(
        stamps_ns(file, "TimeGPS", seconds),
        np.column_stack([east, north]),
        base_t_reference=np.array([laser.x, laser.y]),
        sigma_m=GNSS_SIGMA_M,
    )


def _fixes(path: TruePath) -> list[GnssFix]:
    return [
        GnssFix(int(stamp_ns), float(x_m), float(y_m), GNSS_SIGMA_M)
        for stamp_ns, (x_m, y_m) in zip(path.stamps_ns, path.world_t_reference, strict=True)
    ]


def _beacons(file: Path) -> TrueLandmarks:
    positions = numbers(file, "estbeac", load_mat(file, ("estbeac",))["estbeac"], (-1, 2))
    n = len(positions)
    return TrueLandmarks(positions, np.full(n, Kind.MARKER), np.full(n, np.nan))
