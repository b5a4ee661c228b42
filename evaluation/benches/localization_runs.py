"""Localization tried on simulated drives: errors, qualities and times, scan by scan."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from evaluation.benches.localization_trials import (
    MapErrors,
    Mapped,
    Moment,
    Stand,
    drive,
    mapped,
)
from semgraph.alignment import Alignment, align
from semgraph.arrays import BoolArray, FloatArray
from semgraph.geometry import Pose2
from semgraph.localizer import Estimator, Localizer, LocalizerSettings, Start, Use

NEAR_M: Final = 0.3
NEAR_RAD: Final = float(np.radians(1.0))
_FAR_M: Final = 1.0
_CONFIDENT: Final = 0.9
_RADIUS_M: Final = 10.0


@dataclass(frozen=True, slots=True)
class Trial:
    """What is tried: a map, a drive in its stand, a start, and which estimators may be used.

    `within_m` starts within a radius; `carried_off_at` and `largest_step` as of `drive`.
    """

    errors: MapErrors = field(default_factory=MapErrors)
    num_scans: int = 51
    within_m: float | None = None
    carried_off_at: tuple[int, ...] = ()
    largest_step: tuple[float, float] | None = None
    use: Use = Use.BOTH


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Scan by scan (n,).

    Attributes:
        errors_m, turned: of the poses.
        qualities: claimed.
        is_fast: whether the fast estimator was at work.
        seconds: of processor time.
        best_m, best_turned: errors of the rigid alignment with the true matches of that scan
            alone; NaN where it has fewer than three.
        num_true: how many perceptions are of the map's trees.
    """

    errors_m: FloatArray
    turned: FloatArray
    qualities: FloatArray
    is_fast: BoolArray
    seconds: FloatArray
    best_m: FloatArray
    best_turned: FloatArray
    num_true: FloatArray

    @property
    def is_right(self) -> BoolArray:
        """Within 0.3 m and 1 deg."""
        right: BoolArray = (self.errors_m <= NEAR_M) & (self.turned <= NEAR_RAD)
        return right

    @property
    def is_confidently_wrong(self) -> BoolArray:
        """Claimed with 0.9 and more, and more than 1 m off."""
        wrong: BoolArray = (self.qualities > _CONFIDENT) & (self.errors_m > _FAR_M)
        return wrong


def try_it(file: Path, trial: Trial, seed: int) -> Run:
    """One drive of a seed, through a stand of a stem map.

    Raises:
        InputError: there is no such stem map.
    """
    rng = np.random.default_rng(seed)
    stand = Stand.read(file)
    with_map = mapped(stand, trial.errors, rng)
    moments = drive(
        stand,
        trial.num_scans,
        rng,
        carried_off_at=trial.carried_off_at,
        largest_step=trial.largest_step,
        diameters=trial.errors.diameters,
    )
    settings = LocalizerSettings(use=trial.use, seed=seed)
    # The map's own covariances tell all of its errors.
    return follow(with_map, moments, settings, _start(trial, moments[0].world_T_base, rng))


def follow(
    with_map: Mapped, moments: Sequence[Moment], settings: LocalizerSettings, start: Start
) -> Run:
    """One drive followed."""
    localizer = Localizer(with_map.fixed_map, settings, start)
    rows = []
    for moment in moments:
        before = time.process_time()
        found = localizer.step(moment.perceptions, moment.odometry)
        seconds = time.process_time() - before
        error = pose_error(found.map_T_base.pose, moment.world_T_base)
        is_fast = found.estimator is Estimator.FAST
        num_true = int((with_map.rows[moment.stems[moment.stems >= 0]] >= 0).sum())
        rows.append((*error, found.quality, is_fast, seconds, *_best(with_map, moment), num_true))
    errors_m, turned, qualities, is_fast, *others = np.array(rows).T
    return Run(errors_m, turned, qualities, is_fast > 0.5, *others)


def _start(trial: Trial, world_T_base: Pose2, rng: np.random.Generator) -> Start:
    if trial.within_m is None:
        return Start()
    way = float(rng.uniform(-np.pi, np.pi))
    off_m = trial.within_m * float(np.sqrt(rng.uniform()))
    point = (world_T_base.x + off_m * np.cos(way), world_T_base.y + off_m * np.sin(way))
    return Start(map_t_point=point, radius_m=trial.within_m)


def pose_error(estimate: Pose2, true: Pose2) -> tuple[float, float]:
    """Of a pose: m and rad."""
    off = estimate.between(true)
    return float(np.hypot(off.x, off.y)), abs(off.theta)


def _best(with_map: Mapped, moment: Moment) -> tuple[float, float]:
    """The bound: what the true matches of one scan tell."""
    rows = np.where(moment.stems >= 0, with_map.rows[moment.stems], -1)
    known = np.flatnonzero(rows >= 0)
    if len(known) < 3:
        return np.nan, np.nan
    landmarks, perceptions = with_map.fixed_map, moment.perceptions.select(known)
    covariances = perceptions.base_covariances() + landmarks.covariances[rows[known]]
    found = align(
        perceptions.base_t_landmarks(),
        landmarks.map_t_landmarks[rows[known]],
        0.5 * np.trace(covariances, axis1=1, axis2=2),
    )
    if not isinstance(found, Alignment):
        return np.nan, np.nan
    return pose_error(found.map_T_base.pose, moment.world_T_base)


def without(trial: Trial, use: Use) -> Trial:
    """The same with one estimator only."""
    return replace(trial, use=use)
