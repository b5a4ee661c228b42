"""Reads one robot of UTIAS MRCLAM: barcode sightings, odometry, Vicon truth."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from semgraph.arrays import BoolArray, IntArray
from semgraph.errors import InputError
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.dead_reckoning import Twists, in_order_of_time, integrate
from sensors.files import is_there, plain_or_gz
from sensors.measurements import OdometryNoise, Recording, WheelOdometry
from sensors.text_table import TextTable
from sensors.truth import Source, TrueLandmarks, TruePath, Truth

LANDMARKS_FILE = "Landmark_Groundtruth.dat"
BARCODES_FILE = "Barcodes.dat"
NUM_ROBOTS = 5
# Without names: one or two barcodes a scan, of which posts stand 0.18 m apart.
_HYPOTHESES = 1000

RANGE_SIGMA_M = 0.12
RANGE_SIGMA_PER_M = 0.045
BEARING_SIGMA = 0.010
"""The camera's noise, from the residuals of all five robots against Vicon (15,383 sightings).

Range: sd 0.05-0.08 m at 1-2 m, 0.07-0.12 at 2-3, 0.13-0.17 at 3-4, 0.13-0.22 at 4-6, with a bias of
-0.07 to +0.11 m that stays for seconds, so that sightings in a row tell less than their number: the
sigma, hypot(0.12, 0.045 r), is that much wider. Bearing: sd 0.005-0.014 rad, and one robot's camera
is off by 0.014. Barcodes that belong to nothing are misread and dropped (6 of 19,377).
"""
ODOMETRY_NOISE = OdometryNoise(
    along_per_sqrt_m=0.05,
    across_per_sqrt_m=0.025,
    heading_per_sqrt_m=0.10,
    heading_per_sqrt_rad=0.06,
)
"""The iRobot Create's, from legs of 1 to 4 m against Vicon, all five robots.

Least squares of the squared differences, the worst 3 % left out: along 0.10-0.13 m per sqrt(m);
across 0.12-0.15, mostly heading. Legs share the errors of Vicon and of the clocks at their ends,
and are upper bounds: the wheels, taken at 0.4 of them, are the ones that hold the scale of the map
against the camera's range bias. Heading: legs of 1 m with wheels 0.2 s late say 0.08-0.11 rad per
sqrt(m) and 0.02-0.08 per sqrt(rad). With 0.10 and 0.06 an EKF with known landmarks and identities
finds 0.0-0.6 % of the sightings beyond the 99.9 % gate; with 0.04 and 0.036, 0.5-1.8 %.
Robot 4 once turned 0.96 rad more than its wheels.
"""
WHEELS_LATE_S = 0.2
"""How long after its record a speed is driven, for the records are commands.

