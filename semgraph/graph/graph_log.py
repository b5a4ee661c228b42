"""All that was ever added to a graph, as numbers: what it is built from again when it must be."""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import UncertainPose2
from semgraph.graph.factors import Sighting
from semgraph.graph.growing import Growing

NOWHERE: Final = -1
# What 16 bit hold to half a thousandth.
_LEAST_M: Final = 1e-4
_MOST_M: Final = 6e4
# Of a symmetric (3, 3) what is kept, and where each element is in that.
_TRIANGLE: Final = np.triu_indices(3)
_OF_TRIANGLE: Final = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]


@dataclass(frozen=True, slots=True, eq=False)
class Sighted:
    """Sightings of one landmark, in the order they were handed to it.

    Attributes:
        poses, tracks: (k,) of each.
        polar: (k, 2) range and bearing.
        covariances: (k, 2, 2) of those.
    """

    poses: IntArray
    tracks: IntArray
    polar: FloatArray
    covariances: FloatArray

    def __len__(self) -> int:
        return len(self.poses)

    def some(self, rows: IntArray | BoolArray) -> "Sighted":
        """Those of them."""
        return Sighted(
            self.poses[rows], self.tracks[rows], self.polar[rows], self.covariances[rows]
        )


@final
class GraphLog:
    """Motions and sightings in the order they were added; about 50 bytes a sighting.

    What was perceived is kept in 32 bit: rounding is a ten-millionth of it. Shares and
    diameters are in 16: rounding is half a thousandth, of which no detector is sure.

    Attributes:
        start: where pose 0 is.
        motions: (n, 3), row k leads to pose k, row 0 to none.
        poses, tracks: (m,) of each sighting.
        landmarks: (m,) that each is of now; -1 where that was taken out.
        common_shares: (m,) of the ranges' variances.
    """

    def __init__(self, start: UncertainPose2) -> None:
        self.start = start
        self._motions, self._motion_triangles = Growing((3,)), Growing((6,))
        self._poses, self._tracks, self._landmarks = (Growing((), np.int32) for _ in range(3))
        self._polar, self._covariances = (Growing((n,), np.float32) for n in (2, 3))
        self._common_shares = Growing((), np.float16)
        self._diameters = Growing((2,), np.float16)
        self._rows: dict[int, array[int]] = {}
        # How many sightings there were when a pose came: its own are later ones.
        self._num_before = array("i", [0])
        self._motions.append(np.zeros(3))
        self._motion_triangles.append(np.zeros(6))

    @property
    def num_poses(self) -> int:
        """The start included."""
        return len(self._motions)

    @property
    def motions(self) -> FloatArray:
        """(n, 3)."""
        return self._motions.rows

    @property
    def poses(self) -> IntArray:
        """(m,)."""
        return self._poses.rows

    @property
    def tracks(self) -> IntArray:
        """(m,)."""
        return self._tracks.rows

    @property
    def landmarks(self) -> IntArray:
        """(m,)."""
        return self._landmarks.rows

    @property
    def common_shares(self) -> FloatArray:
        """(m,)."""
        return self._common_shares.rows

    def motion_covariances(self, poses: IntArray | Sequence[int] | slice) -> FloatArray:
        """(k, 3, 3) of the motions to some poses."""
        covariances: FloatArray = self._motion_triangles.rows[poses][:, _OF_TRIANGLE]
        return covariances

    def polar(self, rows: IntArray | Sequence[int]) -> FloatArray:
        """(k, 2) range and bearing of some sightings."""
        return self._polar.rows[rows].astype(np.float64)

    def diameters(self, rows: IntArray | Sequence[int]) -> FloatArray:
        """(k, 2) m of some sightings, and their sigmas; NaN for none."""
        return self._diameters.rows[rows].astype(np.float64)

    def covariances(self, rows: IntArray | Sequence[int]) -> FloatArray:
        """(k, 2, 2) of some sightings."""
        return self._covariances.rows[rows][:, [[0, 1], [1, 2]]].astype(np.float64)

    def names(self) -> tuple[int, ...]:
        """The landmarks, in the order they came."""
        return tuple(self._rows)

    def __contains__(self, landmark: int) -> bool:
        return landmark in self._rows

    def __len__(self) -> int:
        return len(self._rows)

    def num_across(self, within: float = np.inf) -> IntArray:
        """(n,) how many landmarks were sighted both before each pose and from there on.

        Args:
            within: so many poses from the one sighting to the next at most.
        """
        rows = np.flatnonzero(self.landmarks != NOWHERE)
        rows = rows[np.lexsort((self.poses[rows], self.landmarks[rows]))]
        names, poses = self.landmarks[rows], self.poses[rows].astype(np.int64)
        is_seen_again = (names[1:] == names[:-1]) & (np.diff(poses) <= within)
        steps = np.zeros(self.num_poses + 1, dtype=np.int64)
        np.add.at(steps, poses[:-1][is_seen_again] + 1, 1)
        np.add.at(steps, poses[1:][is_seen_again] + 1, -1)
        across: IntArray = steps.cumsum()[: self.num_poses]
        return across

    def add_motion(self, motion: UncertainPose2) -> int:
        """The pose that it leads to."""
        self._num_before.append(len(self._poses))
        self._motion_triangles.append(motion.covariance[_TRIANGLE])
        return self._motions.append(motion.pose.as_array())

    def add_landmark(self, landmark: int) -> None:
        """One that nothing was sighted of as yet."""
        self._rows[landmark] = array("i")

    def add_sighting(self, sighting: Sighting) -> int:
        """Its row."""
        (a, b), (_, d) = sighting.covariance.tolist()
        self._poses.append(sighting.pose)
        self._tracks.append(sighting.track)
        self._polar.append((sighting.range_m, sighting.bearing))
        self._covariances.append((a, b, d))
        self._common_shares.append(sighting.common_share)
        self._diameters.append(
            (_in_16_bit(sighting.diameter_m), _in_16_bit(sighting.diameter_sigma_m))
        )
        row = self._landmarks.append(sighting.landmark)
        self._rows[sighting.landmark].append(row)
        return row

    def sighting(self, row: int) -> Sighting:
        """That of a row."""
        range_m, bearing = self._polar.rows[row].tolist()
        a, b, d = self._covariances.rows[row].tolist()
        return Sighting(
            int(self._poses.rows[row]),
            int(self._landmarks.rows[row]),
            range_m,
            bearing,
            np.array([[a, b], [b, d]]),
            int(self._tracks.rows[row]),
            float(self._common_shares.rows[row]),
            *self._diameters.rows[row].tolist(),
        )

    def sighted(self, landmark: int) -> Sighted:
        """All sightings of a landmark."""
        return self.some(self.rows(landmark))

    def some(self, rows: IntArray) -> Sighted:
        """The sightings of some rows (k,)."""
        return Sighted(
            self.poses[rows], self.tracks[rows], self.polar(rows), self.covariances(rows)
        )

    def rows(self, landmark: int) -> IntArray:
        """(k,) of a landmark's sightings, in the order they were handed to it."""
        return np.array(self._rows[landmark], dtype=np.int64)

    def first_row(self, landmark: int) -> int:
        """Of its sightings, the one that was handed to it first."""
        return self._rows[landmark][0]

    def rows_of_poses(self, first: int, last: int) -> IntArray:
        """(k,) of what was sighted from these poses and is not taken out."""
        start = self._num_before[first]
        poses = self.poses[start:]
        rows: IntArray = start + np.flatnonzero((poses >= first) & (poses <= last))
        known: IntArray = rows[self.landmarks[rows] != NOWHERE]
        return known

    def hand_over(self, rows: IntArray, landmark: int) -> None:
        """These are sightings of another landmark now."""
        self.leave_out(rows)
        self.landmarks[rows] = landmark
        self._rows[landmark].extend(rows.tolist())

    def leave_out(self, rows: IntArray) -> None:
        """These are sightings of nothing."""
        leaving = set(rows.tolist())
        for name in np.unique(self.landmarks[rows]).tolist():
            kept = (row for row in self._rows[name] if row not in leaving)
            self._rows[name] = array("i", kept)
        self.landmarks[rows] = NOWHERE

    def forget(self, landmark: int) -> None:
        """It is no more, and what is still a sighting of it is of nothing."""
        self.landmarks[self.rows(landmark)] = NOWHERE
        del self._rows[landmark]


def _in_16_bit(length_m: float) -> float:
    """The nearest length that 16 bit can tell; NaN stays NaN."""
    return min(max(length_m, _LEAST_M), _MOST_M)
