"""Which scans are poses of the graph, and how the scans between them hang on those."""

from array import array
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2, UncertainPose2

# Errors of headings beyond this move what comes after on an arc, not along a line.
_BENT_RAD: Final = 0.1
_NOTHING = UncertainPose2(Pose2(), np.zeros((3, 3)))


@dataclass(slots=True)
class Keyframes:
    """Scans that sight something are poses of the graph; what the others add is motion alone.

    Motions compose, mean and covariance, so that leaving such scans out changes nothing about the
    others (`tests/semgraph/graph/test_keyframes.py`), as long as headings are sure to a tenth of a
    radian: beyond that a scan is a pose, whatever it sights.

    Attributes:
        since_last: last_T_current, from the last pose of the graph to the last scan.
    """

    since_last: UncertainPose2 = _NOTHING
    _poses: "array[int]" = field(default_factory=lambda: array("i"))
    _between: dict[int, UncertainPose2] = field(default_factory=dict)
    _legs: dict[int, UncertainPose2] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def is_bent(self) -> bool:
        """Whether the heading since the last pose is too unsure for motions to compose exactly."""
        return bool(self.since_last.covariance[2, 2] > _BENT_RAD**2)

    def move(self, motion: UncertainPose2) -> None:
        """The robot goes on to the next scan."""
        self.since_last = motion if self.since_last is _NOTHING else self.since_last @ motion

    def add_pose(self, pose: int) -> None:
        """That scan is this pose of the graph, one after the last."""
        if self._poses and self._poses[-1] == pose - 1 and len(self._poses) - 1 in self._between:
            self._legs[pose - 1] = self.since_last
        self._poses.append(pose)
        self.since_last = _NOTHING

    def add_between(self, last_pose: int) -> None:
        """That scan hangs on the last pose of the graph."""
        self._between[len(self._poses)] = self.since_last
        self._poses.append(last_pose)

    def scans_of(self, poses: IntArray) -> IntArray:
        """(n,) the scans that are these poses of the graph (n,), the start being none."""
        scans: IntArray = np.searchsorted(self._poses, poses)
        return scans

    def trajectory(self, map_T_poses: FloatArray) -> FloatArray:
        """(n, 3) map_T_base of all scans, from those of the graph's poses (m, 3).

        A scan between two poses is where the motions before and after it put it together.
        """
        map_T_bases = map_T_poses[self._poses]
        for scan, offset in self._between.items():
            pose = self._poses[scan]
            first = Pose2.from_array(map_T_poses[pose])
            here = first @ offset.pose
            if pose in self._legs:
                last = Pose2.from_array(map_T_poses[pose + 1])
                gain, _ = self._gain(scan)
                composed = first @ self._legs[pose].pose
                correction = gain @ composed.between(last).as_array()
                here = here @ Pose2.from_array(correction)
            map_T_bases[scan] = here.as_array()
        return map_T_bases

    def covariances(self, of_poses: FloatArray, crosses: FloatArray) -> FloatArray:
        """(n, 3, 3) of all scans, each in its own frame.

        Args:
            of_poses: (m, 3, 3) of the graph's poses.
            crosses: (m, 3, 3) row k: of pose k with the one after it.
        """
        covariances = of_poses[self._poses]
        for scan, offset in self._between.items():
            pose = self._poses[scan]
            back = offset.pose.inverse().adjoint()
            if pose not in self._legs:
                covariances[scan] = back @ of_poses[pose] @ back.T + offset.covariance
                continue
            gain, left = self._gain(scan)
            from_first = back - gain @ self._legs[pose].pose.inverse().adjoint()
            mixed = from_first @ crosses[pose] @ gain.T
            covariances[scan] = (
                from_first @ of_poses[pose] @ from_first.T
                + gain @ of_poses[pose + 1] @ gain.T
                + mixed
                + mixed.T
                + left
            )
        return 0.5 * (covariances + covariances.transpose(0, 2, 1))

    def _gain(self, scan: int) -> tuple[FloatArray, FloatArray]:
        """(3, 3) what an error at the leg's end says of the one at the scan, and what is left."""
        offset, leg = self._between[scan], self._legs[self._poses[scan]]
        onward = (offset.pose.inverse() @ leg.pose).inverse().adjoint()
        shared = offset.covariance @ onward.T
        gain = np.linalg.solve(leg.covariance.T, shared.T).T
        return gain, offset.covariance - gain @ shared.T
