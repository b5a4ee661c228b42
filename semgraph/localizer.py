"""The two estimators together in a known map: fast, accurate and reliable (end of section 3.3).

The rule. A run begins with the particle filter. It hands over to the fast estimator once, for three
scans in a row, all particles are at one place, known to 0.3 m and 3 deg, with a quality of 0.95 or
more, and no motion is large. The fast estimator hands back as soon as

- the motion between two scans is large: over 1 m or 20 deg, or not known to 0.5 m and 10 deg;
- few matches are found, so few that the scan is explained no better than in the mean of all places;
- its estimate lies outside the 99.9 % gate of the motion model (the matches contradict it);
- the quality falls below 0.5.

The particle filter then weighs the same scan again, beginning with the pose before the motion and
its covariance. What the fast estimator takes over is the particles' mean and covariance. Either way
the probability of being elsewhere goes along. Where no wheels measure the motion, the last one goes
on; a leap is none, nor a place corrected: what contradicts it is believed when it comes twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.errors import InputError
from semgraph.fast_estimator import FastEstimator, FastSettings, FastStep
from semgraph.geometry import Pose2, UncertainPose2, pose_in_degrees
from semgraph.known_map.belief import Belief
from semgraph.known_map.fixed_map import FixedMap
from semgraph.known_map.particles import Gaussian
from semgraph.known_map.pose_likelihood import PoseLikelihood
from semgraph.known_map.pose_quality import Elsewhere, PerceivedLately
from semgraph.known_map.surroundings import Surroundings
from semgraph.landmarks import Perceptions
from semgraph.motion_model import MotionNoise, constant_motion
from semgraph.particle_filter import FilterSettings, ParticleFilter

_LARGE_M: Final = 1.0
_LARGE_RAD: Final = float(np.radians(20.0))
_UNKNOWN_M: Final = 0.5
_UNKNOWN_RAD: Final = float(np.radians(10.0))
# Chi-square quantile of 3 degrees of freedom.
_CHI2_3DOF_999: Final = 16.266
_LOST_BELOW: Final = 0.5
_SURE_ABOVE: Final = 0.95
_SURE_M: Final = 0.3
_SURE_RAD: Final = float(np.radians(3.0))
_SURE_SCANS: Final = 3
_WITHIN_M: Final = 1.0
# How exactly a user knows where the robot starts.
_START_SIGMA_M: Final = 0.5
_START_SIGMA_RAD: Final = float(np.radians(5.0))


class Estimator(Enum):
    """Which of the two a pose is of."""

    FAST = "fast"
    PARTICLES = "particles"


class Use(Enum):
    """Which of the two may be used."""

    BOTH = "both"
    FAST = "fast"
    PARTICLES = "particles"


class LocalizerSettings(BaseModel):
    """Settings of both.

    `listed_sigma_m` is how far landmarks may be off in a map that is a mere list. To compare,
    `use` keeps to one of them; the fast one needs the particles to begin with.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    particles: FilterSettings = FilterSettings()
    fast: FastSettings = FastSettings()
    use: Use = Use.BOTH
    listed_sigma_m: float = Field(0.1, gt=0.0, le=10.0)
    seed: int = Field(0, ge=0)


@dataclass(frozen=True, slots=True)
class Start:
    """Where the robot may be at the start: at a pose, within a radius of a point, or anywhere."""

    map_T_base: UncertainPose2 | None = None
    map_t_point: tuple[float, float] = (0.0, 0.0)
    radius_m: float | None = None


def start_of(pose: Sequence[float] | None, circle: Sequence[float] | None) -> Start:
    """The start of a command line.

    Args:
        pose: x, y in m and yaw in degrees, good to half a metre and 5 degrees; or None.
        circle: radius, x, y in m; or None.

    Raises:
        InputError: a number is not finite, or the radius not above 0.
    """
    if pose is not None:
        sigmas = np.array([_START_SIGMA_M, _START_SIGMA_M, _START_SIGMA_RAD])
        return Start(UncertainPose2(pose_in_degrees(*pose), np.diag(sigmas**2)))
    if circle is None:
        return Start()
    radius_m, x, y = circle
    if not (0.0 < radius_m < np.inf and np.isfinite([x, y]).all()):
        raise InputError(f"start: expected a radius above 0 and a point, got {radius_m}, {x}, {y}")
    return Start(map_t_point=(x, y), radius_m=radius_m)


@dataclass(frozen=True, slots=True, eq=False)
class Localized:
    """Where the robot is after a scan.

    Attributes:
        stamp_ns: of the scan.
        map_T_base: with its covariance.
        quality: the probability that the robot is within 1 m of it.
        estimator: whose pose it is.
        num_particles: 0 of the fast estimator.
    """

    stamp_ns: int
    map_T_base: UncertainPose2
    quality: float
    estimator: Estimator
    num_particles: int


