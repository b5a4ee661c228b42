"""iSAM2, and what waits for it. Only this, `batch_graph.py` and `factors.py` know gtsam."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from scipy.sparse import csr_matrix

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.geometry import Pose2, relative_poses
from semgraph.graph.factors import to_gtsam, whitened

# A variable that is farther from where it was linearized, in m or rad, is linearized again.
_MOVED: Final = 0.1
# So far off, what iSAM2 does not find from its root is looked for.
_LOST: Final = 0.5
_INDEX: Final = (1 << 56) - 1
_FAILURES: Final = (RuntimeError, ValueError, IndexError)


class UpdateError(GraphError):
    """GTSAM could not; the graph is unusable from now on."""


class NoCovarianceError(GraphError):
    """GTSAM could not, but the graph is as it was."""


class Slots(dict[int, int]):
    """Where the factors of one table (motions, sightings, ...) are in iSAM2, by their number.

    -1 where one is not, or waits.
    """

    def __missing__(self, number: int) -> int:
        return -1


@dataclass(frozen=True, slots=True, eq=False)
class Values:
    """All variables: numbers of poses, ascending, (n, 3) of them, and (2,) by landmark."""

    poses: IntArray
    map_T_bases: FloatArray
    map_t_landmarks: Mapping[int, FloatArray]


@final
class Incremental:
    """iSAM2 by Cholesky, or QR: that is slower but takes graphs whose sigmas differ by decades."""

    def __init__(self, factorization: str = "CHOLESKY") -> None:
        self.factorization = factorization
        self._isam = _new_isam(factorization)
        self.forget_waiting()

    def copy(self) -> "Incremental":
        """As of the last update, without what waits; in milliseconds, since cliques are shared."""
        copied = Incremental(self.factorization)
        copied._isam = gtsam.ISAM2(self._isam)
        return copied

    def forget_waiting(self) -> None:
        """Nothing waits for an update any more."""
        self._factors = gtsam.NonlinearFactorGraph()
        self._owners: list[tuple[Slots, int]] = []
        self._values = gtsam.Values()
        self._removed: list[int] = []

    @property
    def is_updated(self) -> bool:
        """Whether nothing waits for an update."""
        return self._factors.size() == 0 and not self._removed

    def waiting(self, slots: Slots) -> list[int]:
        """Numbers of a table's factors that wait."""
        return [number for owner, number in self._owners if owner is slots]

    def add(self, factor: gtsam.NonlinearFactor, slots: Slots, number: int) -> None:
        """With the next update this factor, whose slot will be told, is in the graph."""
        self._factors.add(factor)
        self._owners.append((slots, number))

    def remove(self, slots: Slots, number: int) -> None:
        """With the next update it is not."""
        self._removed.append(slots.pop(number, -1))

    def insert_pose(self, pose: int, guess: Pose2) -> None:
        """A variable more."""
        self._values.insert(X(pose), to_gtsam(guess))

    def insert_landmark(self, landmark: int, guess: FloatArray) -> None:
        """A variable more."""
        self._values.insert(j=L(landmark), point2=guess)

    def update(self, *, relinearize: bool = False) -> None:
        """Takes in what waits, which waits on until `forget_waiting`.

        Args:
            relinearize: force it.

        Raises:
            UpdateError: with the reason in a line.
        """
        try:
            result = self._isam.update(
                self._factors, self._values, self._removed, None, None, None, relinearize
            )
        except _FAILURES as error:
            raise UpdateError(_first_line(error)) from error
        for (slots, number), slot in zip(self._owners, result.getNewFactorsIndices(), strict=True):
            slots[number] = int(slot)

    def linearize_again(self, times: int, *, everywhere: bool) -> None:
        """So many steps more at most, with nothing new: until nothing moves far.

        iSAM2 looks from the root on for what moved, and not beyond what did not.

        Args:
            times: how many.
            everywhere: where it finds nothing, what moved most is brought to the root if that is
                far; to find it takes time as long as the run.

        Raises:
            UpdateError: with the reason in a line.
        """
        for _ in range(times):
            if self._step(gtsam.KeyGroupMap(), gtsam.KeyList()):
                continue
            moved = self._most_moved() if everywhere else None
            if moved is None:
                return
            groups, pulled = gtsam.KeyGroupMap(), gtsam.KeyList()
            groups.insert2(moved, 1)
            pulled.push_back(moved)
            self._step(groups, pulled)

    def _step(self, groups: gtsam.KeyGroupMap, pulled: gtsam.KeyList) -> int:
        """How many variables were linearized again, with nothing new."""
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        try:
            result = self._isam.update(factors, values, [], groups, None, pulled, True)
        except _FAILURES as error:
            raise UpdateError(_first_line(error)) from error
        return int(result.getVariablesRelinearized())

    def _most_moved(self) -> int | None:
        """The key of the pose farthest from where it was linearized, None for no far one."""
        then, now = _read(self._isam.getLinearizationPoint()), self.values()
        off = np.abs(relative_poses(then.map_T_bases, now.map_T_bases))
        row = int(off.max(axis=1).argmax())
        return int(X(then.poses[row])) if off[row].max() > _LOST else None

    def has_pose(self, pose: int) -> bool:
        """As of the last update."""
        return bool(self._isam.valueExists(X(pose)))

    def has_landmark(self, landmark: int) -> bool:
        """As of the last update."""
        return bool(self._isam.valueExists(L(landmark)))

    def pose(self, pose: int) -> Pose2:
        """map_T_base as of the last update.

        Raises:
            UpdateError: with the reason in a line.
        """
        try:
            found = self._isam.calculateEstimatePose2(X(pose))
        except _FAILURES as error:
            raise UpdateError(_first_line(error)) from error
        return Pose2(found.x(), found.y(), found.theta())

    def landmark(self, landmark: int) -> FloatArray:
        """map_t_landmark (2,) as of the last update."""
        return np.array(self._isam.calculateEstimatePoint2(L(landmark)))

    def values(self) -> Values:
        """All of them; takes time as long as the run.

        Raises:
            UpdateError: with the reason in a line.
        """
        try:
            return _read(self._isam.calculateEstimate())
        except _FAILURES as error:
            raise UpdateError(_first_line(error)) from error

    def cost(self) -> float:
        """Half the sum of all chi-squares, under the kernel; takes time as long as the run."""
        return float(self._isam.getFactorsUnsafe().error(self._isam.calculateEstimate()))

    def go_to_optimum(self) -> Values:
        """What waits is at its batch optimum from now on, and where that is; by QR if it must be.

        Raises:
            GraphError: not even then.
        """
        for factorization in dict.fromkeys((self.factorization, "QR")):
            params = gtsam.LevenbergMarquardtParams()
            params.setLinearSolverType(f"MULTIFRONTAL_{factorization}")
            try:
                optimizer = gtsam.LevenbergMarquardtOptimizer(self._factors, self._values, params)
                self._values = optimizer.optimize()
            except RuntimeError as error:
                failure = error
            else:
                return _read(self._values)
        raise GraphError(f"the graph cannot be solved: {_first_line(failure)}") from failure

    def covariance(self, keys: Sequence[int]) -> FloatArray:
        """(d, d) of variables together, by the cliques between them.

        Raises:
            NoCovarianceError: with the reason in a line.
        """
        try:
            if len(keys) == 1:
                return np.asarray(self._isam.marginalCovariance(keys[0]))
            return np.asarray(self._isam.jointMarginalCovariance(list(keys)).fullMatrix())
        except RuntimeError as error:
            raise NoCovarianceError(_first_line(error)) from error

    @property
    def num_entries(self) -> int:
        """Of the Bayes tree."""
        return int(self._isam.treeNnz())

    def jacobian(self) -> tuple[csr_matrix, dict[int, IntArray]]:
        """Of all factors where everything is now, whitened; and the columns of each key."""
        return whitened(self._isam.getFactorsUnsafe().linearize(self._isam.calculateEstimate()))


def _read(values: gtsam.Values) -> Values:
    keys = np.array(sorted(values.keys()), dtype=np.uint64)
    poses = keys[keys >= X(0)] & np.uint64(_INDEX)
    landmarks = (keys[keys < X(0)] & np.uint64(_INDEX)).tolist()
    places = np.asarray(gtsam.utilities.extractPoint2(values)).reshape(-1, 2)
    return Values(
        poses.astype(np.int64),
        np.asarray(gtsam.utilities.extractPose2(values)).reshape(-1, 3),
        dict(zip(landmarks, places, strict=True)),
    )


def _new_isam(factorization: str) -> gtsam.ISAM2:
    params = gtsam.ISAM2Params()
    params.setFactorization(factorization)
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.01))
    params.setRelinearizeThreshold(_MOVED)
    # Closures force it; relinearizing less often costs no accuracy, for the end is a batch.
    params.relinearizeSkip = 3
    params.enablePartialRelinearizationCheck = True
    params.findUnusedFactorSlots = True
    return gtsam.ISAM2(params)


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
