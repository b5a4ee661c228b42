"""Finds and follows the robot in a known map by weighed hypotheses (paper section 3.2).

The belief is a mixture: particles that are followed, and a rest, the probability that the robot is
elsewhere in the map (pose_quality.py). As long as the rest matters, places are proposed by what
was seen lately, all of it at once and anew after each scan, and weighed by what of the rest they
stand for (importance sampling). The place that wins is followed from then on.
"""

from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import UncertainPose2, wrap_angle
from semgraph.known_map.belief import Belief, Region
from semgraph.known_map.expected_sights import ExpectedSights, Lately
from semgraph.known_map.followed import WIDER, Followed
from semgraph.known_map.likelihood_field import Seen
from semgraph.known_map.particles import (
    Gaussian,
    Particles,
    evenly_within,
    importance_samples,
    log_sum,
)
from semgraph.known_map.pose_likelihood import LikelihoodSettings, PoseLikelihood
from semgraph.known_map.pose_proposals import PoseProposals
from semgraph.known_map.pose_quality import Elsewhere, UsualSight
from semgraph.landmarks import Perceptions

_SEEDS_EACH: Final = 40
# A place whose weight fewer seeds carry is not followed yet.
_LEAST_EFFECTIVE: Final = 3.0
# How surely a start is right, within a radius or at a pose.
_START_IS_RIGHT: Final = 0.99
_START_ERRS: Final = 0.01
# Where the robot is if it is no longer where it was: as probably near as anywhere.
_NEAR_M: Final = 10.0
_IS_NEAR: Final = 0.5
# A motion less sure than this leaves no track.
_UNTRACKED_M: Final = 1.0
_WITHIN_M: Final = 1.0
# Places are proposed as long as the rest is at least this, and followed above that.
_PROPOSED_ABOVE: Final = 0.05
_FOLLOWED_ABOVE: Final = 0.99
# In the mean of all places a scan is explained by 1, most of it at few places, where things fit by
# chance: these are proposed. So much is left at all others, by how often the true place is not
# among the proposed ones: about 0.2 / (0.2 + what the proposed ones explain).
_UNPROPOSED: Final = 0.2
# Proposed places as near as this to the one that is followed are the same.
_SAME_RAD: Final = 0.3


