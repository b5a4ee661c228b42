"""The pose and landmark graph on iSAM2. Only this, `batch_graph.py` and `factors.py` know gtsam.

The graph keeps a log of its own of every factor. iSAM2 is built from the log again when an update
fails, since a failed update leaves it unusable.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from scipy.sparse import csr_matrix

from semgraph.arrays import FloatArray, IntArray, frozen_floats
from semgraph.errors import GraphError
from semgraph.factors import (
    Odometry,
    Sighting,
    check_definite,
    check_sighting,
    odometry_factor,
    prior_factor,
    sighting_factor,
    to_gtsam,
)
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.information import Information

# Entries of the Bayes tree a column, from which on a graph is dense.
_DENSE: Final = 200
_AT_ONCE: Final = 40


@dataclass(frozen=True, slots=True, eq=False)
class GraphEstimate:
    """All variables at one moment.

    Attributes:
        map_T_bases: (n, 3), row k is pose k.
        map_t_landmarks: position (2,) by landmark.
    """

    map_T_bases: FloatArray
    map_t_landmarks: dict[int, FloatArray]


class FactorGraph:
    """Poses 0, 1, 2, ... joined by odometry, and the landmarks they sighted.

    Raises:
        GraphError: the start has no positive definite covariance.
    """

    def __init__(self, map_T_start: UncertainPose2) -> None:
        check_definite("start", map_T_start.covariance)
        self._start = map_T_start
        self._odometry: list[Odometry] = []
        self._sightings: dict[int, list[Sighting]] = {}
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_sightings: list[tuple[int, Sighting]] = []
        self._new_values = gtsam.Values()
        self._removed_slots: list[int] = []
        self._pose_guesses = [map_T_start.pose]
        self._landmark_guesses: dict[int, FloatArray] = {}
        self._factorization = "CHOLESKY"
        self._isam = _new_isam(self._factorization)
        self._estimate = gtsam.Values()
        self._factored: Information | None = None
        self._columns: dict[int, IntArray] = {}
        self._incidents: list[str] = []
        self._new_factors.add(prior_factor(map_T_start))
        self._new_values.insert(X(0), to_gtsam(map_T_start.pose))

    @property
    def num_poses(self) -> int:
        """How many poses there are, the start included."""
        return len(self._pose_guesses)

    @property
    def incidents(self) -> Sequence[str]:
        """What went wrong in updates and how it was mended, one line each."""
        return tuple(self._incidents)

    def landmarks(self) -> tuple[int, ...]:
        """The landmarks in the graph."""
        return tuple(self._sightings)

    def sightings(self, landmark: int) -> Sequence[Sighting]:
        """All sightings of a landmark, in the order they were added."""
        return tuple(self._sightings[landmark])

    def add_pose(self, motion: UncertainPose2, guess: Pose2) -> int:
        """The index of a new pose, reached from the last one by `motion`; it starts at `guess`.

        Raises:
            GraphError: the motion has no positive definite covariance.
        """
        check_definite("motion", motion.covariance)
        index = len(self._pose_guesses)
        odometry = Odometry(index - 1, index, motion)
        self._odometry.append(odometry)
        self._pose_guesses.append(guess)
        self._new_factors.add(odometry_factor(odometry))
        self._new_values.insert(X(index), to_gtsam(guess))
        return index

    def add_landmark(self, landmark: int, guess: FloatArray) -> None:
        """A new landmark near `guess` (2,); a sighting must follow before the next update.

        Raises:
            GraphError: it exists already.
            InputError: the guess is no finite point.
        """
        if landmark in self._sightings:
            raise GraphError(f"landmark {landmark} is in the graph already")
        guess = frozen_floats(f"guess of landmark {landmark}", guess, (2,))
        self._sightings[landmark] = []
        self._landmark_guesses[landmark] = guess
        self._new_values.insert(j=L(landmark), point2=guess)

    def add_sighting(self, sighting: Sighting) -> None:
        """One more sighting of a landmark that is in the graph.

        Raises:
            GraphError: no such pose or landmark, NaN, a range of zero or below, or a covariance
                that is not positive definite. GTSAM would take them in silence, and the log could
                never be solved again.
            InputError: the covariance is no finite symmetric (2, 2).
        """
        self._check_known(sighting.landmark)
        if not 0 <= sighting.pose < self.num_poses:
            raise GraphError(
                f"sighting of landmark {sighting.landmark}: expected a pose below "
                f"{self.num_poses}, got {sighting.pose}"
            )
        check_sighting(sighting)
        self._sightings[sighting.landmark].append(sighting)
        self._queue(sighting)

    def merge(self, gone: int, kept: int) -> None:
        """Makes two landmarks one with the next update: sightings of `gone` become `kept`'s.

        Raises:
            GraphError: both are the same or one is not in the graph; or factors wait for an
                update, their places in iSAM2 are not known yet.
        """
        for landmark in (gone, kept):
            self._check_known(landmark)
        if gone == kept:
            raise GraphError(f"landmark {gone}: expected another one to merge it with")
        self._check_updated(gone)
        for sighting in self._sightings.pop(gone):
            self._removed_slots.append(sighting.slot)
            sighting.landmark = kept
            self._sightings[kept].append(sighting)
            self._queue(sighting)
        del self._landmark_guesses[gone]

    def remove(self, landmark: int) -> None:
        """Takes a landmark and its sightings out with the next update.

        Raises:
            GraphError: it is not in the graph, or factors of it wait for an update.
        """
        self._check_known(landmark)
        self._check_updated(landmark)
        self._removed_slots += [sighting.slot for sighting in self._sightings.pop(landmark)]
        del self._landmark_guesses[landmark]

    def update(self, *, relinearize: bool = False) -> None:
        """Takes in all that was added since the last update.

        Args:
            relinearize: force it, after something old was seen again.

        A failure is named in `incidents`, and the graph rebuilt from its own log.
        """
        try:
            result = self._isam.update(
                self._new_factors,
                self._new_values,
                self._removed_slots,
                None,
                None,
                None,
                relinearize,
            )
            slots = list(result.getNewFactorsIndices())
            for position, sighting in self._new_sightings:
                sighting.slot = int(slots[position])
            self._estimate = self._isam.calculateEstimate()
        except (RuntimeError, ValueError, IndexError) as error:
            self._incidents.append(f"update failed, graph rebuilt: {_first_line(error)}")
            self._rebuild()
        self._empty_queue()

    def polish(self) -> None:
        """Moves to the batch optimum over the whole log, starting from the estimate at hand.

        Takes in what waits for an update; after many merges at once that is quicker than `update`.
        """
        graph, _ = self._whole_graph()
        self._estimate = _optimum(graph, self._guesses(), self._factorization)
        self._rebuild()
        self._empty_queue()

    def pose(self, index: int) -> Pose2:
        """map_T_base of one pose as of the last update."""
        pose = self._estimate.atPose2(X(index))
        return Pose2(pose.x(), pose.y(), pose.theta())

    def landmark(self, landmark: int) -> FloatArray:
        """map_t_landmark (2,) as of the last update."""
        return np.asarray(self._estimate.atPoint2(L(landmark)))

    def estimate(self) -> GraphEstimate:
        """All poses and landmarks as of the last update."""
        poses = gtsam.utilities.extractPose2(self._estimate)
        return GraphEstimate(
            np.asarray(poses), {landmark: self.landmark(landmark) for landmark in self._sightings}
        )

    def landmark_covariance(self, landmarks: Sequence[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks, in map, in the order given."""
        return self._joint([L(landmark) for landmark in landmarks])

    def landmark_covariances(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2, 2) marginal covariance of each landmark, in map."""
        return self._marginals([L(landmark) for landmark in landmarks], 2)

    def pose_covariance(self, index: int) -> FloatArray:
        """(3, 3) marginal covariance of a pose, (x, y, theta) in its own frame."""
        return self._by_isam([X(index)])

    def pose_covariances(self, indices: Sequence[int]) -> FloatArray:
        """(n, 3, 3) marginal covariance of each pose, (x, y, theta) in its own frame."""
        return self._marginals([X(index) for index in indices], 3)

    def _joint(self, keys: Sequence[int]) -> FloatArray:
        """The covariance of variables together.

        iSAM2 needs the cliques between them; where these are large, in a dense stand, the sparse
        matrix of the whole graph is tenfold quicker.
        """
        try:
            if self._is_dense():
                information = self._information()
                return information.covariance(np.concatenate([self._columns[k] for k in keys]))
        except GraphError as error:
            self._incidents.append(f"covariance by iSAM2: {error}")
        return self._by_isam(keys)

    def _marginals(self, keys: Sequence[int], size: int) -> FloatArray:
        """(n, size, size): by the dozen, which costs little more than one."""
        covariances = np.zeros((len(keys), size, size))
        for start in range(0, len(keys), _AT_ONCE):
            some = keys[start : start + _AT_ONCE]
            joint = self._joint(some).reshape(len(some), size, len(some), size)
            each = np.arange(len(some))
            covariances[start : start + len(some)] = joint[each, :, each, :]
        return covariances

    def _is_dense(self) -> bool:
        num_columns = 3 * self.num_poses + 2 * len(self._sightings)
        return bool(self._isam.treeNnz() >= _DENSE * num_columns)

    def _by_isam(self, keys: Sequence[int]) -> FloatArray:
        try:
            return self._isam_covariance(keys)
        except RuntimeError as error:
            if self._factorization == "QR":
                raise GraphError(f"no covariance: {_first_line(error)}") from error
            self._incidents.append(f"no covariance, QR from now on: {_first_line(error)}")
            self._factorization = "QR"
            self._rebuild()
            return self._isam_covariance(keys)

    def _isam_covariance(self, keys: Sequence[int]) -> FloatArray:
        if len(keys) == 1:
            return np.asarray(self._isam.marginalCovariance(keys[0]))
        return np.asarray(self._isam.jointMarginalCovariance(list(keys)).fullMatrix())

    def _information(self) -> Information:
        """Of all variables as of the last update; made when it is first asked for.

        Raises:
            GraphError: the graph is singular.
        """
        if self._factored is None:
            linear = self._isam.getFactorsUnsafe().linearize(self._estimate)
            row, column, value = linear.sparseJacobian_()
            widths = {key: 2 if key < X(0) else 3 for key in sorted(linear.keys())}
            starts = np.cumsum([0, *widths.values()])
            self._columns = {
                key: np.arange(start, start + width)
                for (key, width), start in zip(widths.items(), starts[:-1].tolist(), strict=True)
            }
            # The last column is the right side.
            whole = csr_matrix((value, (row.astype(np.int64) - 1, column.astype(np.int64) - 1)))
            self._factored = Information(whole[:, : starts[-1]])
        return self._factored

    def _check_known(self, landmark: int) -> None:
        if landmark not in self._sightings:
            raise GraphError(f"landmark {landmark} is not in the graph; add it first")

    def _check_updated(self, landmark: int) -> None:
        if any(sighting.landmark == landmark for _, sighting in self._new_sightings):
            raise GraphError(f"landmark {landmark}: update the graph before it is taken out")

    def _queue(self, sighting: Sighting) -> None:
        self._new_sightings.append((self._new_factors.size(), sighting))
        self._new_factors.add(sighting_factor(sighting))

    def _empty_queue(self) -> None:
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_sightings = []
        self._new_values = gtsam.Values()
        self._removed_slots = []
        self._factored = None

    def _whole_graph(self) -> tuple[gtsam.NonlinearFactorGraph, list[Sighting]]:
        """All factors of the log, and the sightings in the order of their factors."""
        graph = gtsam.NonlinearFactorGraph()
        graph.add(prior_factor(self._start))
        for odometry in self._odometry:
            graph.add(odometry_factor(odometry))
        sightings = [sighting for group in self._sightings.values() for sighting in group]
        for sighting in sightings:
            graph.add(sighting_factor(sighting))
        return graph, sightings

    def _rebuild(self) -> None:
        """A new iSAM2 over the whole log, at the last good estimate; by QR if it must be.

        Raises:
            GraphError: the log itself cannot be solved.
        """
        graph, sightings = self._whole_graph()
        isam = _new_isam(self._factorization)
        try:
            isam.update(graph, self._guesses())
            self._estimate = isam.calculateEstimate()
        except (RuntimeError, ValueError, IndexError) as error:
            if self._factorization == "QR":
                raise GraphError(f"the graph cannot be solved: {_first_line(error)}") from error
            self._factorization = "QR"
            self._rebuild()
            return
        first = 1 + len(self._odometry)
        for position, sighting in enumerate(sightings):
            sighting.slot = first + position
        self._isam = isam

    def _guesses(self) -> gtsam.Values:
        """The last good value of each variable, and the first guess of new ones."""
        values = gtsam.Values()
        for index, guess in enumerate(self._pose_guesses):
            known = self._estimate.exists(X(index))
            values.insert(X(index), self._estimate.atPose2(X(index)) if known else to_gtsam(guess))
        for landmark, position in self._landmark_guesses.items():
            known = self._estimate.exists(L(landmark))
            values.insert(j=L(landmark), point2=self.landmark(landmark) if known else position)
        return values


def _new_isam(factorization: str) -> gtsam.ISAM2:
    """iSAM2 by Cholesky, or QR: that is slower but takes graphs whose sigmas differ by decades."""
    params = gtsam.ISAM2Params()
    params.setFactorization(factorization)
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.01))
    params.setRelinearizeThreshold(0.05)
    params.relinearizeSkip = 1
    params.enablePartialRelinearizationCheck = True
    params.findUnusedFactorSlots = True
    return gtsam.ISAM2(params)


def _optimum(
    graph: gtsam.NonlinearFactorGraph, guesses: gtsam.Values, factorization: str
) -> gtsam.Values:
    """The batch optimum; by QR if it must be."""
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType(f"MULTIFRONTAL_{factorization}")
    try:
        return gtsam.LevenbergMarquardtOptimizer(graph, guesses, params).optimize()
    except RuntimeError:
        if factorization == "QR":
            raise
        return _optimum(graph, guesses, "QR")


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
