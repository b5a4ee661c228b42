"""iSAM2 as it comes: one update a pose with GTSAM's defaults, nearest neighbours, no front end.

Each perception is the landmark that is nearest by Mahalanobis distance under the marginals of pose
and landmarks together, within a gate. What is far from everything of its kind is a new landmark.
Noise, motion and the map's rules are those of all estimators here; the kernel of the sightings is
not: under it a loop that is closed from afar moves nothing.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final, Self, final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from evaluation.estimators.driving import Step as Said
from evaluation.estimators.driving import drive, start_of
from evaluation.estimators.estimate import Estimate
from evaluation.estimators.gating import Gated, gate
from evaluation.estimators.moving import Motions
from evaluation.estimators.pose_and_map import PoseAndMap
from evaluation.estimators.sighted import Sighted
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factors import (
    Odometry,
    Sighting,
    odometry_factor,
    prior_factor,
    sighting_factor,
    to_gtsam,
    whitened,
)
from semgraph.graph.information import Information, marginals
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Landmark, Perceptions
from semgraph.moments import Moment
from semgraph.settings import Settings
from sensors.truth import Source

_AROUND_M: Final = 1.0
# From so many entries of the Bayes tree a column on, the sparse matrix of the whole graph gives
# covariances sooner than iSAM2's cliques: 20 s of the paper's course in a dense stand took 12 s
# instead of 34. It linearizes at the estimate, the cliques where iSAM2 last did.
_DENSE: Final = 60


def estimate(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """Path and map as they are in the end.

    Raises:
        GraphError: GTSAM cannot solve the graph.
    """
    del rng
    slam = PlainIsam2(start_of(source.recording, settings), settings.smoother)
    motions = Motions(settings.fast)

    def step(moment: Moment) -> Said:
        landmark_ids = slam.step(moment.perceptions, motions.motion(moment))
        motions.remember(moment, slam.pose)
        return Said(UncertainPose2(slam.pose, np.zeros((3, 3))), landmark_ids)

    said = drive(source, settings, step).estimate(has_covariances=False)
    poses, covariances = slam.poses()
    return replace(
        said,
        trajectory=Trajectory(said.trajectory.stamps_ns, poses),
        covariances=covariances,
        landmarks=slam.landmarks(),
        nis=slam.nis,
    )


@final
class PlainIsam2:
    """The loop."""

    def __init__(self, map_T_start: UncertainPose2, settings: SmootherSettings) -> None:
        self._isam = gtsam.ISAM2(gtsam.ISAM2Params())
        self._known = Sighted(settings)
        self._start = map_T_start
        self.pose = map_T_start.pose
        self._sigma_m = 0.0
        self._num_poses = 0
        self._places: FloatArray = np.zeros((0, 2))
        self._nis: list[FloatArray] = []
        self._information: _Factored | None = None

    @property
    def nis(self) -> FloatArray:
        """(k,) normalised squares of the innovations that were taken in."""
        return np.concatenate([np.zeros(0), *self._nis])

    def step(self, perceptions: Perceptions, motion: UncertainPose2) -> IntArray:
        """Takes in a moment; (n,) the landmark of each perception, -1 where it is left open.

        Args:
            perceptions: relative to base.
            motion: last_T_current.

        Raises:
            GraphError: GTSAM cannot solve the graph.
        """
        guess = self.pose @ motion.pose
        landmark_ids, is_new = self._associate(perceptions, motion, guess)
        seen = np.flatnonzero(landmark_ids >= 0)
        self._known.sight(self._num_poses, landmark_ids[seen], perceptions.select(seen))
        landmark_ids[is_new] = self._known.add(self._num_poses, perceptions.select(is_new))
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        factors.add(self._link(motion))
        values.insert(X(self._num_poses), to_gtsam(guess))
        places = guess.transform(perceptions.base_t_landmarks())
        for row in np.flatnonzero(is_new).tolist():
            values.insert(j=L(int(landmark_ids[row])), point2=places[row])
        for row in np.flatnonzero(landmark_ids >= 0).tolist():
            landmark = int(landmark_ids[row])
            sighting = Sighting.of(perceptions, row, self._num_poses, landmark)
            factors.add(sighting_factor(sighting, is_firm=True))
        with _as_graph_errors(self._num_poses):
            self._isam.update(factors, values)
            self._read()
        self._information = None
        self._num_poses += 1
        return landmark_ids

    def poses(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3) map_T_bases, and (n, 3, 3) their covariances, each in its own frame."""
        with _as_graph_errors(self._num_poses):
            poses = np.asarray(gtsam.utilities.extractPose2(self._isam.calculateEstimate()))
            return poses, marginals(self._joint, list(map(X, range(self._num_poses))), 3)

    def landmarks(self) -> tuple[Landmark, ...]:
        """The map.

        Raises:
            GraphError: GTSAM knows no covariance of it.
        """
        numbers = range(len(self._known))
        with _as_graph_errors(self._num_poses):
            covariances = marginals(self._joint, list(map(L, numbers)), 2)
        return self._known.landmarks(numbers, self._places, covariances)

    def _associate(
        self, perceptions: Perceptions, motion: UncertainPose2, guess: Pose2
    ) -> tuple[IntArray, BoolArray]:
        """(n,) the landmark of each perception, -1 for none; (n,) which are new."""
        landmark_ids = np.full(len(perceptions), -1, dtype=np.int64)
        near = self._near(guess.transform(perceptions.base_t_landmarks()))
        if not len(near):
            return landmark_ids, ~self._known.is_borne(perceptions, self._num_poses)
        state = self._together(near)
        state.move(motion)
        each = np.arange(len(near))
        gated = gate(state, each, self._known, near, perceptions, self._num_poses)
        rows, columns = _nearest(gated)
        landmark_ids[rows] = near[columns]
        self._nis.append(gated.distances2[rows, columns])
        return landmark_ids, gated.is_new

    def _near(self, map_t_seen: FloatArray) -> IntArray:
        """Landmarks near any place (n, 2) where something is perceived."""
        alive = np.flatnonzero(~self._known.is_given_up(self._num_poses))
        if not len(map_t_seen) or not len(alive):
            return np.zeros(0, dtype=np.int64)
        away_m = np.linalg.norm(self._places[alive, None] - map_t_seen[None], axis=2).min(axis=1)
        near: IntArray = alive[away_m <= _AROUND_M + 3.0 * self._sigma_m]
        return near

    def _together(self, landmarks: IntArray) -> PoseAndMap:
        """The last pose and landmarks as one Gaussian."""
        keys = [X(self._num_poses - 1), *map(L, landmarks.tolist())]
        with _as_graph_errors(self._num_poses):
            joint = self._joint(keys)
        state = PoseAndMap(UncertainPose2(self.pose, joint[:3, :3]))
        state.map_t_landmarks, state.covariance = self._places[landmarks], joint
        self._sigma_m = float(np.sqrt(np.trace(joint[:2, :2])))
        return state

    def _joint(self, keys: Sequence[int]) -> FloatArray:
        """The covariance of variables together, in the order of the keys."""
        if self._isam.treeNnz() < _DENSE * (3 * self._num_poses + 2 * len(self._known)):
            return np.array(self._isam.jointMarginalCovariance(list(keys)).fullMatrix())
        if self._information is None:
            self._information = _Factored.of(self._isam)
        return self._information.covariance(keys)

    def _link(self, motion: UncertainPose2) -> gtsam.NonlinearFactor:
        """What joins the new pose to the last one, or the first one to the start."""
        if not self._num_poses:
            return prior_factor(self._start @ motion)
        return odometry_factor(Odometry(self._num_poses - 1, self._num_poses, motion))

    def _read(self) -> None:
        """Where everything is after an update."""
        pose = self._isam.calculateEstimatePose2(X(self._num_poses))
        self.pose = Pose2(pose.x(), pose.y(), pose.theta())
        places = [self._isam.calculateEstimatePoint2(L(k)) for k in range(len(self._known))]
        self._places = np.array(places).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Factored:
    """The information of all variables, and which columns each one has."""

    information: Information
    columns: Mapping[int, IntArray]

    @classmethod
    def of(cls, isam: gtsam.ISAM2) -> Self:
        linear = isam.getFactorsUnsafe().linearize(isam.calculateEstimate())
        jacobian, columns = whitened(linear)
        return cls(Information.by(jacobian), columns)

    def covariance(self, keys: Sequence[int]) -> FloatArray:
        return self.information.covariance(np.concatenate([self.columns[key] for key in keys]))


def _nearest(gated: Gated) -> tuple[IntArray, IntArray]:
    """Perceptions and their nearest landmarks; of two of one landmark only the nearer."""
    distances2 = np.where(gated.allowed, gated.distances2, np.inf)
    columns = distances2.argmin(axis=1)
    each = np.arange(len(columns))
    is_own = distances2.argmin(axis=0)[columns] == each
    rows = np.flatnonzero(is_own & np.isfinite(distances2[each, columns]))
    return rows, columns[rows].astype(np.int64)


@contextmanager
def _as_graph_errors(pose: int) -> Iterator[None]:
    """GTSAM's errors as ours.

    Raises:
        GraphError: for each of GTSAM's.
    """
    try:
        yield
    except (RuntimeError, ValueError, IndexError) as error:
        reason = next(filter(None, map(str.strip, str(error).splitlines())), type(error).__name__)
        raise GraphError(f"iSAM2 gave up at pose {pose}: {reason}") from error
