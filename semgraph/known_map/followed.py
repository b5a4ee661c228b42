"""Particles that are followed through a known map: moved, weighed, drawn again.

At one place they are weighed where they are, or drawn where the scan has them; far apart they come
nearer in steps.
"""

from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.geometry import UncertainPose2, composed_poses, wrap_angle
from semgraph.known_map.likelihood_field import Seen
from semgraph.known_map.particles import (
    Gaussian,
    Particles,
    importance_samples,
    kld_number,
    log_sum,
    num_bins,
    systematic,
    volume_of_bins,
)
from semgraph.known_map.pose_likelihood import PoseLikelihood
from semgraph.known_map.pose_proposals import PoseProposals

# What is drawn is drawn wider than what it stands for.
WIDER: Final = 1.3
# Below this spread the cloud is one Gaussian.
_COMPACT_M: Final = 0.5
_COMPACT_RAD: Final = 0.1
# Particles farther apart than twice this are too few to begin with; then proposals alone begin.
_COARSEST_M: Final = 0.3
# A smaller share of the particles that carries weight says little.
_ENOUGH_EFFECTIVE: Final = 0.1
# Where most of several things are not explained, a place near by may be the true one.
_SEVERAL: Final = 3
_SLIP: Final = 1e-3
_SLIP_SIGMAS: Final = np.array([0.5, 0.5, 0.3])
_SLIP_PARTICLES: Final = 2000
# A scan is weighed anew as long as the particles come nearer to each other by this.
_NEARER: Final = 0.7
_MOST_STEPS: Final = 6
# At what distance a turn matters as much as a move.
_LEVER_M: Final = 8.0


