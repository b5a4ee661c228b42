"""iSAM2 as it comes: one update a pose with GTSAM's defaults, nearest neighbours, no front end.

Each perception is the landmark that is nearest by Mahalanobis distance under the marginals of pose
and landmarks together, within a gate. What is far from everything of its kind is a new landmark.
Noise, motion and the map's rules are those of all estimators here; the kernel of the sightings is
not: under it a loop that is closed from afar moves nothing.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Final, final

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
from semgraph.factors import (
    Odometry,
    Sighting,
    odometry_factor,
    prior_factor,
    sighting_factor,
    to_gtsam,
)
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Landmark, Perceptions
from semgraph.pipeline import Moment
from semgraph.settings import Settings
from semgraph.smoother import SmootherSettings
from sensors.truth import Source

_AROUND_M: Final = 1.0


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
        self._num_poses += 1
        return landmark_ids

    def poses(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3) map_T_bases, and (n, 3, 3) their covariances, each in its own frame."""
        with _as_graph_errors(self._num_poses):
            estimate = self._isam.calculateEstimate()
            covariances = [self._isam.marginalCovariance(X(k)) for k in range(self._num_poses)]
        return np.asarray(gtsam.utilities.extractPose2(estimate)), np.array(covariances)

    def landmarks(self) -> tuple[Landmark, ...]:
        """The map.

        Raises:
            GraphError: GTSAM knows no covariance of it.
        """
        numbers = range(len(self._known))
        with _as_graph_errors(self._num_poses):
            covariances = [self._isam.marginalCovariance(L(k)) for k in numbers]
        return self._known.landmarks(numbers, self._places, np.array(covariances).reshape(-1, 2, 2))

    def _associate(
        self, perceptions: Perceptions, motion: UncertainPose2, guess: Pose2
    ) -> tuple[IntArray, BoolArray]:
        """(n,) the landmark of each perception, -1 for none; (n,) which are new."""
        landmark_ids = np.full(len(perceptions), -1, dtype=np.int64)
        near = self._near(guess.transform(perceptions.base_t_landmarks()))
        if not len(near):
            return landmark_ids, np.ones(len(perceptions), dtype=np.bool_)
        state = self._together(near)
        state.move(motion)
        gated = gate(state, np.arange(len(near)), self._known, near, perceptions)
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
            joint = np.array(self._isam.jointMarginalCovariance(keys).fullMatrix())
        state = PoseAndMap(UncertainPose2(self.pose, joint[:3, :3]))
        state.map_t_landmarks, state.covariance = self._places[landmarks], joint
        self._sigma_m = float(np.sqrt(np.trace(joint[:2, :2])))
        return state

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
