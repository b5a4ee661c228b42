"""How sure the poses are that windows begin and end with: by that a long run's part is held."""

from collections.abc import Callable, Iterable
from typing import final

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2
from semgraph.graph.factors import pose_key
from semgraph.graph.incremental import Incremental, NoCovarianceError


@final
class WindowEnds:
    """Covariances as they were when windows were condensed, later ones would cost too much.

    Attributes:
        covariances: (3, 3) by pose, in its own frame.
    """

    def __init__(self) -> None:
        self.covariances: dict[int, FloatArray] = {}
        self._noted: dict[int, FloatArray] = {}

    def note(self, pose: int, covariance: FloatArray) -> None:
        """It was asked how sure a pose is (3, 3), which may come to be an end or near one."""
        self._noted[pose] = covariance

    def keep(self, end: int, map_T_pose: Callable[[int], Pose2]) -> None:
        """A window ends with this pose: it is as sure as the next one that was asked about."""
        self._noted = {pose: known for pose, known in self._noted.items() if pose >= end}
        later = min(self._noted, default=None)
        if later is not None:
            end_Ad_later = map_T_pose(end).between(map_T_pose(later)).adjoint()
            self.covariances[end] = end_Ad_later @ self._noted[later] @ end_Ad_later.T

    def solve(self, poses: Iterable[int], isam: Incremental) -> list[str]:
        """Asks a graph for those that nobody asked about; what went wrong, a line each."""
        incidents = []
        for pose in poses:
            try:
                if pose not in self.covariances and isam.has_pose(pose):
                    self.covariances[pose] = isam.covariance([pose_key(pose)])
            except NoCovarianceError as error:
                incidents.append(f"it is not known how sure pose {pose} is: {error}")
        return incidents