class FilterSettings(BaseModel):
    """Settings of the particle filter.

    `carried_off` is the probability that the robot is carried off between two scans, `leaps` that
    it makes a leap where nothing but the scans themselves measures its motion.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    least_particles: int = Field(300, ge=50, le=10_000)
    most_particles: int = Field(100_000, ge=1_000, le=2_000_000)
    carried_off: float = Field(1e-4, gt=0.0, lt=0.5)
    leaps: float = Field(1e-2, gt=0.0, lt=0.5)
    likelihood: LikelihoodSettings = LikelihoodSettings()


class ParticleFilter:
    """The belief about one robot's pose in one map; it starts anywhere in it."""

    def __init__(
        self, likelihood: PoseLikelihood, settings: FilterSettings, rng: np.random.Generator
    ) -> None:
        self._likelihood = likelihood
        self._proposals = PoseProposals(likelihood)
        least, most = settings.least_particles, settings.most_particles
        self._followed = Followed(likelihood, self._proposals, least, most, rng)
        self._sights = ExpectedSights(likelihood.fixed_map, np.random.default_rng(0))
        self._settings = settings
        self._rng = rng
        self.usual = UsualSight()
        # Whether the particles stand for anything, or are as good as none.
        self._follows = False
        # Particles of all places beside each other, and how certain it is that it is one of them.
        self._proposed: tuple[Particles, float] | None = None
        self.start_anywhere()

    def start_anywhere(self) -> None:
        """Nothing is known."""
        fixed_map = self._likelihood.fixed_map
        n = self._followed.num_spread(fixed_map.area_m2)
        points = self._rng.uniform(*fixed_map.bounds(), (n, 2))
        headings = self._rng.uniform(-np.pi, np.pi, n)
        self._spread(np.column_stack([points, headings]), fixed_map.area_m2, Region())

    def start_within(self, map_t_point: FloatArray, radius_m: float) -> None:
        """The robot is within a radius of a point (2,), its heading unknown."""
        area_m2 = np.pi * radius_m**2
        x, y = map_t_point.tolist()
        poses = evenly_within((x, y), radius_m, self._followed.num_spread(area_m2), self._rng)
        self._spread(poses, area_m2, Region((x, y), radius_m, _START_IS_RIGHT))

    @property
    def elsewhere(self) -> Elsewhere:
        """The probability that the robot is where no particle is."""
        return self._elsewhere

    def start_at(self, map_T_base: UncertainPose2, doubt: Elsewhere | None = None) -> None:
        """The pose is known with a covariance, but for a doubt: then it is near, or anywhere."""
        self._followed.begin_at(Gaussian.of_pose(map_T_base))
        self._elsewhere = doubt or Elsewhere(_START_ERRS)
        self._region = Region((map_T_base.pose.x, map_T_base.pose.y), _NEAR_M, _IS_NEAR)
        self._follows = True
        self._proposed = None

    def _spread(self, poses: FloatArray, area_m2: float, region: Region) -> None:
        self._followed.begin(poses, 2.0 * np.pi * area_m2)
        self._region = region
        self._follows = len(poses) > self._settings.least_particles
        rest = _START_ERRS if self._follows else 1.0 - 1e-9
        self._elsewhere = Elsewhere(rest)
        self._proposed = None

    def step(
        self,
        perceptions: Perceptions,
        motion: UncertainPose2,
        lately: Lately | None = None,
        leaps: float = 0.0,
        share_confirmed: float = 0.0,
    ) -> Belief:
        """The belief after a motion last_T_current and what is perceived then.

        Args:
            perceptions: relative to base.
            motion: last_T_current.
            lately: all that was seen lately, each thing once, relative to base now; what is
                perceived now where there is no more.
            leaps: the probability that it was no such motion but a leap to somewhere near.
            share_confirmed: of what is perceived, that is seen for the second time lately.
        """
        self._move(motion, leaps)
        self._proposed = None
        if len(perceptions):
            self.usual.add(perceptions.ranges_m, perceptions.bearings)
            evidence = 0.0
            if self._follows:
                evidence = self._evidence(self._likelihood.see(perceptions), leaps)
                self._elsewhere.weigh(evidence, share_confirmed)
            if self._elsewhere.probability > _PROPOSED_ABOVE or evidence < 0.0:
                self._propose(lately or Lately.now(perceptions))
        return self.belief(perceptions.stamp_ns)

    def belief(self, stamp_ns: int) -> Belief:
        """As it stands."""
        particles, certain = self._followed.particles, 1.0 - self._elsewhere.probability
        if self._proposed is not None:
            particles, certain = self._proposed
        place, share = particles.likeliest(_WITHIN_M)
        return Belief(
            stamp_ns,
            place.pose(),
            min(certain * share, 1.0),
            self._proposed is None and self._followed.is_compact,
            len(particles),
        )

    def by_numbers(self, map_T_base: FloatArray) -> float:
        """Log evidence for a place (3,) by how many things there are to be seen."""
        sparseness = self._likelihood.sparseness(map_T_base[:2], self.usual.reach_m)
        return self.usual.evidence(sparseness)

    def _move(self, motion: UncertainPose2, leaps: float) -> None:
        self._followed.move(motion)
        self._elsewhere.move(motion.pose, self._settings.carried_off + leaps)
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(motion.covariance[:2, :2])[-1]))
        if sigma_m > _UNTRACKED_M:
            self._lose_track(3.0 * sigma_m)

    def _lose_track(self, radius_m: float) -> None:
        """Too few particles for where the robot may have got to: seeds take over."""
        place, _ = self._followed.particles.likeliest(_WITHIN_M)
        x, y = place.mean[:2].tolist()
        here = 1.0 - self._elsewhere.probability
        self._region = Region((x, y), radius_m, min(here, _START_IS_RIGHT))
        self._follows = False
        self._elsewhere = Elsewhere(1.0 - 1e-9)
        self._proposed = None

    def _evidence(self, seen: Seen, leaps: float) -> float:
        """Log of how much better what is followed explains the scan than elsewhere.

        Where it explains it worse, and the robot may have made a leap, all that is near is followed
        besides: few things in sight tell a place among those near, not among all.
        """
        before = self._followed.particles
        evidence = self._weigh(seen)
        near = self._elsewhere.gone * leaps / (self._settings.carried_off + leaps)
        if evidence < 0.0 < near and len(before) <= self._settings.least_particles:
            self._add_after_a_leap(before, near)
            evidence = self._weigh(seen)
        return evidence

    def _weigh(self, seen: Seen) -> float:
        evidence = self._followed.weigh(seen)
        return evidence + self.by_numbers(self._followed.particles.gaussian().mean)

    def _add_after_a_leap(self, before: Particles, near: float) -> None:
        """Others evenly all over what is near, by a probability."""
        area_m2 = np.pi * _NEAR_M**2
        x, y = before.gaussian().mean[:2].tolist()
        n = self._followed.num_spread(area_m2)
        around = evenly_within((x, y), _NEAR_M, n, self._rng)
        self._elsewhere.gone -= near
        share = near / (1.0 - self._elsewhere.probability)
        self._followed.add(before, around, share, 2.0 * np.pi * area_m2)

    def _propose(self, lately: Lately) -> None:
        """Weighs places of the rest beside what is followed, which one of them may succeed."""
        seeds, log_weights, places = self._seeds(lately)
        if not len(seeds):
            return
        rest = self._elsewhere.probability
        log_weights = log_weights + np.log(rest)
        log_others = float(np.log(1.0 - rest + _UNPROPOSED * rest))
        log_total = float(np.logaddexp(log_others, log_sum(log_weights)))
        weights = np.exp(log_weights - log_total)
        followed = (1.0 - rest) * np.exp(-log_total)
        sums = np.bincount(places, weights)
        is_it = places == sums.argmax()
        place = Particles(seeds[is_it], weights[is_it] / sums.max())
        if sums.max() > _FOLLOWED_ABOVE and place.effective >= _LEAST_EFFECTIVE:
            self._follow(place, float(sums.max()))
            return
        certain = followed + float(weights.sum())
        self._proposed = (
            Particles(
                np.concatenate([self._followed.particles.poses, seeds]),
                np.concatenate([followed * self._followed.particles.weights, weights]) / certain,
            ),
            certain,
        )

    def _follow(self, place: Particles, certain: float) -> None:
        self._followed.begin_with(place)
        self._elsewhere = Elsewhere(1.0 - certain, driven_m=0.0)
        self._region = Region()
        self._follows = True

    def _seeds(self, lately: Lately) -> tuple[FloatArray, FloatArray, IntArray]:
        """Particles about proposed places, log weights against the rest, number of the place."""
        area_m2, seen = self._likelihood.fixed_map.area_m2, self._likelihood.see(lately.perceptions)
        poses: list[FloatArray] = [np.zeros((0, 3))]
        log_weights: list[FloatArray] = [np.zeros(0)]

        def by_sights(poses: FloatArray) -> FloatArray:
            usual = self.usual
            return self._sights.evidence(poses, lately, usual.reach_m, usual.half_field)

        proposed = self._proposals.propose(lately.perceptions, seen, by_sights)
        places = [Gaussian.of_pose(each).wider(WIDER) for each in proposed]
        places = [each for each in places if not self._is_followed(each)]
        means = np.array([each.mean for each in places]).reshape(-1, 3)
        for place, unseen in zip(places, by_sights(means).tolist(), strict=True):

            def log_posterior(drawn: FloatArray, unseen: float = unseen) -> FloatArray:
                rest = self._region.log_densities(drawn, area_m2) + unseen
                return rest + self._likelihood.log_likelihoods(seen, drawn)

            drawn, weights = importance_samples(log_posterior, (place,), _SEEDS_EACH, self._rng)
            poses.append(drawn)
            log_weights.append(weights)
        numbers = np.repeat(np.arange(len(places)), _SEEDS_EACH)
        return np.concatenate(poses), np.concatenate(log_weights), numbers

    def _is_followed(self, place: Gaussian) -> bool:
        if self._elsewhere.probability > 0.5 or not self._followed.is_compact:
            return False
        x, y, theta = place.mean - self._followed.particles.gaussian().mean
        return bool(np.hypot(x, y) < _WITHIN_M and abs(wrap_angle(float(theta))) < _SAME_RAD)
