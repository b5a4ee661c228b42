"""Where everything in a graph is, as it was last read of iSAM2: that is read no more than need be.

Reading everything would cost more than an update, the longer the run the more.
"""

from collections.abc import Mapping
from typing import Final, final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2
from semgraph.graph.condensation import follow
from semgraph.graph.graph_states import GraphEstimate
from semgraph.graph.growing import Growing
from semgraph.graph.incremental import Incremental, Values
from semgraph.graph.windows import Windows
from semgraph.point_grid import PointGrid

# Cells of the places of landmarks; about as far as things are seen.
_CELL_M: Final = 10.0


@final
class LastRead:
    """Of each variable the last that was read; of what was not read as yet, its first guess.

    Attributes:
        places: of landmarks, to be found by where they are.
        is_current: whether all is as of the last update.
    """

    def __init__(self, map_T_start: Pose2) -> None:
        self.places = PointGrid(_CELL_M)
        self.is_current = False
        self._poses, self._landmarks = Growing((3,)), dict[int, FloatArray]()
        self._are_current = set[int]()
        self.add_pose(map_T_start)

    def add_pose(self, guess: Pose2) -> None:
        """One more."""
        self._poses.append(guess.as_array())

    def put(self, landmark: int, place: FloatArray) -> None:
        """A landmark is there (2,)."""
        self._landmarks[landmark] = place
        self.places.put(landmark, place)

    def forget(self, landmark: int) -> None:
        """It is no more."""
        del self._landmarks[landmark]
        self._are_current.discard(landmark)
        self.places.remove(landmark)

    def pose(self, index: int) -> Pose2:
        """map_T_base."""
        return Pose2.from_array(self._poses.rows[index])

    def poses(self, indices: IntArray | list[int]) -> FloatArray:
        """(n, 3) of some."""
        found: FloatArray = self._poses.rows[indices]
        return found

    def last_position(self) -> FloatArray:
        """(2,) m of the newest pose."""
        here: FloatArray = self._poses.rows[-1, :2].copy()
        return here

    def landmarks(self) -> tuple[int, ...]:
        """All, in the order they came."""
        return tuple(self._landmarks)

    def landmark(self, landmark: int) -> FloatArray:
        """map_t_landmark (2,)."""
        return self._landmarks[landmark]

    def read_landmark(self, landmark: int, isam: Incremental) -> FloatArray:
        """The same as of the last update, if it is in this iSAM2."""
        if landmark not in self._are_current and isam.has_landmark(landmark):
            self.put(landmark, isam.landmark(landmark))
            self._are_current.add(landmark)
        return self._landmarks[landmark]

    def estimate(self) -> GraphEstimate:
        """All."""
        return GraphEstimate(self._poses.rows.copy(), dict(self._landmarks))

    def move_on(self, last: Pose2) -> float:
        """After an update, with where the newest pose is now.

        Returns:
            how many metres that moved.
        """
        self.is_current = False
        self._are_current.clear()
        before = self.last_position()
        self._poses.rows[-1] = last.as_array()
        return float(np.hypot(*(self.last_position() - before)))

    def start_from(self, estimate: GraphEstimate) -> None:
        """Everything that there still is is here."""
        self._poses.rows[: len(estimate.map_T_bases)] = estimate.map_T_bases
        self._are_current.clear()
        self._put_known(estimate.map_t_landmarks)
        self.is_current = True

    def take(self, values: Values, windows: Windows, numbers: list[int]) -> None:
        """Everything that is solved is there, and what lies in these windows follows."""
        self._are_current.clear()
        self._poses.rows[values.poses] = values.map_T_bases
        self._put_known(values.map_t_landmarks)
        for number in numbers:
            window = windows[number]
            followed = follow(self._poses.rows[window.first], window.condensed)
            self._poses.rows[window.first + 1 : window.last] = followed

    def _put_known(self, places: Mapping[int, FloatArray]) -> None:
        """Of these landmarks those that there still are."""
        for landmark, place in places.items():
            if landmark in self._landmarks:
                self.put(landmark, place)
