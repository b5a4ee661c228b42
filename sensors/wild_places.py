"""Reads the Wild-Places trees: trunks per frame of a 3D laser in a forest, and its trajectory.

The trees come in the tilted sensor's frame. They are levelled with the roll and pitch of the
trajectory, in place of those that an IMU would give; its yaw and position stay with the truth.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, Field

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import relative_poses
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.dead_reckoning import chain, in_order_of_time, odometry
from sensors.files import is_there, plain_or_gz
from sensors.measurements import OdometryNoise, Recording
from sensors.text_table import TextTable
from sensors.truth import Source, TruePath, Truth

TRAJECTORY_FILE = "trajectory.csv"
TREES_FILE = "trees.csv"
TRAJECTORY_COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
TREE_COLUMNS = ("frame", "x", "y", "z", "dbh", "dbh_approx", "score", "n_clusters")
MIN_RANGE_M = 0.5

LEAST_SIGMA_M = 0.018
SIGMA_OF_DIAMETER = 0.06
UNKNOWN_DIAMETER_M = 0.4
"""Of a trunk's centre along and across the beam, at a score of 1; about the median diameter is
taken where none could be measured.

From pairs of frames 24 s apart laid onto each other (19,394 pairs of trees within 0.25 m): the
variance is (0.018^2 + (0.058 d)^2) / score^1.02, the same along and across and hardly more far off.
Frames 3 s apart show the same points again, so they differ by a third of that. A tenth of the pairs
lies farther apart, and a third of the trees is not found again.
"""
LEAST_SCORE = 0.05
DIAMETER_SIGMA_OF_LN = 0.2
"""Of single trees: ln(dbh) differs with an sd of 0.26 between frames 3 s apart."""
BEARING_SIGMA = math.radians(0.06)
"""Of the same pairs: 1 cm at 10 m on top of what the trunk's centre errs across."""


class WildPlacesOptions(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """What a user may set.

    `max_range_m` leaves out trees beyond; `odometry` "noisy-truth" makes wheel odometry of the
    truth's motions with noise of `seed`; the recording itself has none.
    """

    max_range_m: float = Field(default=20.0, gt=MIN_RANGE_M)
    odometry: Literal["none", "noisy-truth"] = "none"
    seed: int = Field(default=0, ge=0)


def recognises(folder: Path) -> bool:
    """Whether a trajectory and trees per frame lie in the folder."""
    return is_there(folder / TRAJECTORY_FILE) and is_there(plain_or_gz(folder / TREES_FILE))


def read(path: Path, options: WildPlacesOptions) -> Source:
    """Levelled trees from base, one set a frame; the trajectory's x, y, yaw as truth.

    Trees whose diameter could not be measured (a quarter) have none.

    Raises:
        InputError: a file is missing, damaged, or a tree's frame is not in the trajectory.
    """
    trajectory = TextTable.of_csv(path / TRAJECTORY_FILE, TRAJECTORY_COLUMNS)
    if not len(trajectory):
        raise InputError(f"{trajectory.path}: expected at least one pose, there is none")
    stamps = trajectory.stamps_ns("t")
    map_R_sensors = _rotations(trajectory)
    yaws = np.arctan2(map_R_sensors[:, 1, 0], map_R_sensors[:, 0, 0])
    sets = _sets(path, stamps, _levelling(map_R_sensors, yaws), options.max_range_m)
    positions = np.column_stack([trajectory.numbers("x"), trajectory.numbers("y")])
    samples, noise = [], None
    if options.odometry == "noisy-truth":
        rng = np.random.default_rng(options.seed)
        poses, noise = _noisy_odometry(np.column_stack([positions, yaws]), rng), NOISE_OF_TRUTH
        samples = odometry(stamps, poses)
    recording = Recording(
        name="wild-places",
        measurements=in_order_of_time(samples, sets),
        num_scans=len(sets),
        odometry_noise=noise,
    )
    return Source(recording, Truth(TruePath(stamps, positions, yaws)))


def _rotations(table: TextTable) -> FloatArray:
    """(n, 3, 3) map_R_sensor."""
    from scipy.spatial.transform import Rotation

    quaternions = np.column_stack([table.numbers(name) for name in ("qx", "qy", "qz", "qw")])
    is_unit = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) < 0.01
    table.refuse(~is_unit, "qw", "a unit quaternion")
    return np.asarray(Rotation.from_quat(quaternions).as_matrix(), dtype=np.float64)


