"""Simulated drives through a real stand with a map of it: what localization is tried on."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import Pose2, UncertainPose2, wrap_angle
from semgraph.known_map.fixed_map import FixedMap
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from semgraph.motion_model import STANDSTILL_COVARIANCE, odometry_covariance
from sensors.measurements import OdometryNoise
from sensors.text_table import TextTable

REACH_M: Final = 15.0
SECONDS: Final = 0.2
STEP_M: Final = 0.2
_FIELD: Final = np.radians(270.0)
_RANGE_SIGMA_M: Final = 0.03
_BEARING_SIGMA: Final = 0.005
_DIAMETER_SIGMA: Final = 0.1
_MAPPED_DIAMETER_SIGMA: Final = 0.05
_MISSED: Final = 0.2
_CLUTTER: Final = 1.0
_KEPT_FREE_M: Final = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class Stand:
    """Real stems: (m, 2) positions and (m,) diameters, m."""

    world_t_stems: FloatArray
    diameters_m: FloatArray

    @classmethod
    def read(cls, file: Path, metres_a_mark: float = 0.01) -> "Stand":
        """Of a table x,y,mark.

        Raises:
            InputError: malformed.
        """
        table = TextTable.of_csv(file, ("x", "y", "mark"))
        positions = np.column_stack([table.numbers("x"), table.numbers("y")])
        return cls(positions, metres_a_mark * table.numbers("mark", above=0.0))


@dataclass(frozen=True, slots=True)
class MapErrors:
    """What is wrong with a map.

    `missing` is the share of trees that it lacks, `false` the share of landmarks that are none.
    """

    sigma_m: float = 0.1
    missing: float = 0.0
    false: float = 0.0
    diameters: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """A map, and the (n,) row in it of each stem of the stand, -1 for those that it lacks."""

    fixed_map: FixedMap
    rows: IntArray


def mapped(stand: Stand, errors: MapErrors, rng: np.random.Generator) -> Mapped:
    """A map of the stand with these errors; its covariances tell them as they are."""
    n = len(stand.diameters_m)
    kept = rng.uniform(size=n) >= errors.missing
    places = stand.world_t_stems[kept] + errors.sigma_m * rng.standard_normal((kept.sum(), 2))
    diameters_m = stand.diameters_m[kept]
    num_false = round(errors.false * n)
    low, high = stand.world_t_stems.min(axis=0), stand.world_t_stems.max(axis=0)
    places = np.vstack([places, rng.uniform(low, high, (num_false, 2))])
    diameters_m = np.append(diameters_m, rng.choice(stand.diameters_m, num_false))
    m = len(places)
    diameters_m = diameters_m * np.exp(_MAPPED_DIAMETER_SIGMA * rng.standard_normal(m))
    if not errors.diameters:
        diameters_m = np.full(m, np.nan)
    made = FixedMap(
        places,
        np.tile(errors.sigma_m**2 * np.eye(2), (m, 1, 1)),
        np.full(m, int(Kind.TREE)),
        diameters_m,
        _MAPPED_DIAMETER_SIGMA * diameters_m,
        np.full(m, "", dtype=np.str_),
    )
    rows: IntArray = np.where(kept, np.cumsum(kept) - 1, -1).astype(np.int64)
    return Mapped(made, rows)


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One scan of a drive: where the robot is, what it perceives, how its wheels say it moved.

    `stems` (k,) is the stem of each perception, -1 for none.
    """

    world_T_base: Pose2
    perceptions: Perceptions
    stems: IntArray
    odometry: UncertainPose2 | None


def drive(
    stand: Stand,
    num_scans: int,
    rng: np.random.Generator,
    *,
    carried_off_at: tuple[int, ...] = (),
    largest_step: tuple[float, float] | None = None,
    diameters: bool = True,
) -> list[Moment]:
    """A winding drive, 0.2 m a scan, inside the stand.

    Args:
        stand: where.
        num_scans: five a second.
        rng: of the way and of all noise.
        carried_off_at: scans before which the robot is carried anywhere, which no wheel tells.
        largest_step: without wheels, every tenth motion is up to so many m and rad.
        diameters: whether perceptions have them.
    """
    pose = _anywhere(stand, rng)
    moments: list[Moment] = []
    turn = 0.0
    for k in range(num_scans):
        turn = 0.9 * turn + 0.02 * float(rng.standard_normal())
        motion = Pose2(STEP_M, 0.0, _kept_inside(stand, pose, turn))
        if largest_step is not None and k % 10 == 9:
            motion = _large(stand, pose, largest_step, rng)
        if k == 0:
            motion = Pose2()
        wheels = _wheels(motion, rng) if largest_step is None else None
        pose = pose @ motion
        if k in carried_off_at:
            pose = _anywhere(stand, rng)
            wheels = _wheels(Pose2(), rng)
        stamp_ns = round(k * SECONDS * 1e9)
        perceptions, stems = perceive(stand, pose, stamp_ns, rng, diameters=diameters)
        moments.append(Moment(pose, perceptions, stems, wheels))
    return moments


