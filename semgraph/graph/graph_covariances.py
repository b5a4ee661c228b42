"""How sure a graph is of its poses and landmarks, and how they lie to each other."""

from collections.abc import Callable, Iterable, Sequence
from typing import Final, TypeVar, final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.errors import GraphError
from semgraph.geometry import rotation
from semgraph.graph.common_errors import CommonErrors, Ranges
from semgraph.graph.condensation import linearized
from semgraph.graph.covariances import Covariances
from semgraph.graph.drift import Drift, sigma_m
from semgraph.graph.factors import landmark_key, pose_key
from semgraph.graph.graph_log import NOWHERE
from semgraph.graph.graph_solver import GraphSolver
from semgraph.graph.incremental import NoCovarianceError
from semgraph.graph.pieces import Piece, covariance_by
from semgraph.graph.windows import NONE

Answer = TypeVar("Answer")
_LEAST_SIGMA_M: Final = 1e-3
# So often more of the graph is taken, each time what is beside, before all of it is.
_HOPS: Final = 4
# More windows take longer than all that does not rest.
_MOST: Final = 60


@final
class GraphCovariances:
    """Of a graph as of its last update."""

    def __init__(self, solver: GraphSolver) -> None:
        self._solver = solver
        self.forget()

    def forget(self) -> None:
        """The graph has changed."""
        solver = self._solver
        # Condensed factors are slow to linearize, and a long graph is slow to factor.
        num_columns = (
            None if len(solver.windows) else 3 * solver.log.num_poses + 2 * len(solver.log)
        )
        self._covariances = Covariances(solver.isam, num_columns, solver.incidents)
        self._of_poses: dict[int, FloatArray] = {}
        self._drift: Drift | None = None

    def of_landmarks_together(self, landmarks: Sequence[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks, in map, in the order given."""
        self._show(landmarks)
        if self._solver.bring(landmarks):
            self.forget()
        return self.joint([landmark_key(landmark) for landmark in landmarks])

    def around(self, landmarks: Sequence[int], around: Iterable[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks as if the last pose were known, in map.

        By what is not condensed and what else was sighted together with those `around`: what lies
        farther off could make it smaller, but it costs as much as the run is long. Where these do
        not hold them together, by what is beside it too; at last, or nothing condensed, by all.
        """
        if not len(self._solver.windows) or not self._solver.isam.is_updated:
            return self.of_landmarks_together(landmarks)
        windows = self._solver.windows.of_any((*around, *landmarks))
        try:
            newest = self._last_piece(landmarks)
        except GraphError as error:
            self._solver.incidents.append(f"covariance by the whole graph: {error}")
            return self.of_landmarks_together(landmarks)
        pieces: dict[int, Piece] = {}
        for _ in range(_HOPS):
            pieces |= {number: self._piece(number) for number in windows - pieces.keys()}
            found = covariance_by([pieces[k] for k in sorted(pieces)], newest, landmarks)
            if found is not None:
                return found
            windows |= self._solver.windows.beside(windows)
            if self._solver.resting.awake is not None and len(windows) > _MOST:
                break
        return self.of_landmarks_together(landmarks)

    def of_landmarks(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2, 2) marginal covariance of each landmark, in map; with errors in common."""
        self._show(landmarks)
        if not all(map(self._solver.isam.has_landmark, landmarks)):
            self._wake()
        keys = [landmark_key(landmark) for landmark in landmarks]
        covariances = self._sure(lambda known: known.marginals(keys, 2))
        return covariances + self._added(keys, 2)[0]

    def given_last_pose(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2, 2) of each landmark in the last pose's frame, as if that pose were known."""
        last = self._solver.last
        joint = self.joint([pose_key(last), *map(landmark_key, landmarks)])
        gain = np.linalg.solve(joint[:3, :3], joint[:3, 3:])
        given = (joint[3:, 3:] - gain.T @ joint[:3, 3:]).reshape(
            len(landmarks), 2, len(landmarks), 2
        )
        each = np.arange(len(landmarks))
        base_R_map = rotation(-self._solver.pose(last).theta)
        in_base = base_R_map @ given[each, :, each, :] @ base_R_map.T
        # Where the pose is unsure by kilometres, little is left of the difference but rounding.
        values, axes = np.linalg.eigh(0.5 * (in_base + in_base.transpose(0, 2, 1)))
        floored: FloatArray = np.maximum(values, _LEAST_SIGMA_M**2)
        covariances: FloatArray = (axes * floored[:, None, :]) @ axes.transpose(0, 2, 1)
        return covariances

    def of_pose(self, index: int) -> FloatArray:
        """(3, 3) marginal covariance of a pose, (x, y, theta) in its own frame."""
        if index not in self._of_poses:
            self._uncondense([index])
            self._of_poses[index] = self.joint([pose_key(index)])
            self._solver.ends.note(index, self._of_poses[index])
        return self._of_poses[index]

    def drift(self) -> Drift:
        """How far the last pose may have drifted, beside what hangs together with it and all else.

        What holds the former in the map is unsure for the pose and for all of that alike.
        """
        if self._drift is None:
            self._drift = self._last_drift()
        return self._drift

    def _last_drift(self) -> Drift:
        solver = self._solver
        covariance = self.of_pose(solver.last)
        apart_m = sigma_m(covariance)
        if solver.resting.awake is None:
            poses, beside = {0}, None
        else:
            poses, beside = solver.resting.beside()
        anchors = [hold for hold in solver.part.holds if hold.anchor in poses]
        if len(anchors) != 1:
            return Drift(apart_m, apart_m, beside)
        last_Ad_anchor = solver.pose(solver.last).between(solver.pose(anchors[0].anchor)).adjoint()
        in_common = last_Ad_anchor @ anchors[0].map_T_anchor.covariance @ last_Ad_anchor.T
        return Drift(sigma_m(covariance - in_common), apart_m, beside)

    def of_poses(self, indices: Sequence[int]) -> FloatArray:
        """(n, 3, 3) marginal covariance of each pose, in its own frame; with errors in common."""
        self._uncondense(indices)
        keys = [pose_key(index) for index in indices]
        covariances = self._sure(lambda known: known.marginals(keys, 3))
        return covariances + self._added(keys, 3)[0]

    def of_chain(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3, 3) marginal covariance of each pose, and of each with the one after it.

        Each in its own frame; after the last pose there is none, the cross covariance is 0. With
        errors in common.
        """
        indices = range(self._solver.log.num_poses)
        self._uncondense(indices)
        keys = [pose_key(index) for index in indices]
        covariances, crosses = self._sure(lambda known: known.chain(keys))
        own, added = self._added(keys, 3)
        return covariances + own, crosses + added

    def joint(self, keys: Sequence[int]) -> FloatArray:
        """Of any variables together, by their keys."""
        return self._sure(lambda known: known.joint(keys))

    def _added(self, keys: Sequence[int], size: int) -> tuple[FloatArray, FloatArray]:
        """(n, size, size) that errors in common add to each variable, and to each with the next.

        Nothing while stretches are condensed: the sightings in those are no more.
        """
        log, nothing = self._solver.log, np.zeros((len(keys), size, size))
        rows = np.flatnonzero((log.common_shares > 0.0) & (log.landmarks != NOWHERE))
        if not len(rows) or not keys or len(self._solver.windows):
            return nothing, nothing
        try:
            information, columns = self._covariances.information()
        except GraphError as error:
            self._solver.incidents.append(f"covariances without errors in common: {error}")
            return nothing, nothing
        names, things = np.unique(log.landmarks[rows], return_inverse=True)
        landmarks = names.tolist()
        ranges = Ranges(
            self._solver.poses(np.arange(log.num_poses)),
            self._places(landmarks),
            log.poses[rows],
            things,
            log.polar(rows),
            log.covariances(rows),
            log.common_shares[rows].astype(np.float64),
        )
        common = CommonErrors(
            information,
            ranges,
            np.array([columns[pose_key(pose)] for pose in range(log.num_poses)]),
            np.array([columns[landmark_key(landmark)] for landmark in landmarks]),
        )
        return common.added(np.array([columns[key] for key in keys]))

    def _piece(self, number: int) -> Piece:
        """A window where it is now."""
        window = self._solver.windows[number]
        return Piece(
            window.first,
            window.last,
            tuple(window.landmarks.tolist()),
            *linearized(
                window.condensed,
                self._solver.pose(window.first).as_array(),
                self._solver.pose(window.last).as_array(),
                np.array([self._solver.landmark(k) for k in window.landmarks.tolist()]).reshape(
                    -1, 2
                ),
            )[1:],
        )

    def _last_piece(self, asked: Sequence[int]) -> Piece:
        """What is not condensed as yet, condensed for once.

        What was sighted once and is not asked about holds nothing: in clutter that is most.
        """
        last = self._solver.last
        first = last
        while first > 0 and self._solver.windows.of_motion(first) == NONE:
            first -= 1
        log, kept = self._solver.log, set(asked)
        rows = log.rows_of_poses(first + 1, last)
        names, things = np.unique(log.landmarks[rows], return_inverse=True)
        holds = [name in kept or len(log.rows(name)) > 1 for name in names.tolist()]
        rows = rows[np.array(holds, dtype=bool)[things]]
        poses = np.array([self._solver.pose(k).as_array() for k in range(first, last + 1)])
        taken_for, condensed = self._solver.condense(first, last, rows)
        landmarks = tuple(taken_for[:, 0].tolist())
        places = self._places(landmarks)
        return Piece(
            first, last, landmarks, *linearized(condensed, poses[0], poses[-1], places)[1:]
        )

    def _sure(self, ask: Callable[[Covariances], Answer]) -> Answer:
        """What is asked for; by QR from now on if it must be.

        Raises:
            GraphError: not even then.
        """
        try:
            return ask(self._covariances)
        except NoCovarianceError as error:
            if self._solver.isam.factorization == "QR":
                raise GraphError(f"no covariance: {error}") from error
            self._solver.incidents.append(f"no covariance, QR from now on: {error}")
            self._solver.isam.factorization = "QR"
            self._solver.rebuild()
            self.forget()
            return ask(self._covariances)

    def _uncondense(self, poses: Sequence[int]) -> None:
        """Builds the whole graph, if one of these poses was given up or rests."""
        if any(self._solver.windows.of_pose(pose) != NONE for pose in poses):
            self._solver.uncondense()
            self.forget()
        elif not all(map(self._solver.isam.has_pose, poses)):
            self._wake()

    def _show(self, landmarks: Sequence[int]) -> None:
        """What of these was only glimpsed is solved from now on."""
        if not self._solver.windows.glimpsed.isdisjoint(landmarks):
            self._solver.show(landmarks)
            self._solver.update()
            self.forget()

    def _wake(self) -> None:
        """Nothing rests until the next update."""
        self._solver.wake()
        self.forget()

    def _places(self, landmarks: Sequence[int]) -> FloatArray:
        """(n, 2) m in map."""
        return np.array([self._solver.landmark(k) for k in landmarks]).reshape(-1, 2)