class Localizer:
    """Follows one robot in one map from a start."""

    def __init__(self, fixed_map: FixedMap, settings: LocalizerSettings, start: Start) -> None:
        self._settings = settings
        self._likelihood = PoseLikelihood(fixed_map, settings.particles.likelihood)
        rng = np.random.default_rng(settings.seed)
        self._filter = ParticleFilter(self._likelihood, settings.particles, rng)
        self._fast = FastEstimator(settings.fast, Pose2(), fixed_map.navigation_map())
        self._noise = MotionNoise(settings.fast.acceleration, settings.fast.angular_acceleration)
        self._surroundings = Surroundings(settings.fast)
        self._elsewhere = Elsewhere(0.01)
        self._estimator = Estimator.PARTICLES
        self._sure_scans = 0
        self._perceived = PerceivedLately()
        self._share_confirmed = 0.0
        self._last: Localized | None = None
        self._movement = _Movement(Pose2(), 0.0)
        self._doubted: _Movement | None = None
        self._events: list[str] = []
        if start.radius_m is not None:
            self._filter.start_within(np.array(start.map_t_point), start.radius_m)
        elif start.map_T_base is not None:
            self._filter.start_at(start.map_T_base)

    @property
    def events(self) -> tuple[str, ...]:
        """Each change from one estimator to the other, and why."""
        return tuple(self._events)

    def step(self, perceptions: Perceptions, odometry: UncertainPose2 | None) -> Localized:
        """The pose at these perceptions.

        Args:
            perceptions: relative to base.
            odometry: last_T_current as the wheels measured it; None where there are none.
        """
        motion = self._motion(perceptions.stamp_ns, odometry)
        leaps = self._settings.particles.leaps if odometry is None else 0.0
        self._share_confirmed = self._perceived.share_confirmed(
            perceptions.base_t_landmarks(), motion.pose
        )
        found = None
        if self._estimator is Estimator.FAST and self._last is not None:
            found = self._follow(perceptions, motion, self._last, leaps)
        if found is None:
            found = self._search(perceptions, motion, odometry, leaps)
        self._remember(found)
        return found

    def _motion(self, stamp_ns: int, odometry: UncertainPose2 | None) -> UncertainPose2:
        """By the wheels, else the last movement of the estimates once more."""
        if self._last is None:
            return UncertainPose2(Pose2(), np.zeros((3, 3)))
        if odometry is not None:
            return odometry
        seconds = (stamp_ns - self._last.stamp_ns) * 1e-9
        return self._movement.once_more(seconds, self._noise)

    def _follow(
        self, perceptions: Perceptions, motion: UncertainPose2, last: Localized, leaps: float
    ) -> Localized | None:
        """The fast estimator's pose; None if the particles have to take over."""
        is_bound = self._settings.use is Use.FAST
        doubt = replace(self._elsewhere)
        if (why := _too_large(motion)) and not is_bound:
            self._hand_to_particles(last, perceptions.stamp_ns, why, doubt)
            return None
        step = self._fast.step(perceptions, motion)
        prior = last.map_T_base @ motion
        self._elsewhere.move(motion.pose, self._settings.particles.carried_off + leaps)
        self._filter.usual.add(perceptions.ranges_m, perceptions.bearings)
        evidence = self._evidence(perceptions, prior, step.map_T_base)
        self._elsewhere.weigh(evidence, self._share_confirmed)
        quality = (1.0 - self._elsewhere.probability) * _share_within(step.map_T_base)
        why = _alarm(step, prior, evidence) or _lost(quality)
        if why and not is_bound:
            self._hand_to_particles(last, perceptions.stamp_ns, why, doubt)
            return None
        return Localized(perceptions.stamp_ns, step.map_T_base, quality, Estimator.FAST, 0)

    def _evidence(
        self, perceptions: Perceptions, prior: UncertainPose2, posterior: UncertainPose2
    ) -> float:
        """Log of how much better the scan is explained here than anywhere, by Laplace's method."""
        if not len(perceptions):
            return 0.0
        seen = self._likelihood.see(perceptions)
        pose = posterior.pose.as_array()[None]
        at_best = float(self._likelihood.log_likelihoods(seen, pose)[0])
        wide, narrow = Gaussian.of_pose(prior), Gaussian.of_pose(posterior)
        of_motion = float(wide.log_densities(pose)[0]) - narrow.log_peak()
        return at_best + of_motion + self._filter.by_numbers(narrow.mean)

    def _search(
        self,
        perceptions: Perceptions,
        motion: UncertainPose2,
        odometry: UncertainPose2 | None,
        leaps: float,
    ) -> Localized:
        """The particle filter's pose; it hands over to the fast estimator when it is sure."""
        lately = self._surroundings.add(perceptions, odometry)
        belief = self._filter.step(perceptions, motion, lately, leaps, self._share_confirmed)
        is_sure = _is_sure(belief) and not _too_large(motion)
        self._sure_scans = self._sure_scans + 1 if is_sure else 0
        if self._sure_scans >= _SURE_SCANS and self._settings.use is not Use.PARTICLES:
            self._hand_to_fast(belief)
        return Localized(
            belief.stamp_ns,
            belief.map_T_base,
            belief.quality,
            Estimator.PARTICLES,
            belief.num_particles,
        )

    def _hand_to_fast(self, belief: Belief) -> None:
        self._estimator = Estimator.FAST
        self._sure_scans = 0
        self._fast.restart(belief.map_T_base, belief.stamp_ns)
        self._elsewhere = replace(self._filter.elsewhere)
        self._tell(belief.stamp_ns, "fast estimator", f"quality {belief.quality:.2f}")

    def _hand_to_particles(
        self, last: Localized, stamp_ns: int, why: str, doubt: Elsewhere
    ) -> None:
        self._estimator = Estimator.PARTICLES
        self._filter.start_at(last.map_T_base, doubt)
        self._surroundings.forget()
        self._tell(stamp_ns, "particle filter", why)

    def _tell(self, stamp_ns: int, who: str, why: str) -> None:
        self._events.append(f"{who} takes over at {stamp_ns * 1e-9:.2f} s: {why}")

    def _remember(self, found: Localized) -> None:
        """The pose, and the movement if it is one: a leap is none, nor a place corrected.

        What contradicts the last movement is believed when the next one is like it.
        """
        if self._last is not None and min(self._last.quality, found.quality) >= _LOST_BELOW:
            seconds = (found.stamp_ns - self._last.stamp_ns) * 1e-9
            moved = _Movement(self._last.map_T_base.pose.between(found.map_T_base.pose), seconds)
            if moved.follows(self._movement, self._noise) or (
                self._doubted is not None and moved.follows(self._doubted, self._noise)
            ):
                self._movement, self._doubted = moved, None
            else:
                self._doubted = moved
        self._last = found


