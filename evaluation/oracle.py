"""What is possible: the batch optimum over the same measurements with the true associations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.fast_estimator import FastEstimator
from semgraph.files.yaw_rates import YawRateLog
from semgraph.first_motion import tell_first_motion
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.landmarks import Kind, Perceptions
from semgraph.measurement_model import CHI2_2DOF_999, mahalanobis2
from semgraph.moments import moments
from semgraph.offline.batch import Batch, Belief, Prior
from semgraph.perceiving import Perceiver
from semgraph.settings import Settings
from sensors.truth import Source, TrueLandmarks, TruePath

_NEAR_M: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Oracle:
    """The optimum.

    Attributes:
        trajectory: a pose at each moment.
        covariances: (n, 3, 3) of the poses, each in its own frame.
        map_t_landmarks: (2,) of each true landmark that was sighted, by its row.
        landmark_covariances: (2, 2) of the same.
        known: what else their perceptions say of the same.
        associations: by stamp, the row of each perception (n,), -1 for none.
    """

    trajectory: Trajectory
    covariances: FloatArray
    map_t_landmarks: Mapping[int, FloatArray]
    landmark_covariances: Mapping[int, FloatArray]
    known: Mapping[int, GraphLandmark]
    associations: Mapping[int, IntArray]


def oracle(source: Source, settings: Settings) -> Oracle:
    """The batch optimum with the noise, motion model and kernel that the smoother has.

    Where the truth has no row for each perception, one is taken for the nearest true landmark of
    its kind, within half a metre and the 99.9 % gate of where the true pose has it.

    Raises:
        InputError: without true poses and landmarks there are no true associations.
    """
    recording, truth = source.recording, _Known.of(source)
    tracker = FastEstimator(settings.tracker, recording.map_T_start)
    graph = FactorGraph(settings.smoother.start(recording.map_T_start))
    perceiver, stamps_ns = Perceiver(recording, settings), list[int]()
    known, associations = dict[int, GraphLandmark](), dict[int, IntArray]()
    map_T_world, odom_T_last = recording.map_T_start, recording.map_T_start
    tell_first_motion(recording, perceiver, settings.fast)
    for moment in moments(recording, perceiver, YawRateLog()):
        step = tracker.step(moment.perceptions, moment.odometry)
        world_T_base = truth.pose(step.stamp_ns)
        if stamps_ns:
            moved = odom_T_last.between(step.map_T_base.pose)
            perceiver.moved(moved, 1e-9 * (step.stamp_ns - stamps_ns[-1]))
        else:
            map_T_world = recording.map_T_start @ world_T_base.inverse()
        odom_T_last = step.map_T_base.pose
        graph.add_pose(step.motion, map_T_world @ world_T_base)
        stamps_ns.append(step.stamp_ns)
        rows = truth.rows(moment.perceptions, world_T_base)
        associations[step.stamp_ns] = rows
        for row in np.flatnonzero(rows >= 0).tolist():
            landmark, kind = int(rows[row]), Kind(int(moment.perceptions.kinds[row]))
            known.setdefault(
                landmark, GraphLandmark(kind, str(moment.perceptions.identities[row]))
            ).sight(len(stamps_ns) - 1, moment.perceptions, row)
        _sight(graph, moment.perceptions, rows, map_T_world @ world_T_base)
    graph.polish()
    estimate, landmarks = graph.estimate(), graph.landmarks()
    return Oracle(
        Trajectory(np.array(stamps_ns, dtype=np.int64), estimate.map_T_bases[1:]),
        graph.pose_covariances(range(1, graph.num_poses)),
        estimate.map_t_landmarks,
        dict(zip(landmarks, graph.landmark_covariances(landmarks), strict=True)),
        known,
        associations,
    )


def true_belief(source: Source, batch: Batch, priors: Sequence[Prior]) -> Belief:
    """A batch's true poses and associations, in the world; landmarks are rows of the truth.

    With a prior map of true landmarks, that a batch optimum starts from.

    Raises:
        InputError: without true poses and landmarks there are no true associations.
    """
    truth = _Known.of(source)
    poses = [truth.pose(stamp_ns) for stamp_ns in batch.stamps_ns.tolist()]
    rows = np.full(len(batch.seen), -1, dtype=np.int64)
    starts, ends = (
        np.searchsorted(batch.scans, np.arange(len(batch)), side) for side in ("left", "right")
    )
    for scan, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        perceptions = replace(
            batch.seen.select(np.arange(start, end)), stamp_ns=int(batch.stamps_ns[scan])
        )
        rows[start:end] = truth.rows(perceptions, poses[scan])
    places = truth.landmarks.world_t_landmarks
    known = {row: places[row] for row in np.unique(rows[rows >= 0]).tolist()}
    seen = tuple(prior for prior in priors if prior.landmark in known)
    return Belief(np.array([pose.as_array() for pose in poses]), rows, known, seen)


def true_rows(source: Source, perceptions: Sequence[Perceptions]) -> dict[int, IntArray]:
    """By stamp, the true landmark of each thing found in raw measurements (n,), -1 for none.

    Raises:
        InputError: without true poses and landmarks there are no true associations.
    """
    truth = _Known.of(source)
    return {each.stamp_ns: truth.rows(each, truth.pose(each.stamp_ns)) for each in perceptions}


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """Truth with all that an oracle needs."""

    path: TruePath
    headings: FloatArray
    landmarks: TrueLandmarks
    associations: Mapping[int, IntArray]

    @classmethod
    def of(cls, source: Source) -> Self:
        """Raises InputError where something is not known."""
        path, landmarks = source.truth.path, source.truth.landmarks
        if path is None or path.headings is None or landmarks is None:
            raise InputError(
                f"{source.recording.name}: expected true poses and landmarks for an oracle"
            )
        # Of raw measurements the truth tells what is in sight, not what was perceived.
        associations = {} if source.recording.detectors else source.truth.associations or {}
        return cls(path, path.headings, landmarks, associations)

    def pose(self, stamp_ns: int) -> Pose2:
        """world_T_base at the true pose that is nearest in time."""
        row = int(np.abs(self.path.stamps_ns - stamp_ns).argmin())
        x, y = self.path.world_t_reference[row].tolist()
        return Pose2(x, y, float(self.headings[row]))

    def rows(self, perceptions: Perceptions, world_T_base: Pose2) -> IntArray:
        """(n,) the true landmark of each perception, -1 for none."""
        known = self.associations.get(perceptions.stamp_ns)
        if known is not None and len(known) == len(perceptions):
            return known
        places, covariances = UncertainPose2(world_T_base, np.zeros((3, 3))).transform(
            perceptions.base_t_landmarks(), perceptions.base_covariances()
        )
        rows = np.full(len(perceptions), -1, dtype=np.int64)
        if not len(perceptions) or not len(self.landmarks.kinds):
            return rows
        errors = places[:, None] - self.landmarks.world_t_landmarks[None]
        distances2 = mahalanobis2(errors, covariances[:, None])
        is_possible = perceptions.kinds[:, None] == self.landmarks.kinds[None]
        is_possible &= np.linalg.norm(errors, axis=2) <= _NEAR_M
        distances2 = np.where(is_possible, distances2, np.inf)
        nearest, each = distances2.argmin(axis=1), np.arange(len(rows))
        # Of two perceptions of one thing only the nearer is it.
        is_own = distances2.argmin(axis=0)[nearest] == each
        return np.where(is_own & (distances2[each, nearest] <= CHI2_2DOF_999), nearest, -1)


def _sight(graph: FactorGraph, perceptions: Perceptions, rows: IntArray, map_T_base: Pose2) -> None:
    """As the smoother weighs it: an unreliable perception less."""
    places = map_T_base.transform(perceptions.base_t_landmarks())
    known = set(graph.landmarks())
    for k in np.flatnonzero(rows >= 0).tolist():
        landmark = int(rows[k])
        if landmark not in known:
            graph.add_landmark(landmark, places[k])
        graph.add_sighting(Sighting.of(perceptions, k, graph.num_poses - 1, landmark))