class Followed:
    """The particles, between so few and so many; they begin with `begin`.

    Attributes:
        particles: as they are.
    """

    def __init__(
        self,
        likelihood: PoseLikelihood,
        proposals: PoseProposals,
        least: int,
        most: int,
        rng: np.random.Generator,
    ) -> None:
        self._likelihood = likelihood
        self._proposals = proposals
        self._least, self._most = least, most
        self._rng = rng
        self.particles = Particles.alike(np.zeros((1, 3)))
        # (m, rad) half the distance between particles that stand apart.
        self._blur = (0.0, 0.0)

    def num_spread(self, area_m2: float) -> int:
        """As many particles as there may be, or few where these would stand too far apart."""
        is_fine = _blur(2.0 * np.pi * area_m2 / self._most)[0] <= _COARSEST_M
        return self._most if is_fine else self._least

    @property
    def is_compact(self) -> bool:
        """Whether they are at one place."""
        return self.particles.gaussian().is_within(_COMPACT_M, _COMPACT_RAD)

    def _is_one_place(self) -> bool:
        """Whether a Gaussian stands for the particles, be it a wide one after an unsure motion."""
        return self._blur == (0.0, 0.0) or self.is_compact

    def begin(self, poses: FloatArray, volume: float = 0.0) -> None:
        """Poses (n, 3) of one weight, each of which stands for its share of a volume in m2 rad."""
        self.particles = Particles.alike(poses)
        self._blur = _blur(volume / len(poses))

    def begin_at(self, place: Gaussian) -> None:
        """As few as there may be, about a place."""
        self.begin(place.draw(self._least, self._rng))

    def begin_with(self, place: Particles) -> None:
        """As few as there may be, by weight."""
        self.begin(self._drawn_again(place).poses)

    def add(self, before: Particles, others: FloatArray, share: float, volume: float) -> None:
        """The particles as they were, and by a share others (n, 3), all over a volume in m2 rad."""
        n = len(others)
        weights = np.concatenate([(1.0 - share) * before.weights, np.full(n, share / n)])
        self.particles = Particles(np.concatenate([before.poses, others]), weights)
        self._blur = _blur(volume / n)

    def move(self, motion: UncertainPose2) -> None:
        """All of them by a motion last_T_current, each with an error of its own."""
        noise = self._rng.multivariate_normal(
            np.zeros(3), motion.covariance, len(self.particles), method="eigh"
        )
        moved = composed_poses(np.broadcast_to(motion.pose.as_array(), noise.shape), noise)
        self.particles = Particles(
            composed_poses(self.particles.poses, moved), self.particles.weights
        )

    def weigh(self, seen: Seen) -> float:
        """Log of how much better what is followed, weighed, explains the scan than elsewhere."""
        if not self._is_one_place():
            return self._weigh_in_steps(seen)
        before = self.particles
        evidence = self._weigh_at_one_place(seen)
        if evidence > 0.0 and self._explains_little(seen):
            self._add_after_a_slip(before)
            self._weigh_in_steps(seen)
        return evidence

    def _weigh_at_one_place(self, seen: Seen) -> float:
        """The same; where hardly any particle has weight, they are drawn where the scan is."""
        log_weights = self._log_weights(seen)
        weighed = _weighed(self.particles.poses, log_weights)
        if weighed.effective < _ENOUGH_EFFECTIVE * len(weighed):
            poses, log_weights = self._refined(seen)
            weighed = _weighed(poses, log_weights)
        elif weighed.effective < 0.5 * len(weighed):
            weighed = self._drawn_again(weighed)
        self.particles = weighed
        return log_sum(log_weights)

    def _drawn_again(self, particles: Particles) -> Particles:
        """As few as there may be, by weight."""
        rows = systematic(particles.weights, self._least, self._rng)
        return Particles.alike(particles.poses[rows])

    def _explains_little(self, seen: Seen) -> bool:
        """Whether most of several things are not where the map has them, seen from one place."""
        if len(seen) < _SEVERAL or not self.is_compact:
            return False
        here = self.particles.gaussian().mean
        return 2 * self._likelihood.num_explained(seen, here) <= len(seen)

    def _add_after_a_slip(self, before: Particles) -> None:
        """Others around what was before: a near place may have been taken for the true one.

        Where things stand close together and few are seen at once, several near places explain
        them alike, and the one that wins may be the wrong one.
        """
        here = before.gaussian()
        around = Gaussian(here.mean, here.covariance + np.diag(_SLIP_SIGMAS**2))
        volume = (4.0 * np.pi) ** 1.5 * float(np.prod(_SLIP_SIGMAS))
        self.add(before, around.draw(_SLIP_PARTICLES, self._rng), _SLIP, volume)

    def _weigh_in_steps(self, seen: Seen) -> float:
        """The same of particles far apart: each step leaves them nearer and weighs them sharper.

        A blurred scan favours the many places where little fits to the one where all of it does.

        Source: annealed particle filter, Deutscher et al. 2000.
        """
        evidence = 0.0
        before: FloatArray = np.zeros(len(self.particles))
        for _ in range(_MOST_STEPS):
            poses, blur = self.particles.poses, self._blur
            log_weights = self._log_weights(seen.blurred(*blur)) - before
            evidence += log_sum(log_weights)
            self.particles = _weighed(poses, log_weights)
            self._resample()
            if self.is_compact or self._blur[0] > _NEARER * blur[0]:
                break
            before = self._likelihood.log_likelihoods(seen.blurred(*blur), self.particles.poses)
        return evidence

    def _log_weights(self, seen: Seen) -> FloatArray:
        """(n,) of the particles where they are, by a scan."""
        with np.errstate(divide="ignore"):
            log_weights: FloatArray = np.log(self.particles.weights)
        return log_weights + self._likelihood.log_likelihoods(seen, self.particles.poses)

    def _refined(self, seen: Seen) -> tuple[FloatArray, FloatArray]:
        """Particles where prior and scan agree, half of them where the prior alone has them.

        Their log weights say by how much posterior exceeds what they were drawn from. Particles of
        the prior alone would nearly all be wasted where the scan is much sharper.
        """
        prior = self.particles.gaussian()
        fused = Gaussian.of_pose(self._proposals.refine(seen, prior.pose())).wider(WIDER)

        def log_posterior(poses: FloatArray) -> FloatArray:
            return prior.log_densities(poses) + self._likelihood.log_likelihoods(seen, poses)

        return importance_samples(log_posterior, (prior, fused), self._least, self._rng)

    def _resample(self) -> None:
        """As many as the places that are left need, if too few carry the weight."""
        particles = self.particles
        if particles.effective > 0.5 * len(particles) and len(particles) <= self._most:
            return
        bins = num_bins(particles.poses[systematic(particles.weights, len(particles), self._rng)])
        n = int(np.clip(kld_number(bins), self._least, self._most))
        poses = particles.poses[systematic(particles.weights, n, self._rng)]
        # A particle that was weighed with a blur stands for all within it.
        sigma_m, sigma_rad = self._blur
        poses = poses + self._rng.standard_normal((n, 3)) * (sigma_m, sigma_m, sigma_rad)
        poses[:, 2] = wrap_angle(poses[:, 2])
        self.particles = Particles.alike(poses)
        self._blur = (0.0, 0.0) if self.is_compact else _blur(volume_of_bins(bins) / n)


def _weighed(poses: FloatArray, log_weights: FloatArray) -> Particles:
    return Particles(poses, np.exp(log_weights - log_sum(log_weights)))


def _blur(volume: float) -> tuple[float, float]:
    """(m, rad) half the distance between particles of which each has a volume in m2 rad."""
    apart_m = (volume * _LEVER_M) ** (1.0 / 3.0)
    return 0.5 * apart_m, 0.5 * apart_m / _LEVER_M