@dataclass(frozen=True, slots=True)
class _Movement:
    """Between two scans; of no seconds where there was none."""

    motion: Pose2
    seconds: float

    def once_more(self, seconds: float, noise: MotionNoise) -> UncertainPose2:
        """Where it leads in so many seconds, if it goes on."""
        return constant_motion(self.motion, self.seconds, seconds, noise)

    def follows(self, before: "_Movement", noise: MotionNoise) -> bool:
        """Whether it is within the 99.9 % gate of another that goes on."""
        expected = before.once_more(self.seconds, noise)
        off = expected.pose.between(self.motion).as_array()
        return float(off @ np.linalg.solve(expected.covariance, off)) <= _CHI2_3DOF_999


def _too_large(motion: UncertainPose2) -> str:
    """What is large about it; empty if nothing is."""
    moved_m, turned = float(np.hypot(motion.pose.x, motion.pose.y)), abs(motion.pose.theta)
    if moved_m > _LARGE_M or turned > _LARGE_RAD:
        return f"moved {moved_m:.1f} m and {np.degrees(turned):.0f} deg between two scans"
    if not Gaussian.of_pose(motion).is_within(_UNKNOWN_M, _UNKNOWN_RAD):
        return "the motion is not known"
    return ""


def _alarm(step: FastStep, prior: UncertainPose2, evidence: float) -> str:
    """Why the fast estimate is not to be trusted; empty if it is."""
    if evidence < 0.0:
        matched, perceived = int((step.landmark_ids >= 0).sum()), len(step.landmark_ids)
        return f"few matches, {matched} of {perceived} perceptions"
    off = prior.pose.between(step.map_T_base.pose).as_array()
    distance2 = float(off @ np.linalg.solve(prior.covariance + 1e-12 * np.eye(3), off))
    if not distance2 <= _CHI2_3DOF_999:
        return "the matches contradict the motion"
    return ""


def _lost(quality: float) -> str:
    return "" if quality >= _LOST_BELOW else f"quality {quality:.2f}"


def _is_sure(belief: Belief) -> bool:
    return (
        belief.is_one
        and belief.quality >= _SURE_ABOVE
        and Gaussian.of_pose(belief.map_T_base).is_within(_SURE_M, _SURE_RAD)
    )


def _share_within(map_T_base: UncertainPose2) -> float:
    """The probability of being within 1 m of a mean, by its covariance taken for round."""
    variance = 0.5 * float(np.trace(map_T_base.covariance[:2, :2]))
    return float(-np.expm1(-0.5 * _WITHIN_M**2 / max(variance, 1e-12)))