def perceive(
    stand: Stand,
    world_T_base: Pose2,
    stamp_ns: int,
    rng: np.random.Generator,
    *,
    diameters: bool = True,
) -> tuple[Perceptions, IntArray]:
    """What a laser of 270 deg would show, a fifth missed and one thing more, and whose it is."""
    base_t = world_T_base.inverse().transform(stand.world_t_stems)
    ranges_m, bearings = (
        np.hypot(base_t[:, 0], base_t[:, 1]),
        np.arctan2(base_t[:, 1], base_t[:, 0]),
    )
    inside = (ranges_m < REACH_M) & (ranges_m > 0.3) & (np.abs(bearings) < 0.5 * _FIELD)
    inside &= ~_is_hidden(ranges_m, bearings, stand.diameters_m)
    rows = np.flatnonzero(inside & (rng.uniform(size=len(inside)) >= _MISSED))
    num_false = int(rng.poisson(_CLUTTER))
    ranges_m = np.append(ranges_m[rows], np.sqrt(rng.uniform(1.0, REACH_M**2, num_false)))
    bearings = np.append(bearings[rows], 0.5 * _FIELD * rng.uniform(-1.0, 1.0, num_false))
    diameters_m = np.append(stand.diameters_m[rows], rng.choice(stand.diameters_m, num_false))
    n = len(ranges_m)
    diameters_m = diameters_m * np.exp(_DIAMETER_SIGMA * rng.standard_normal(n))
    if not diameters:
        diameters_m = np.full(n, np.nan)
    perceptions = Perceptions.from_arrays(
        stamp_ns,
        Kind.TREE,
        np.maximum(ranges_m + _RANGE_SIGMA_M * rng.standard_normal(n), 0.05),
        wrap_angle(bearings + _BEARING_SIGMA * rng.standard_normal(n)),
        polar_covariances(np.full(n, _RANGE_SIGMA_M), np.full(n, _BEARING_SIGMA)),
        diameters_m=diameters_m,
        diameter_sigmas_m=_DIAMETER_SIGMA * diameters_m,
    )
    return perceptions, np.append(rows, np.full(num_false, -1))


def _wheels(motion: Pose2, rng: np.random.Generator) -> UncertainPose2:
    covariance = odometry_covariance(motion, OdometryNoise()) + STANDSTILL_COVARIANCE
    error = rng.multivariate_normal(np.zeros(3), covariance)
    return UncertainPose2(motion @ Pose2.from_array(error), covariance)


def _anywhere(stand: Stand, rng: np.random.Generator) -> Pose2:
    low = stand.world_t_stems.min(axis=0) + _KEPT_FREE_M
    high = stand.world_t_stems.max(axis=0) - _KEPT_FREE_M
    x, y = rng.uniform(low, high).tolist()
    return Pose2(x, y, float(rng.uniform(-np.pi, np.pi)))


def _kept_inside(stand: Stand, pose: Pose2, turn: float) -> float:
    """The turn, or one towards the middle where the edge is near."""
    low, high = stand.world_t_stems.min(axis=0), stand.world_t_stems.max(axis=0)
    here = pose.as_array()[:2]
    if (here > low + _KEPT_FREE_M).all() and (here < high - _KEPT_FREE_M).all():
        return turn
    x, y = 0.5 * (low + high) - here
    return float(np.clip(wrap_angle(float(np.arctan2(y, x)) - pose.theta), -0.1, 0.1))


def _large(
    stand: Stand, pose: Pose2, largest: tuple[float, float], rng: np.random.Generator
) -> Pose2:
    """A motion of up to so many m and rad that stays inside."""
    low, high = stand.world_t_stems.min(axis=0) + 5.0, stand.world_t_stems.max(axis=0) - 5.0
    while True:
        way = float(rng.uniform(-np.pi, np.pi))
        far_m = float(rng.uniform(0.0, largest[0]))
        turn = float(rng.uniform(-largest[1], largest[1]))
        motion = Pose2(far_m * np.cos(way), far_m * np.sin(way), turn)
        place = (pose @ motion).as_array()[:2]
        if (place > low).all() and (place < high).all():
            return motion


def _is_hidden(ranges_m: FloatArray, bearings: FloatArray, diameters_m: FloatArray) -> BoolArray:
    """(n,) whether a stem's centre lies behind a nearer stem."""
    near = np.flatnonzero(ranges_m < REACH_M)
    half = np.arcsin(np.minimum(0.5 * diameters_m[near] / np.maximum(ranges_m[near], 1e-6), 1.0))
    apart = np.abs(wrap_angle(bearings[:, None] - bearings[None, near]))
    hidden = (apart < half[None]) & (ranges_m[None, near] < ranges_m[:, None])
    return np.asarray(hidden.any(axis=1))
