"""The graph of whole sessions, solved at once: robust to wrong sightings, exact in the end.

Sightings are weighed by graduated non-convexity with truncated least squares: beyond the 99.9 %
gate they lose all weight, those within keep it whole, so that what comes out is the optimum of
what is left. Source: Yang et al. 2020, eq. 12 to 14; here it starts from an estimate at hand, so
its first surrogate needs not be convex.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.geometry import UncertainPose2
from semgraph.graph.common_errors import CommonErrors, Ranges
from semgraph.graph.factors import (
    Odometry,
    Sighting,
    odometry_factor,
    sighting_factor,
    to_gtsam,
    whitened,
)
from semgraph.graph.information import Information
from semgraph.measurement_model import CHI2_2DOF_999, mahalanobis2
from semgraph.offline.batch import Batch, Belief, Prior
from semgraph.offline.pose_chains import fill, links

# Mu of the first surrogate: what is beyond eleven times the gate has no weight from the outset.
_FIRST_MU: Final = 0.1
_MU_FACTOR: Final = 2.0
_LAST_MU: Final = 10.0
# A factor without any weight could leave a landmark without information.
_LEAST_WEIGHT: Final = 1e-4
_CONVERGED: Final = 1e-5
_MAX_STEPS: Final = 50


@final
class BatchGraph:
    """Poses and landmarks of a batch with what is believed of them.

    Args:
        batch: what was measured.
        belief: where to begin, and which perceptions are of which landmarks.
        every_scan: makes every scan a pose; else those that nothing was sighted from are composed
            away and found again.

    Raises:
        GraphError: GTSAM cannot solve it.
    """

    def __init__(self, batch: Batch, belief: Belief, *, every_scan: bool = False) -> None:
        self._batch = batch
        self._belief = belief
        self._rows = np.flatnonzero(belief.assigned())
        kept = np.full(len(batch), every_scan)
        kept[batch.scans[self._rows]] = True
        kept[list(batch.firsts)] = True
        self._links = links(batch, kept)
        self._weights = np.ones(len(self._rows) + len(belief.priors))
        self._graph = gtsam.NonlinearFactorGraph()
        for link in self._links:
            self._graph.add(_link_factor(link.start, link.end, link.motion))
        self._first = self._graph.size()
        for k in range(len(self._weights)):
            self._graph.add(self._factor(k))
        self._values = _values(belief, [link.end for link in self._links])
        self._ordering = self._ordered()
        self._columns: dict[int, IntArray] = {}
        self._factored: Information | None = None

    @property
    def num_factors(self) -> int:
        """How many there are."""
        return int(self._graph.size())

    @property
    def cost(self) -> float:
        """Half the sum of weighed squared residuals, where it is now."""
        return float(self._graph.error(self._values))

    @property
    def cost_of_motions(self) -> float:
        """The part of the cost that is not of sightings and priors of landmarks."""
        return sum(float(self._graph.at(k).error(self._values)) for k in range(self._first))

    def estimate(self) -> Belief:
        """Where everything is now, but for the scans that are no poses of the graph."""
        poses = np.array(self._belief.map_T_bases)
        ends = [link.end for link in self._links]
        poses[ends] = gtsam.utilities.extractPose2(self._values)
        places = {
            landmark: np.asarray(self._values.atPoint2(L(landmark)))
            for landmark in self._belief.map_t_landmarks
        }
        return replace(self._belief, map_T_bases=poses, map_t_landmarks=places)

    def optimum(self) -> Belief:
        """Where everything most probably is; the belief's associations are as they were."""
        self._settle()
        mu = _FIRST_MU
        while (self._residuals2() > CHI2_2DOF_999).any() and mu <= _LAST_MU:
            self._weigh(_tls_weights(self._residuals2(), mu))
            self._step()
            mu *= _MU_FACTOR
        if mu > _FIRST_MU:
            self._weigh((self._residuals2() <= CHI2_2DOF_999).astype(np.float64))
            self._settle()
        now = self.estimate()
        return replace(now, map_T_bases=fill(self._batch, self._links, now.map_T_bases))

    def cost_by_gtsam(self, relative: float = 1e-5) -> float:
        """The cost at which GTSAM's own Levenberg-Marquardt ends, from where the graph is now.

        Args:
            relative: it stops when a step lowers the cost by no larger part. Default: GTSAM's.
        """
        params = gtsam.LevenbergMarquardtParams()
        params.setRelativeErrorTol(relative)
        optimizer = gtsam.LevenbergMarquardtOptimizer(self._graph, self._values, params)
        return float(self._graph.error(optimizer.optimize()))

    def landmark_covariance(self, landmarks: Sequence[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks, in map, in the order given."""
        return self._joint([L(landmark) for landmark in landmarks])

    def landmark_covariances(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2, 2) marginal covariance of each landmark, in map; with errors in common."""
        keys = [L(landmark) for landmark in landmarks]
        return self._marginals(keys, 2) + self._added(keys, 2)

    def pose_covariances(self) -> FloatArray:
        """(n, 3, 3) of the poses in the graph, each in its own frame; with errors in common."""
        keys = [X(link.end) for link in self._links]
        return self._marginals(keys, 3) + self._added(keys, 3)

    def _ordered(self) -> gtsam.Ordering:
        """Dissecting the loops of a drive leaves a third less to do than COLAMD.

        But METIS ends the process where a variable has no neighbour: a session of one pose alone.
        """
        poses = np.bincount([link.session for link in self._links])
        sighted = np.unique(self._batch.scans[self._rows])
        is_alone = [poses[link.session] == 1 and link.end not in sighted for link in self._links]
        if any(is_alone):
            return gtsam.Ordering.ColamdNonlinearFactorGraph(self._graph)
        return gtsam.Ordering.MetisNonlinearFactorGraph(self._graph)

    def _settle(self) -> None:
        """Gauss-Newton steps until the cost stays; Levenberg-Marquardt where one leads upwards."""
        cost = self.cost
        for _ in range(_MAX_STEPS):
            before = self._values
            try:
                self._step()
            except RuntimeError:
                self._descend(before)
            if not self.cost <= cost * (1.0 + _CONVERGED):
                self._descend(before)
            if cost - self.cost <= _CONVERGED * cost:
                return
            cost = self.cost

    def _step(self) -> None:
        linear = self._graph.linearize(self._values)
        self._values = self._values.retract(linear.optimize(self._ordering))

    def _descend(self, values: gtsam.Values) -> None:
        params = gtsam.LevenbergMarquardtParams()
        params.setLinearSolverType("MULTIFRONTAL_QR")
        try:
            optimizer = gtsam.LevenbergMarquardtOptimizer(self._graph, values, params)
            self._values = optimizer.optimize()
        except RuntimeError as error:
            reason = str(error).strip().partition("\n")[0]
            raise GraphError(f"the batch cannot be solved: {reason}") from error

    def _weigh(self, weights: FloatArray) -> None:
        """Makes the factors anew whose weights have changed."""
        weights = np.maximum(weights, _LEAST_WEIGHT)
        changed = np.abs(np.log(weights / self._weights)) > 1e-3
        self._weights = np.where(changed, weights, self._weights)
        for k in np.flatnonzero(changed).tolist():
            self._graph.replace(self._first + k, self._factor(k))

    def _factor(self, k: int) -> gtsam.NonlinearFactor:
        """Of the k-th sighting, or prior behind them."""
        weight = float(self._weights[k])
        if k >= len(self._rows):
            return _prior_factor(self._belief.priors[k - len(self._rows)], weight)
        row, seen = int(self._rows[k]), self._batch.seen
        return sighting_factor(
            Sighting(
                int(self._batch.scans[row]),
                int(self._belief.landmarks[row]),
                float(seen.ranges_m[row]),
                float(seen.bearings[row]),
                self._batch.covariances[row] / weight,
            )
        )

    def _residuals2(self) -> FloatArray:
        """(k,) squared Mahalanobis distances of sightings, then of priors."""
        now, priors = self.estimate(), self._belief.priors
        landmarks = np.array([prior.landmark for prior in priors], dtype=np.int64)
        before = np.array([prior.map_t_landmark for prior in priors]).reshape(-1, 2)
        covariances = np.array([prior.covariance for prior in priors]).reshape(-1, 2, 2)
        moved2 = mahalanobis2(now.places(landmarks) - before, covariances)
        return np.concatenate([now.fit(self._batch)[self._rows], moved2])

    def _joint(self, keys: Sequence[int]) -> FloatArray:
        columns = np.concatenate([self._columns_of(key) for key in keys])
        return self._information().covariance(columns)

    def _marginals(self, keys: Sequence[int], size: int) -> FloatArray:
        columns = [self._columns_of(key) for key in keys]
        return self._information().marginals(np.array(columns, dtype=np.int64).reshape(-1, size))

    def _added(self, keys: Sequence[int], size: int) -> FloatArray:
        """(n, size, size) that errors in common add to each variable."""
        seen, of_landmarks = self._batch.seen, self._belief.landmarks
        which = np.flatnonzero(seen.common_shares[self._rows] > 0.0)
        rows, now = self._rows[which], self.estimate()
        if not len(rows) or not keys:
            return np.zeros((len(keys), size, size))
        scans, poses = np.unique(self._batch.scans[rows], return_inverse=True)
        names, things = np.unique(of_landmarks[rows], return_inverse=True)
        ranges = Ranges(
            now.map_T_bases[scans],
            now.places(names),
            poses,
            things,
            np.column_stack([seen.ranges_m, seen.bearings])[rows],
            self._batch.covariances[rows] / self._weights[which, None, None],
            seen.common_shares[rows],
        )
        common = CommonErrors(
            self._information(),
            ranges,
            np.array([self._columns_of(X(scan)) for scan in scans.tolist()]),
            np.array([self._columns_of(L(name)) for name in names.tolist()]),
        )
        return common.added(np.array([self._columns_of(key) for key in keys]))[0]

    def _information(self) -> Information:
        if self._factored is None:
            jacobian, self._columns = whitened(self._graph.linearize(self._values))
            self._factored = Information.by(jacobian)
        return self._factored

    def _columns_of(self, key: int) -> IntArray:
        self._information()
        return self._columns[key]


def _tls_weights(distances2: FloatArray, mu: float) -> FloatArray:
    """Source: Yang et al. 2020, eq. 14."""
    gate2 = CHI2_2DOF_999
    between = np.sqrt(gate2 * mu * (mu + 1.0) / np.maximum(distances2, 1e-12)) - mu
    weights: FloatArray = np.clip(between, 0.0, 1.0)
    return weights


def _link_factor(start: int | None, end: int, motion: UncertainPose2) -> gtsam.NonlinearFactor:
    if start is not None:
        return odometry_factor(Odometry(start, end, motion))
    noise = gtsam.noiseModel.Gaussian.Covariance(motion.covariance)
    return gtsam.PriorFactorPose2(X(end), to_gtsam(motion.pose), noise)


def _prior_factor(prior: Prior, weight: float) -> gtsam.NonlinearFactor:
    noise = gtsam.noiseModel.Gaussian.Covariance(prior.covariance / weight)
    return gtsam.PriorFactorPoint2(L(prior.landmark), prior.map_t_landmark, noise)


def _values(belief: Belief, scans: Sequence[int]) -> gtsam.Values:
    values = gtsam.Values()
    for scan, (x, y, theta) in zip(scans, belief.map_T_bases[list(scans)].tolist(), strict=True):
        values.insert(X(scan), gtsam.Pose2(x, y, theta))
    for landmark, place in belief.map_t_landmarks.items():
        values.insert(j=L(landmark), point2=place)
    return values
