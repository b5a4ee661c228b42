"""EKF-SLAM with maximum-likelihood association: the field's first answer, done with care.

Perceptions and landmarks pair one to one at the greatest likelihood; the pairs pass a gate each
and one together. What is far from everything of its kind is a new landmark, tentative until it
was seen often enough. Noise, motion and the map's rules are those of all estimators here.
"""

from typing import Final, final

import numpy as np
from scipy.optimize import linear_sum_assignment

from evaluation.consistency import chi_square_quantile
from evaluation.estimators.driving import Step, drive, start_of
from evaluation.estimators.estimate import Estimate
from evaluation.estimators.gating import gate, measured, weighed_covariances
from evaluation.estimators.moving import Motions
from evaluation.estimators.pose_and_map import PoseAndMap
from evaluation.estimators.sighted import Sighted
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import UncertainPose2, wrap_angle
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import LEAST_RANGE_M, Landmark, Perceptions
from semgraph.measurement_model import mahalanobis2
from semgraph.moments import Moment
from semgraph.settings import Settings
from sensors.truth import Source

_JOINT: Final = 0.999
_AROUND_M: Final = 1.0


def estimate(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """The path as it was said at each moment, and the map in the end."""
    del rng
    slam = EkfSlam(start_of(source.recording, settings), settings.smoother)
    motions = Motions(settings.fast)

    def step(moment: Moment) -> Step:
        motion = motions.motion(moment)
        landmark_ids = slam.step(moment.perceptions, motion)
        motions.remember(moment, slam.map_T_base.pose)
        return Step(slam.map_T_base, landmark_ids)

    return drive(source, settings, step).estimate(slam.landmarks(), nis=slam.nis)


@final
class EkfSlam:
    """The filter with its associations."""

    def __init__(self, map_T_start: UncertainPose2, settings: SmootherSettings) -> None:
        self.state = PoseAndMap(map_T_start)
        self._sighted = Sighted(settings)
        self._ids = np.zeros(0, dtype=np.int64)
        self._scan = -1
        self._nis: list[FloatArray] = []

    @property
    def map_T_base(self) -> UncertainPose2:
        """The pose now."""
        return self.state.map_T_base

    @property
    def nis(self) -> FloatArray:
        """(k,) normalised squares of all innovations that were taken in, one perception each."""
        return np.concatenate([np.zeros(0), *self._nis])

    def landmarks(self) -> tuple[Landmark, ...]:
        """The map."""
        state = self.state
        return self._sighted.landmarks(
            self._ids.tolist(), state.map_t_landmarks, state.landmark_covariances()
        )

    def step(self, perceptions: Perceptions, motion: UncertainPose2) -> IntArray:
        """Takes in a moment; (n,) the landmark of each perception, -1 where it is left open.

        Args:
            perceptions: relative to base.
            motion: last_T_current.
        """
        self._scan += 1
        self.state.move(motion)
        self._give_up()
        pairs, is_new = self._associate(perceptions)
        landmark_ids = np.full(len(perceptions), -1, dtype=np.int64)
        if len(pairs):
            self._correct(perceptions, pairs)
            landmark_ids[pairs[:, 0]] = self._ids[pairs[:, 1]]
        landmark_ids[is_new] = self._add(perceptions.select(is_new))
        return landmark_ids

    def _associate(self, perceptions: Perceptions) -> tuple[IntArray, BoolArray]:
        """(k, 2) perceptions and rows of the state; (n,) which perceptions are new."""
        rows = self._around(perceptions)
        gated = gate(self.state, rows, self._sighted, self._ids[rows], perceptions, self._scan)
        n, k = paired(-gated.log_likelihoods, gated.allowed)
        pairs = np.column_stack([n, rows[k]])
        return self._jointly(pairs, gated.innovations[n, k], perceptions), gated.is_new

    def _around(self, perceptions: Perceptions) -> IntArray:
        """Rows of the landmarks that may be in reach."""
        state = self.state
        away_m = np.hypot(*(state.map_t_landmarks - state.pose.as_array()[:2]).T)
        sigma_m = float(np.sqrt(np.trace(state.covariance[:2, :2])))
        reach_m = float(perceptions.ranges_m.max(initial=0.0)) + 3.0 * sigma_m + _AROUND_M
        return np.flatnonzero((away_m <= reach_m) & (away_m >= LEAST_RANGE_M))

    def _jointly(
        self, pairs: IntArray, innovations: FloatArray, perceptions: Perceptions
    ) -> IntArray:
        """Those pairs that pass the gate together: the worst is left out until they do."""
        noise = block_diagonal(weighed_covariances(perceptions)[pairs[:, 0]])
        S = self.state.joint_covariance(pairs[:, 1]) + noise
        kept = np.arange(len(pairs))
        while len(kept) > 1:
            entries = (2 * kept[:, None] + [0, 1]).ravel()
            inverse = np.linalg.inv(S[np.ix_(entries, entries)])
            weighed = inverse @ innovations[kept].ravel()
            distance2 = float(innovations[kept].ravel() @ weighed)
            if distance2 <= chi_square_quantile(_JOINT, 2 * len(kept)):
                break
            # By how much the distance would fall without a pair.
            each = np.arange(len(kept))
            own = inverse.reshape(len(kept), 2, len(kept), 2)[each, :, each, :]
            falls = mahalanobis2(weighed.reshape(-1, 2), own)
            kept = np.delete(kept, int(falls.argmax()))
        return pairs[kept]

    def _correct(self, perceptions: Perceptions, pairs: IntArray) -> None:
        """The filter's update."""
        seen, rows = perceptions.select(pairs[:, 0]), pairs[:, 1]
        noise = weighed_covariances(seen)
        expected, covariances = self.state.expected(rows)
        innovations = measured(seen) - expected
        innovations[:, 1] = wrap_angle(innovations[:, 1])
        self._nis.append(mahalanobis2(innovations, covariances + noise))
        self.state.correct(rows, innovations, block_diagonal(noise))
        self._sighted.sight(self._scan, self._ids[rows], seen)

    def _add(self, perceptions: Perceptions) -> IntArray:
        """(n,) the new landmarks."""
        new = self._sighted.add(self._scan, perceptions)
        noise = weighed_covariances(perceptions)
        self.state.add(perceptions.ranges_m, perceptions.bearings, noise)
        self._ids = np.append(self._ids, new)
        return new

    def _give_up(self) -> None:
        given_up = self._sighted.is_given_up(self._scan)[self._ids]
        if given_up.any():
            self.state.keep(np.flatnonzero(~given_up))
            self._ids = self._ids[~given_up]


def paired(costs: FloatArray, allowed: BoolArray) -> tuple[IntArray, IntArray]:
    """Rows and columns, one to one: as many pairs as are allowed, then the least sum of costs."""
    if not allowed.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    spread = float(np.ptp(costs[allowed])) + 1.0
    more = spread * (1 + min(costs.shape))
    filled = np.where(allowed, costs - costs[allowed].min(), more)
    rows, columns = linear_sum_assignment(filled)
    kept = allowed[rows, columns]
    return rows[kept].astype(np.int64), columns[kept].astype(np.int64)


def block_diagonal(blocks: FloatArray) -> FloatArray:
    """(2k, 2k) of (k, 2, 2)."""
    k = len(blocks)
    whole = np.zeros((k, 2, k, 2))
    whole[np.arange(k), :, np.arange(k), :] = blocks
    return whole.reshape(2 * k, 2 * k)
