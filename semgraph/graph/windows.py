"""Which poses of a graph are condensed: windows of them, each one factor."""

from array import array
from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.graph.condensation import Condensed, Stretch, condense
from semgraph.graph.graph_log import GraphLog

NONE: Final = -1
# At most so many poses must have followed before a window is condensed.
_FOLLOWING: Final = 20
# A motion less sure than this is in no window: what lies behind it is in no Gaussian's reach.
_SURE_M: Final = 0.5
_SURE_RAD: Final = 0.1


@dataclass(slots=True, eq=False)
class Window:
    """The poses from `first` to `last`, of which only these two are left in the graph.

    Attributes:
        tracks: (n,) of the things sighted.
        landmarks: (n,) that each is of now.
        condensed: all that the motions and sightings say.
    """

    first: int
    last: int
    tracks: IntArray
    landmarks: IntArray
    condensed: Condensed


@final
class Windows:
    """All windows of a graph, by number.

    Args:
        log: of the graph.
        length: motions in a window; 0 for no windows.

    Attributes:
        end: the pose that the next window begins with, at the earliest.
        glimpsed: landmarks that are in no window, though a scan of one showed them: that one only,
            so they hold nothing. Where perceptions are false that is most of all.
    """

    def __init__(self, log: GraphLog, length: int) -> None:
        self._log, self._length = log, length
        self.clear()

    def clear(self, end: int = 0) -> None:
        """There are none, nor will there be before the pose `end`."""
        self._windows: list[Window] = []
        self._of_motion = array("i")
        self._by_landmark: dict[int, list[int]] = {}
        self.end = end
        self.changed: set[int] = set()
        self.glimpsed: set[int] = set()

    def __len__(self) -> int:
        return len(self._windows)

    def __iter__(self) -> Iterator[Window]:
        return iter(self._windows)

    def __getitem__(self, number: int) -> Window:
        return self._windows[number]

    def of_motion(self, pose: int) -> int:
        """The window that the motion to a pose is in, and what was sighted from there; or NONE."""
        return self._of_motion[pose] if pose < len(self._of_motion) else NONE

    def of_motions(self, poses: IntArray) -> IntArray:
        """(k,) the same of many."""
        known = np.asarray(self._of_motion)
        numbers = np.full(len(poses), NONE)
        is_known = poses < len(known)
        numbers[is_known] = known[poses[is_known]]
        return numbers

    def of_pose(self, pose: int) -> int:
        """The window that a pose was given up in; NONE if it is in the graph."""
        window = self.of_motion(pose)
        return window if window == self.of_motion(pose + 1) else NONE

    def next(self, last_updated: int) -> tuple[int, int] | None:
        """First and last pose of the next window, if it lies back far enough."""
        if not self._length:
            return None
        following = min(self._length, _FOLLOWING)
        while self.end + self._length + following <= last_updated:
            first, last = self.end, self.end
            while last < first + self._length and self._is_sure(last + 1):
                last += 1
            if last - first >= 2:
                return first, last
            # Too short, or behind a motion that nothing is sure of.
            self.end = max(last, first + 1)
        return None

    def glimpses(self, rows: IntArray) -> BoolArray:
        """(k,) of some sightings those whose landmark no other one shows."""
        counts = (len(self._log.rows(name)) for name in self._log.landmarks[rows].tolist())
        return np.fromiter((count == 1 for count in counts), dtype=bool, count=len(rows))

    def rows(self, number: int) -> IntArray:
        """(k,) sightings that a window is to be condensed of."""
        window = self._windows[number]
        rows = self._log.rows_of_poses(window.first + 1, window.last)
        names = self._log.landmarks[rows].tolist()
        shown: IntArray = rows[[name not in self.glimpsed for name in names]]
        return shown

    def skip(self, last: int) -> None:
        """What could not be condensed stays as it is."""
        self.end = last

    def condensed(
        self, first: int, rows: IntArray, map_T_bases: FloatArray, places: dict[int, FloatArray]
    ) -> tuple[IntArray, Condensed]:
        """(n, 2) landmark and track of each thing, and what a stretch says of it.

        Args:
            first: pose of the stretch.
            rows: (s,) its sightings in the log.
            map_T_bases: (m + 1, 3) its poses.
            places: (2,) of each landmark sighted.

        Raises:
            GraphError: it says nothing of some of it.
        """
        log, motions = self._log, slice(first + 1, first + len(map_T_bases))
        names, things = np.unique(
            np.column_stack([log.landmarks[rows], log.tracks[rows]]), axis=0, return_inverse=True
        )
        stretch = Stretch(
            map_T_bases,
            log.motions[motions],
            log.motion_covariances(motions),
            log.poses[rows] - first,
            things.ravel(),
            log.polar(rows),
            log.covariances(rows),
            np.array([places[name] for name in names[:, 0].tolist()]).reshape(-1, 2),
        )
        return names, condense(stretch)

    def add(self, window: Window) -> int:
        """Its number."""
        number = len(self._windows)
        self._windows.append(window)
        self._of_motion.extend([NONE] * (window.last + 1 - len(self._of_motion)))
        for pose in range(window.first + 1, window.last + 1):
            self._of_motion[pose] = number
        for landmark in window.landmarks.tolist():
            self._note(landmark, number)
        self.end = window.last
        self.changed.add(number)
        return number

    def of(self, landmark: int) -> list[int]:
        """Those that sighted a landmark."""
        return sorted(self._by_landmark.get(landmark, ()))

    def of_any(self, landmarks: Iterable[int]) -> set[int]:
        """Those that sighted one of these landmarks."""
        return set().union(*(self._by_landmark.get(landmark, ()) for landmark in landmarks))

    def beside(self, numbers: Set[int]) -> set[int]:
        """Those before and after these, and those that sighted what one of these did."""
        seen = {each for number in numbers for each in self._windows[number].landmarks.tolist()}
        in_time = {near for number in numbers for near in (number - 1, number + 1)}
        return self.of_any(seen) | in_time.intersection(range(len(self._windows)))

    def hand_over(self, landmark: int, new: int, tracks: Set[int] | None = None) -> None:
        """A landmark, or what these tracks sighted of it, is another one."""
        for number in self.of(landmark):
            window = self._windows[number]
            leaving = window.landmarks == landmark
            if tracks is not None:
                leaving &= np.isin(window.tracks, list(tracks))
            if not leaving.any():
                continue
            window.landmarks = np.where(leaving, new, window.landmarks)
            self._note(new, number)
            if not (window.landmarks == landmark).any():
                self._by_landmark[landmark].remove(number)
            self.changed.add(number)
        if not self._by_landmark.get(landmark, True):
            self.forget(landmark)

    def replace(self, number: int, names: IntArray, condensed: Condensed) -> None:
        """It was condensed anew, without what has been taken out, or with what was left out."""
        window = self._windows[number]
        window.landmarks, window.tracks = names[:, 0], names[:, 1]
        window.condensed = condensed
        for landmark in window.landmarks.tolist():
            self._note(landmark, number)
        self.changed.add(number)

    def forget(self, landmark: int) -> None:
        """It is in no window any more."""
        self._by_landmark.pop(landmark, None)
        self.glimpsed.discard(landmark)

    def _note(self, landmark: int, number: int) -> None:
        """A window sighted it; of most landmarks there are few, and lists are small."""
        numbers = self._by_landmark.setdefault(landmark, [])
        if number not in numbers:
            numbers.append(number)

    def _is_sure(self, pose: int) -> bool:
        """Whether the motion to a pose is."""
        (covariance,) = self._log.motion_covariances(np.array([pose]))
        position2 = float(covariance[0, 0] + covariance[1, 1])
        return bool(position2 < _SURE_M**2 and covariance[2, 2] < _SURE_RAD**2)
