"""The paper's landmark-based localization and mapping, scan by scan (section 3.3)."""

from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.alignment import Alignment, Solve, align, fuse_with_prior
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.estimates import NoEstimate, NoEstimateReason
from semgraph.finding import SURE_LOG_ODDS, find_pose, log_odds_of_matches
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Perceptions
from semgraph.matching import Assignment, LocalMap, Matches, SweepRule, local_map, match
from semgraph.measurement_model import CHI2_2DOF_999, are_apart, mahalanobis2
from semgraph.motion_model import MotionNoise
from semgraph.movement import KNOWN_START, Movement
from semgraph.navigation_map import Averaging, NavigationMap

_MOST_TURNS: Final = 200
# With sigmas beyond so many search radii the radius says nothing.
_LOST_RADII: Final = 2.0
# Of what is remembered, this much is looked at: all, then ever less.
_FRESHER: Final = np.array([1.0, 0.5, 0.25])
_NO_MOTION: Final = UncertainPose2(Pose2(), np.zeros((3, 3)))


class Rules(Enum):
    """BEST is this project's version of the three steps, PAPER the printed one."""

    BEST = "best"
    PAPER = "paper"


class FastSettings(BaseModel):
    """Settings of the fast estimator.

    `memory_m`: landmarks not sighted for this distance driven are no longer matched. Finite, it
    makes the map's frame the drifting but continuous odom; infinite, early landmarks close loops.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    rules: Rules = Rules.BEST
    search_radius_m: float = Field(1.0, gt=0.0, le=100.0)
    insert_radius_m: float = Field(0.5, ge=0.0, le=100.0)
    sweep_max_rad: float = Field(0.35, ge=0.0, le=3.2)
    acceleration: float = Field(2.0, gt=0.0)
    angular_acceleration: float = Field(1.5, gt=0.0)
    map_sigma_m: float = Field(0.03, gt=0.0)
    memory_m: float = Field(np.inf, gt=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class FastStep:
    """What one scan gave.

    Attributes:
        stamp_ns: of the scan.
        map_T_base: the estimate, with its covariance relative to the map around it.
        motion: last_T_current by the motion model alone: independent of what was perceived.
        closed_form: the paper's estimate, or why there is none and the motion model carried on.
        landmark_ids: (n,) the landmark of each perception, -1 where it is left open.
    """

    stamp_ns: int
    map_T_base: UncertainPose2
    motion: UncertainPose2
    closed_form: Alignment | NoEstimate
    landmark_ids: IntArray


class FastEstimator:
    """Follows the robot from scan to scan in a map that it builds as it goes, or a fixed one."""

    def __init__(
        self, settings: FastSettings, map_T_start: Pose2, fixed_map: NavigationMap | None = None
    ) -> None:
        self._settings = settings
        self._is_paper = settings.rules is Rules.PAPER
        averaging = Averaging.SIGHTINGS if self._is_paper else Averaging.INFORMATION
        self._map = NavigationMap(averaging) if fixed_map is None else fixed_map
        self._is_fixed = fixed_map is not None
        self._movement = Movement(MotionNoise(settings.acceleration, settings.angular_acceleration))
        self._map_T_last = UncertainPose2(map_T_start, np.zeros((3, 3)))
        # Since anything was in the map that is around.
        self._moved_unseen = _NO_MOTION
        self._map_covariance = settings.map_sigma_m**2 * np.eye(2)
        self._driven_m, self._forgetting_at_m = 0.0, settings.memory_m

    @property
    def navigation_map(self) -> NavigationMap:
        """The map as it stands; a later `step` changes it."""
        return self._map

    def restart(self, map_T_base: UncertainPose2, stamp_ns: int) -> None:
        """The pose at a time is known from elsewhere; the movement up to it is not."""
        self._map_T_last, self._moved_unseen = map_T_base, _NO_MOTION
        self._movement.restart(stamp_ns)

    def step(self, perceptions: Perceptions, odometry: UncertainPose2 | None) -> FastStep:
        """The pose at these perceptions, after which they are in the map.

        Args:
            perceptions: relative to base.
            odometry: last_T_current as the wheels measured it; None where there are none.
        """
        motion, map_T_proposed, is_guess = self._expect(perceptions, odometry)
        stamp_ns = perceptions.stamp_ns
        told = self._movement.told(stamp_ns, motion) if odometry is None else motion
        near, estimate = self._look_around(perceptions, map_T_proposed)
        if is_guess and self._is_by_chance(perceptions, near, estimate, map_T_proposed):
            map_T_proposed = self._begin_anew(map_T_proposed.pose)
            near, estimate = self._look_around(perceptions, map_T_proposed)
        map_T_base = UncertainPose2(
            map_T_proposed.pose @ estimate.proposed_T_base.pose, estimate.proposed_T_base.covariance
        )
        landmark_ids = self._update_map(perceptions, map_T_base, near, estimate.matches)
        num_known = int((landmark_ids >= 0).sum())
        self._moved_unseen = _NO_MOTION if num_known else self._moved_unseen @ motion
        self._movement.note(
            stamp_ns,
            motion.pose,
            self._map_T_last.pose.between(map_T_base.pose),
            num_known,
            is_seen=len(estimate.matches) > 0,
            is_perceived=isinstance(estimate.closed_form, Alignment),
        )
        self._move_on(map_T_base)
        return FastStep(stamp_ns, map_T_base, told, estimate.closed_form, landmark_ids)

    def _expect(
        self, perceptions: Perceptions, odometry: UncertainPose2 | None
    ) -> tuple[UncertainPose2, UncertainPose2, bool]:
        """The movement, where it led, and whether that is a guess, of what is usual.

        Where the motion says too little, by where all perceptions together stand in the map.
        """
        motion = odometry or self._movement.expected(perceptions.stamp_ns)
        map_T_proposed = self._map_T_last @ motion
        if not self._is_lost(motion):
            # Each motion by itself may be sure enough, and all since anything was seen not.
            is_guess = len(perceptions) > 0 and self._is_lost(self._moved_unseen @ motion)
            return motion, map_T_proposed, is_guess
        # Wheels that measured a motion say where it led, however unsurely.
        map_T_last = self._map_T_last if odometry is None else map_T_proposed
        placed = self._find_itself(perceptions, map_T_last.pose, map_T_proposed)
        if placed is not None:
            return motion, placed, False
        motion = odometry or self._movement.usual(perceptions.stamp_ns)
        return motion, *self._go_on(perceptions, motion)

    def _look_around(
        self, perceptions: Perceptions, map_T_proposed: UncertainPose2
    ) -> "tuple[LocalMap, _Estimate]":
        """Steps 1 and 2: what is perceived, in the map, and the pose by it."""
        near, matches = self._find_correspondences(perceptions, map_T_proposed)
        return near, self._estimate(perceptions, near, matches, map_T_proposed.covariance)

    def _find_correspondences(
        self, perceptions: Perceptions, map_T_proposed: UncertainPose2
    ) -> tuple[LocalMap, Matches]:
        """Step 1: what is perceived, in the map, by the best of several proposed rotations."""
        radius_m = self._settings.search_radius_m
        near = local_map(
            self._map, map_T_proposed.pose, perceptions, 2.0 * radius_m, self.remembered_since_m
        )
        rotations = self._rotations(perceptions, map_T_proposed)
        assignment = Assignment.NEAREST if self._is_paper else Assignment.ONE_TO_ONE
        rule = SweepRule.LOWEST_MEAN_DEVIATION if self._is_paper else SweepRule.MOST_MATCHES
        return near, match(perceptions, near, rotations, radius_m, assignment, rule)

    def _rotations(self, perceptions: Perceptions, map_T_proposed: UncertainPose2) -> FloatArray:
        """Zero first, then ever larger, as far as the motion model may err.

        One step moves the farthest landmark by half the search radius; what seems to lie
        kilometres away does not make them endless.
        """
        reach = max(float(perceptions.ranges_m.max(initial=1.0)), 1.0)
        step = 0.5 * self._settings.search_radius_m / reach
        sigma = float(map_T_proposed.covariance[2, 2]) ** 0.5
        limit = min(self._settings.sweep_max_rad, 2.0 * sigma)
        step = max(step, limit / _MOST_TURNS)
        turns = step * np.arange(1, int(limit / step) + 1)
        return np.concatenate([[0.0], np.column_stack([turns, -turns]).ravel()])

    def _estimate(
        self, perceptions: Perceptions, near: LocalMap, matches: Matches, covariance: FloatArray
    ) -> "_Estimate":
        """Step 2: the movement in closed form; the motion model carries on where there is none."""
        if self._is_paper:
            closed_form = self._align(perceptions, near, matches)
            if isinstance(closed_form, NoEstimate):
                return _Estimate(closed_form, matches, UncertainPose2(Pose2(), covariance))
            return _Estimate(closed_form, matches, closed_form.map_T_base)
        closed_form = self._align(perceptions, near, matches)
        if isinstance(closed_form, Alignment):
            moved = near.seen_from(closed_form.map_T_base.pose)
            radius_m = self._settings.insert_radius_m
            matches = match(perceptions, moved, np.zeros(1), radius_m)
            closed_form = self._align(perceptions, near, matches)
        return self._agree(perceptions, near, matches, closed_form, covariance)

    def _agree(
        self,
        perceptions: Perceptions,
        near: LocalMap,
        matches: Matches,
        closed_form: Alignment | NoEstimate,
        covariance: FloatArray,
    ) -> "_Estimate":
        """Closed form and motion model together; matches that contradict both are dropped."""
        prior = UncertainPose2(Pose2(), covariance)
        while True:
            start = closed_form.map_T_base.pose if isinstance(closed_form, Alignment) else Pose2()
            perceived = perceptions.base_t_landmarks()[matches.rows]
            mapped = near.proposed_t_landmarks[matches.columns]
            covariances = self._pair_covariances(perceptions, near, matches)
            fused = fuse_with_prior(start, prior, perceived, mapped, covariances)
            residuals = fused.pose.inverse().transform(mapped) - perceived
            distances2 = mahalanobis2(residuals, covariances)
            agrees = distances2 <= CHI2_2DOF_999
            if agrees.all():
                return _Estimate(closed_form, matches, fused)
            matches = matches.select(np.arange(len(matches)) != int(distances2.argmax()))
            closed_form = self._align(perceptions, near, matches)

    def _align(
        self, perceptions: Perceptions, near: LocalMap, matches: Matches
    ) -> Alignment | NoEstimate:
        if len(perceptions) == 0:
            return NoEstimate(NoEstimateReason.NO_PERCEPTIONS)
        variances = 0.5 * np.trace(
            self._pair_covariances(perceptions, near, matches), axis1=1, axis2=2
        )
        return align(
            perceptions.base_t_landmarks()[matches.rows],
            near.proposed_t_landmarks[matches.columns],
            variances,
            Solve.SIMILARITY if self._is_paper else Solve.RIGID,
        )

    def _pair_covariances(
        self, perceptions: Perceptions, near: LocalMap, matches: Matches
    ) -> FloatArray:
        """(n, 2, 2) in base: of a perception, of its landmark, and of the map around it."""
        return (
            perceptions.base_covariances()[matches.rows]
            + near.covariances[matches.columns]
            + self._map_covariance
        )

    def _update_map(
        self, perceptions: Perceptions, map_T_base: UncertainPose2, near: LocalMap, matches: Matches
    ) -> IntArray:
        """Step 3: matched landmarks are sighted once more, new ones inserted; none if fixed."""
        landmark_ids = np.full(len(perceptions), -1, dtype=np.int64)
        landmark_ids[matches.rows] = near.ids[matches.columns]
        if self._is_fixed:
            return landmark_ids
        positions, covariances = map_T_base.transform(
            perceptions.base_t_landmarks(), perceptions.base_covariances()
        )
        sighted = np.unique(landmark_ids[matches.rows], return_index=True)[1]
        rows = matches.rows[sighted]
        self._map.update(
            landmark_ids[rows],
            perceptions.select(rows),
            positions[rows],
            covariances[rows],
            self._driven_m,
        )
        new = np.flatnonzero(self._is_new(perceptions, positions, covariances, landmark_ids))
        landmark_ids[new] = self._map.insert(
            perceptions.select(new), positions[new], covariances[new], self._driven_m
        )
        return landmark_ids

    def _is_new(
        self,
        perceptions: Perceptions,
        positions: FloatArray,
        covariances: FloatArray,
        landmark_ids: IntArray,
    ) -> BoolArray:
        """Unmatched, and nothing around that it may be; an identity is new by itself."""
        settings = self._settings
        radius_m = settings.search_radius_m if self._is_paper else settings.insert_radius_m
        is_new = landmark_ids < 0
        for k in np.flatnonzero(is_new & (perceptions.identities == "")):
            around = self._map.near(positions[k], radius_m, self.remembered_since_m)
            around = around[self._map.kinds(around) == perceptions.kinds[k]]
            is_new[k] = not len(around) or (
                not self._is_paper
                and bool(np.isin(around, landmark_ids).all())
                and self._is_apart(positions[k], covariances[k], perceptions.diameters_m[k], around)
            )
        return is_new

    def _is_apart(
        self, position: FloatArray, covariance: FloatArray, diameter_m: float, others: IntArray
    ) -> bool:
        """Whether what is here is beside each of these, neither one of them nor a part of it."""
        offsets = self._map.positions(others) - position
        covariances = covariance + self._map.covariances(others) + self._map_covariance
        diameters_m, _ = self._map.diameters(others)
        return bool(are_apart(offsets, covariances, diameter_m, diameters_m).all())

    def _is_lost(self, motion: UncertainPose2) -> bool:
        """Whether the motion is so unsure that what is within the radius is so by chance."""
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(motion.covariance[:2, :2])[-1]))
        return not self._is_paper and sigma_m > _LOST_RADII * self._settings.search_radius_m

    def _find_itself(
        self, perceptions: Perceptions, map_T_last: Pose2, map_T_proposed: UncertainPose2
    ) -> UncertainPose2 | None:
        """Where all perceptions together stand in the map around; None if that is not sure enough.

        Where not in all that is remembered, then in what was sighted last: much of the rest may be
        hidden by now, which speaks against any place.
        """
        # What saw nothing for a while may be where nothing is known.
        least_log_odds = 0.0 if self._moved_unseen is _NO_MOTION else SURE_LOG_ODDS
        for remembered_m in np.unique(self._settings.memory_m * _FRESHER)[::-1].tolist():
            since_m = self._driven_m - remembered_m
            placed = find_pose(
                self._map, perceptions, map_T_last, map_T_proposed, since_m, least_log_odds
            )
            if placed is not None:
                return placed
        return None

    def _go_on(
        self, perceptions: Perceptions, motion: UncertainPose2
    ) -> tuple[UncertainPose2, bool]:
        """The pose of one that did not find itself, by what is usual, and whether to doubt it.

        Where that says too little, nothing can be matched: what would be, would be by chance. Where
        nothing is perceived nothing is matched, and so nothing doubted or forgotten.
        """
        map_T_base = self._map_T_last @ motion
        if not len(perceptions) or not np.isfinite(self._settings.memory_m):
            return map_T_base, False
        if self._is_lost(motion):
            return self._begin_anew(map_T_base.pose), False
        return map_T_base, True

    def _begin_anew(self, map_T_base: Pose2) -> UncertainPose2:
        """A map that only remembers forgets what it had.

        It begins at the pose as it is believed, which is where it is by definition.
        """
        # And a hair more: what was sighted from this very place is forgotten too.
        self._driven_m = float(np.nextafter(self._driven_m + self._settings.memory_m, np.inf))
        return UncertainPose2(map_T_base, KNOWN_START)

    def _is_by_chance(
        self,
        perceptions: Perceptions,
        near: LocalMap,
        estimate: "_Estimate",
        map_T_proposed: UncertainPose2,
    ) -> bool:
        """Whether the matches may be so: two that are as far apart as two others are everywhere.

        What bears a name is what it is.
        """
        matches = estimate.matches
        if (perceptions.identities[matches.rows] != "").any():
            return False
        log_odds = log_odds_of_matches(
            perceptions.base_t_landmarks()[matches.rows],
            near.proposed_t_landmarks[matches.columns],
            self._pair_covariances(perceptions, near, matches),
            map_T_proposed.covariance,
            estimate.proposed_T_base,
            perceptions,
        )
        return log_odds < SURE_LOG_ODDS

    @property
    def remembered_since_m(self) -> float:
        """The distance driven before which landmarks are forgotten."""
        return self._driven_m - self._settings.memory_m

    def _move_on(self, map_T_base: UncertainPose2) -> None:
        """The robot is here now; what was not sighted for long is forgotten."""
        step = self._map_T_last.pose.between(map_T_base.pose)
        self._driven_m += float(np.hypot(step.x, step.y))
        if self._driven_m >= self._forgetting_at_m and not self._is_fixed:
            self._map.forget(self.remembered_since_m)
            self._forgetting_at_m = self._driven_m + self._settings.memory_m
        self._map_T_last = map_T_base


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """The movement from the proposed frame, and the matches that it rests on."""

    closed_form: Alignment | NoEstimate
    matches: Matches
    proposed_T_base: UncertainPose2
