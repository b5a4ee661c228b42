"""What of a long run is solved and what rests: cost a scan must not grow with the time driven.

Windows about the robot are awake; all others rest: they stay as they are and are in no solver.
What joins both is held where it is, stiff in itself: of each group of windows that hang together
one pose is held in the map as surely as it was known, and the rest relative to that one. So what is
between moves as it likes, a group may turn and move as far as its drift allows, and groups that
are not joined as yet are as unsure of each other as they are. Source: Strasdat et al. 2011 (double
windows), with covariances of the groups; a closure that moves what is held asks for the whole.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factors import Hold
from semgraph.graph.graph_log import GraphLog
from semgraph.graph.windows import NONE, Windows
from semgraph.point_grid import PointGrid

# So many of the newest windows never rest.
_NEWEST: Final = 2
# In how far things are sighted: so far around all is awake, and is chosen anew after so far.
_AWAKE_RANGES: Final = 3.0
_ANEW_RANGES: Final = 2.0


@dataclass(slots=True, eq=False)
class _Group:
    """Ends of windows, and landmarks, that hang together."""

    poses: set[int]
    landmarks: set[int]

    def touches(self, other: "_Group") -> bool:
        """Whether both have something in common."""
        return not (
            self.poses.isdisjoint(other.poses) and self.landmarks.isdisjoint(other.landmarks)
        )


@final
class Resting:
    """Which windows rest.

    Args:
        log: of the graph.
        windows: of it.

    Attributes:
        awake: numbers of those that do not; None where none rests.
        since: motions in no window, and sightings from where they lead, are awake if they lead to
            a later pose.
        held: landmarks that are awake, and were also sighted from what rests.
        num_choices: how often was chosen.
    """

    def __init__(self, log: GraphLog, windows: Windows) -> None:
        self._log, self._windows = log, windows
        self.num_choices = 0
        self._chosen_at: FloatArray = np.zeros(2)
        self._range_m, self._asked_m = 0.0, 0.0
        self.wake()

    def wake(self) -> None:
        """Nothing rests."""
        self.awake: set[int] | None = None
        self.since = -1
        self.held = set[int]()
        self.num_choices += 1

    def is_left(self, here: FloatArray) -> bool:
        """Whether what is awake is to be chosen anew at a place (2,), or all is."""
        off_m = float(np.hypot(*(here - self._chosen_at)))
        return self.awake is None or off_m > _ANEW_RANGES * self._range_m

    def ask(self, places: FloatArray) -> None:
        """It was asked about what is at places (n, 2), and will be again about what is as far."""
        self._asked_m = max(self._asked_m, float(np.hypot(*(places - self._chosen_at).T).max()))

    def choose(self, here: FloatArray, places: PointGrid, landmarks: Iterable[int] = ()) -> None:
        """The windows are awake that sighted what is around, and the newest.

        Args:
            here: (2,) the robot's place.
            places: of all landmarks.
            landmarks: the windows that sighted one of these are awake too.
        """
        count, self.since = len(self._windows), self._windows.end
        sighted = self.rows()
        if len(sighted):
            self._range_m = float(self._log.polar(sighted)[:, 0].max())
        within_m = max(_AWAKE_RANGES * self._range_m, self._asked_m + self._range_m)
        self._chosen_at, self._asked_m = here, 0.0
        around = {*places.around(here, within_m), *self._log.landmarks[sighted].tolist()}
        newest = range(max(count - _NEWEST, 0), count)
        self.awake = self._windows.of_any(around.union(landmarks)).union(newest)
        self.held = {landmark for landmark in self.landmarks() if not self._is_whole(landmark)}
        self.num_choices += 1

    def numbers(self) -> list[int]:
        """Of the windows that are awake."""
        return list(range(len(self._windows))) if self.awake is None else sorted(self.awake)

    def rows(self) -> IntArray:
        """(k,) sightings from poses after `since`."""
        return self._log.rows_of_poses(self.since + 1, self._log.num_poses - 1)

    def ends(self) -> list[int]:
        """The poses that windows awake begin and end with, and what follows begins with."""
        return sorted(set().union(*(group.poses for group in self._pieces())))

    def rims(self) -> list[int]:
        """Those of them beside which something rests."""
        return [pose for pose in self.ends() if not self._is_inside(pose)]

    def landmarks(self) -> set[int]:
        """All that was sighted from what is awake."""
        return set[int]().union(*(group.landmarks for group in self._pieces()))

    def beside(self) -> tuple[set[int], set[int]]:
        """Poses and landmarks that are awake and hang together with the last pose."""
        group = self._groups()[-1]
        return group.poses, group.landmarks

    def holds(
        self,
        map_T_pose: Callable[[int], Pose2],
        map_t_landmark: Callable[[int], FloatArray],
        covariances: Mapping[int, FloatArray],
    ) -> list[Hold]:
        """What holds each group of windows.

        Args:
            map_T_pose: where a pose is now.
            map_t_landmark: (2,) a landmark.
            covariances: (3, 3) of poses that windows begin and end with, in their own frames.

        Raises:
            GraphError: no pose of a group is one of those.
        """
        holds = []
        map_T_last = map_T_pose(self._log.num_poses - 1)
        for group in self._groups():
            poses = {pose for pose in group.poses if not self._is_inside(pose)}
            anchors = {
                pose: UncertainPose2(map_T_pose(pose), covariances[pose])
                for pose in poses & covariances.keys()
            }
            if 0 in group.poses:
                anchors[0] = self._log.start
            if not anchors:
                raise GraphError("it is not known how sure the graph is of what shall not rest")
            anchor = min(anchors, key=lambda pose: _variance(anchors[pose], map_T_last))
            anchor_T_map = map_T_pose(anchor).inverse()
            holds.append(
                Hold(
                    anchor,
                    anchors[anchor],
                    {pose: anchor_T_map @ map_T_pose(pose) for pose in sorted(poses - {anchor})},
                    {
                        landmark: anchor_T_map.transform(map_t_landmark(landmark)[None])[0]
                        for landmark in sorted(group.landmarks & self.held)
                    },
                )
            )
        return holds

    def _pieces(self) -> Iterator[_Group]:
        """Each window that is awake, and what is in none."""
        for number in self.numbers():
            window = self._windows[number]
            yield _Group({window.first, window.last}, set(window.landmarks.tolist()))
        yield _Group({max(self.since, 0)}, set(self._log.landmarks[self.rows()].tolist()))

    def _groups(self) -> list[_Group]:
        """Those that hang together, together; last what the last pose belongs to."""
        groups: list[_Group] = []
        for piece in self._pieces():
            joined = [group for group in groups if group.touches(piece)]
            for group in joined:
                piece.poses |= group.poses
                piece.landmarks |= group.landmarks
            groups = [group for group in groups if group not in joined] + [piece]
        return groups

    def _is_inside(self, pose: int) -> bool:
        """Whether both motions at a pose are awake."""
        motions = (motion for motion in (pose, pose + 1) if 0 < motion < self._log.num_poses)
        return all(self._is_awake(motion) for motion in motions)

    def _is_awake(self, motion: int) -> bool:
        """Whether the motion to a pose is."""
        if self.awake is None:
            return True
        window = self._windows.of_motion(motion)
        return motion > self.since if window == NONE else window in self.awake

    def _is_whole(self, landmark: int) -> bool:
        """Whether all sightings of a landmark are awake."""
        poses = self._log.poses[self._log.rows(landmark)]
        numbers = self._windows.of_motions(poses[poses <= self.since])
        return self.awake is None or self.awake.issuperset(np.unique(numbers).tolist())


def _variance(held: UncertainPose2, there: Pose2) -> float:
    """m2 of the place of something stiffly joined to a pose, all in one frame."""
    held_T_there = UncertainPose2(held.pose.between(there), np.zeros((3, 3)))
    return float((held @ held_T_there).covariance[:2, :2].trace())