In Vicon turns follow 0.15-0.2 s later (all five robots). The sightings say the same without Vicon:
of an EKF with known landmarks and identities the mean log likelihood of the innovations is highest
at 0.2-0.25 s for robots 1 to 3, by which it was chosen, and at 0.25-0.3 s for 4 and 5. At 0.2 s
0.0-0.6 % of them lie beyond the 99.9 % gate, at 0 0.7-2.4 %.
"""


class MrclamOptions(BaseModel, extra="forbid", frozen=True):
    """What a user may set.

    Attributes:
        robot: which one.
        identities: whether the estimator gets them.
        wheels_late_s: how long after its record a speed is driven.
    """

    robot: int = Field(default=1, ge=1, le=NUM_ROBOTS)
    identities: bool = True
    wheels_late_s: float = Field(default=WHEELS_LATE_S, ge=0.0, le=1.0)


def recognises(folder: Path) -> bool:
    """Whether an MRCLAM data set lies in the folder."""
    return is_there(plain_or_gz(folder / BARCODES_FILE))


def read(path: Path, options: MrclamOptions) -> Source:
    """One robot's sightings of the landmarks from base, its odometry, and Vicon as truth.

    The other robots are left out. Sightings with the same stamp form one set. Identities are the
    landmarks' subject numbers.

    Raises:
        InputError: a file is missing, damaged or empty.
    """
    landmarks = _table(path, LANDMARKS_FILE, ["subject", "x", "y", "x_sigma", "y_sigma"])
    subjects = _whole_numbers(landmarks, "subject")
    sightings = _table(path, f"Robot{options.robot}_Measurement.dat", _SIGHTING_COLUMNS)
    rows = _landmark_rows(path, sightings, subjects)
    names = subjects.astype(np.str_) if options.identities else np.full(len(subjects), "")
    sets, associations = _sets(sightings, rows, names)
    odometry = _odometry(path, options, np.array(list(associations), dtype=np.int64))
    recording = Recording(
        name=f"mrclam-robot-{options.robot}",
        measurements=in_order_of_time(odometry, sets),
        num_scans=len(sets),
        odometry_noise=ODOMETRY_NOISE,
        num_hypotheses=1 if options.identities else _HYPOTHESES,
    )
    truth = Truth(_true_path(path, options.robot), _true_landmarks(landmarks), associations)
    return Source(recording, truth)


_SIGHTING_COLUMNS = ["time", "barcode", "range", "bearing"]


def _table(path: Path, name: str, columns: list[str]) -> TextTable:
    file = plain_or_gz(path / name)
    table = TextTable.of_words(file, columns)
    if not len(table):
        raise InputError(f"{file}: expected at least one row, there is none")
    return table


def _whole_numbers(table: TextTable, name: str) -> IntArray:
    values = table.numbers(name, above=-1.0, at_most=1e9)
    table.refuse(values != np.rint(values), name, "a whole number")
    return values.astype(np.int64)


def _landmark_rows(path: Path, sightings: TextTable, subjects: IntArray) -> IntArray:
    """(n,) the row in the landmarks' file of each sighting; -1 for robots and misread barcodes."""
    barcodes = _table(path, BARCODES_FILE, ["subject", "barcode"])
    subject_of = dict(
        zip(
            _whole_numbers(barcodes, "barcode").tolist(),
            _whole_numbers(barcodes, "subject").tolist(),
            strict=True,
        )
    )
    row_of = {subject: row for row, subject in enumerate(subjects.tolist())}
    seen = _whole_numbers(sightings, "barcode").tolist()
    return np.array([row_of.get(subject_of.get(code, -1), -1) for code in seen], dtype=np.int64)


def _sets(
    sightings: TextTable, rows: IntArray, names: NDArray[np.str_]
) -> tuple[list[Perceptions], dict[int, IntArray]]:
    """The sightings of landmarks by stamp, and the landmark rows of each stamp."""
    stamps = sightings.stamps_ns("time", repeats=True)
    ranges_m, bearings = sightings.numbers("range", above=0.0), sightings.numbers("bearing")
    range_sigmas_m = np.hypot(RANGE_SIGMA_M, RANGE_SIGMA_PER_M * ranges_m)
    covariances = polar_covariances(range_sigmas_m, np.full(len(rows), BEARING_SIGMA))
    known = np.flatnonzero(rows >= 0)
    if not len(known):
        raise InputError(f"{sightings.path}: expected at least one landmark, there is none")
    groups = np.split(known, np.flatnonzero(np.diff(stamps[known])) + 1)
    sets = [
        Perceptions.from_arrays(
            int(stamps[at[0]]),
            Kind.MARKER,
            ranges_m[at],
            bearings[at],
            covariances[at],
            identities=names[rows[at]],
        )
        for at in groups
    ]
    return sets, {int(stamps[at[0]]): rows[at] for at in groups}


def _odometry(path: Path, options: MrclamOptions, scan_stamps_ns: IntArray) -> list[WheelOdometry]:
    table = _table(path, f"Robot{options.robot}_Odometry.dat", ["time", "speed", "yaw_rate"])
    stamps = table.stamps_ns("time", repeats=True) + round(1e9 * options.wheels_late_s)
    speeds = table.numbers("speed", above=-100.0, at_most=100.0)
    yaw_rates = table.numbers("yaw_rate", above=-100.0, at_most=100.0)
    last: BoolArray = np.append(np.diff(stamps) > 0, True)
    return integrate(Twists(stamps[last], speeds[last], yaw_rates[last]), scan_stamps_ns)


def _true_path(path: Path, robot: int) -> TruePath:
    table = _table(path, f"Robot{robot}_Groundtruth.dat", ["time", "x", "y", "heading"])
    positions = np.column_stack([table.numbers("x"), table.numbers("y")])
    return TruePath(table.stamps_ns("time"), positions, table.numbers("heading"))


def _true_landmarks(table: TextTable) -> TrueLandmarks:
    positions = np.column_stack([table.numbers("x"), table.numbers("y")])
    n = len(table)
    return TrueLandmarks(positions, np.full(n, Kind.MARKER), np.full(n, np.nan))
