"""Tracks where scans show too little to tell things apart: many hypotheses, which then agree.

Each particle is a hypothesis of the path and of all associations, with a map of its own; what it
explains badly dies out. A perception gets the landmark that most of the weight takes it for, and
none while hypotheses disagree: so one that is wrong for a while leaves no wrong track.

Source: Montemerlo et al. 2003, FastSLAM 1.0 with associations by each particle. Differs: the
result is the associations they agree on, from which the graph makes path and map.
"""

from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.estimates import NoEstimate, NoEstimateReason
from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2, UncertainPose2, composed_poses
from semgraph.graph.growing import Growing
from semgraph.known_map.particles import systematic
from semgraph.landmarks import Perceptions
from semgraph.measurement_model import diameters_contradict
from semgraph.particle_maps import ParticleMaps

# A share of the weight that agrees on one landmark.
_AGREED: Final = 0.5
# Particles are drawn anew when as few count as this.
_EFFECTIVE: Final = 0.5
# Landmarks per m2 that escaped notice so far, for each that is known within 20 m.
_UNMAPPED: Final = 0.1 / (np.pi * 20.0**2)
# How probably wheels slip between two scans, by how much more they err then, and the share of the
# particles that slip to be ready for it.
SLIPS: Final = 1e-3
SLIP_FACTOR: Final = 10.0
_SLIPPING: Final = 0.05
_NONE: Final = -1


class HypothesesTracker:
    """Follows objects by many hypotheses; it takes the place of the tracker with one."""

    def __init__(
        self,
        num_hypotheses: int,
        map_sigma_m: float,
        map_T_start: Pose2,
        rng: np.random.Generator,
    ) -> None:
        self._rng = rng
        self._odom_T_base = map_T_start
        self._poses = np.tile(map_T_start.as_array(), (num_hypotheses, 1))
        self._log_weights = np.zeros(num_hypotheses)
        self._maps = ParticleMaps(num_hypotheses, map_sigma_m)
        # Of each landmark by its number, as it looked when it was taken for new.
        self._classes, self._diameters = Growing((2,), np.int64), Growing((2,))
        self._identities: dict[str, int] = {}

    def step(self, perceptions: Perceptions, odometry: UncertainPose2 | None) -> FastStep:
        """The landmark of each perception, -1 where the hypotheses disagree.

        The pose is the wheels', in the frame that drifts and never jumps.

        Args:
            perceptions: relative to base.
            odometry: last_T_current by the wheels.

        Raises:
            InputError: there is no odometry.
        """
        if odometry is None:
            raise InputError("tracker.hypotheses: expected wheel odometry; set it to 1 without")
        self._move(odometry)
        taken_for = self._associate(perceptions)
        agreed = self._agreed(taken_for)
        self._draw_anew()
        return FastStep(
            perceptions.stamp_ns,
            UncertainPose2(self._odom_T_base, odometry.covariance),
            odometry,
            NoEstimate(NoEstimateReason.TOO_FEW_MATCHES),
            agreed,
        )

    def _move(self, motion: UncertainPose2) -> None:
        self._odom_T_base = self._odom_T_base @ motion.pose
        n = len(self._poses)
        noise = self._rng.multivariate_normal(np.zeros(3), motion.covariance, n, method="eigh")
        # More of them slip than do in truth, for less weight: importance sampling.
        slips = self._rng.random(n) < _SLIPPING
        noise[slips] *= SLIP_FACTOR
        less, more = np.log(SLIPS / _SLIPPING), np.log((1.0 - SLIPS) / (1.0 - _SLIPPING))
        self._log_weights += np.where(slips, less, more)
        moved = composed_poses(np.broadcast_to(motion.pose.as_array(), noise.shape), noise)
        self._poses = composed_poses(self._poses, moved)

    def _associate(self, perceptions: Perceptions) -> IntArray:
        """(n, k) the number of the landmark that each particle takes each perception for."""
        taken_for = np.full((len(self._poses), len(perceptions)), _NONE)
        for row in range(len(perceptions)):
            taken_for[:, row] = self._take(perceptions.select(np.array([row])), taken_for[:, :row])
        return taken_for

    def _take(self, one: Perceptions, taken: IntArray) -> IntArray:
        """(n,) what each particle takes one perception for; what is taken (n, j) is no more."""
        maps, polar = self._maps, (float(one.ranges_m[0]), float(one.bearings[0]))
        predicted = maps.predict(self._poses, *polar, one.covariances[0])
        numbers = maps.numbers
        may_be = self._may_be(one, numbers) & ~(numbers[:, :, None] == taken[:, None]).any(axis=2)
        log_odds = np.where(may_be, predicted.log_likelihoods(), -np.inf)
        # By range and bearing an unmapped one is the likelier the farther away.
        log_new = np.log(_UNMAPPED * (1.0 + maps.counts()) * polar[0])
        choices = np.column_stack([log_odds, log_new])
        columns = choices.argmax(axis=1)
        self._log_weights += choices.max(axis=1)
        is_new = columns == numbers.shape[1]
        known = np.flatnonzero(~is_new)
        maps.sight(known, columns[known], predicted)
        new, number = np.flatnonzero(is_new), self._begin(one)
        columns[new] = maps.insert(new, self._poses, polar, one.covariances[0], number)
        found: IntArray = maps.numbers[np.arange(len(columns)), columns]
        return found

    def _may_be(self, one: Perceptions, numbers: IntArray) -> BoolArray:
        """(n, c) whether a landmark's kind, identity and diameter permit that it is perceived."""
        may_be: BoolArray = numbers != _NONE
        may_be &= (self._classes.rows[numbers] == self._class(one)).all(axis=2)
        if np.isfinite(one.diameters_m[0]):
            diameters_m, sigmas_m = np.moveaxis(self._diameters.rows[numbers], -1, 0)
            may_be &= ~diameters_contradict(
                diameters_m, sigmas_m, one.diameters_m, one.diameter_sigmas_m
            )
        return may_be

    def _class(self, one: Perceptions) -> tuple[int, int]:
        """Kind, and number of the identity."""
        identity = self._identities.setdefault(str(one.identities[0]), len(self._identities))
        return int(one.kinds[0]), identity

    def _begin(self, one: Perceptions) -> int:
        """The number of a landmark that begins with this perception, whoever takes it for new."""
        self._diameters.append((one.diameters_m[0], one.diameter_sigmas_m[0]))
        return self._classes.append(self._class(one))

    def _agreed(self, taken_for: IntArray) -> IntArray:
        """(k,) the number that most of the weight takes each perception for, each number once."""
        weights = self._weights()
        agreed = np.full(taken_for.shape[1], _NONE)
        for row, numbers in enumerate(taken_for.T):
            known, which = np.unique(numbers, return_inverse=True)
            shares = np.bincount(which, weights)
            best = int(known[shares.argmax()])
            if shares.max() > _AGREED and best not in agreed:
                agreed[row] = best
        return agreed

    def _weights(self) -> FloatArray:
        weights = np.exp(self._log_weights - self._log_weights.max())
        normalised: FloatArray = weights / weights.sum()
        return normalised

    def _draw_anew(self) -> None:
        weights = self._weights()
        if 1.0 / np.square(weights).sum() > _EFFECTIVE * len(weights):
            return
        rows = systematic(weights, len(weights), self._rng)
        self._poses = self._poses[rows]
        self._maps.select(rows)
        self._log_weights[:] = 0.0