def _levelling(map_R_sensors: FloatArray, yaws: FloatArray) -> FloatArray:
    """(n, 3, 3) base_R_sensor: roll and pitch without the yaw."""
    c, s, o = np.cos(yaws), np.sin(yaws), np.zeros(len(yaws))
    base_R_maps = np.array([[c, s, o], [-s, c, o], [o, o, o + 1.0]]).transpose(2, 0, 1)
    return base_R_maps @ map_R_sensors


def _sets(
    path: Path, stamps: IntArray, base_R_sensors: FloatArray, max_range_m: float
) -> list[Perceptions]:
    table = TextTable.of_csv(plain_or_gz(path / TREES_FILE), TREE_COLUMNS[:5], TREE_COLUMNS[5:])
    frames = table.numbers("frame")
    is_frame = (frames == np.rint(frames)) & (frames >= 0) & (frames < len(stamps))
    table.refuse(~is_frame, "frame", f"a row of {TRAJECTORY_FILE} (0 to {len(stamps) - 1})")
    table.refuse(np.diff(frames, prepend=0.0) < 0.0, "frame", "frames that do not run backwards")
    rows = frames.astype(np.int64)
    points = np.column_stack(
        [table.numbers(axis, above=-1e6, at_most=1e6) for axis in ("x", "y", "z")]
    )
    levelled = np.einsum("nij,nj->ni", base_R_sensors[rows], points)
    diameters_m = table.numbers("dbh", above=0.0, at_most=100.0, or_none=True)
    has_scores = "score" in table.columns
    scores = table.numbers("score", above=0.0, at_most=1.0) if has_scores else np.ones(len(rows))
    ranges_m = np.hypot(levelled[:, 0], levelled[:, 1])
    kept = (ranges_m > MIN_RANGE_M) & (ranges_m <= max_range_m)
    trees = _trees(levelled[kept], diameters_m[kept], scores[kept])
    limits = np.searchsorted(rows[kept], np.arange(len(stamps) + 1))
    return [
        replace(trees.select(np.arange(*limits[k : k + 2])), stamp_ns=int(stamp_ns))
        for k, stamp_ns in enumerate(stamps)
    ]


def _trees(base_t_trees: FloatArray, diameters_m: FloatArray, scores: FloatArray) -> Perceptions:
    """The trees of all frames in one value; `scores` (n,) say how well each trunk was fitted."""
    x, y, _ = base_t_trees.T
    ranges_m = np.hypot(x, y)
    about_m = np.where(np.isnan(diameters_m), UNKNOWN_DIAMETER_M, diameters_m)
    sigmas_m = np.hypot(LEAST_SIGMA_M, SIGMA_OF_DIAMETER * about_m)
    sigmas_m /= np.sqrt(np.maximum(scores, LEAST_SCORE))
    return Perceptions.from_arrays(
        0,
        Kind.TREE,
        ranges_m,
        np.arctan2(y, x),
        polar_covariances(sigmas_m, np.hypot(BEARING_SIGMA, sigmas_m / ranges_m)),
        diameters_m=diameters_m,
        diameter_sigmas_m=DIAMETER_SIGMA_OF_LN * diameters_m,
    )


SHARE_OF_MOTION = 0.02
"""The made odometry errs by this share of each motion's length and turn."""
NOISE_OF_TRUTH = OdometryNoise(
    along_per_sqrt_m=0.03,
    across_per_sqrt_m=0.03,
    heading_per_sqrt_m=0.001,
    heading_per_sqrt_rad=0.01,
)
"""The same at this recording's frames, 2.0 m and 0.1 to 0.4 rad apart."""


def _noisy_odometry(map_T_bases: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n, 3) odom_T_base, starting at the identity."""
    motions = relative_poses(map_T_bases[:-1], map_T_bases[1:])
    lengths = np.hypot(motions[:, 0], motions[:, 1])
    scale = np.column_stack([lengths, lengths, np.abs(motions[:, 2])])
    noisy = motions + SHARE_OF_MOTION * scale * rng.standard_normal(motions.shape)
    return chain(noisy)
