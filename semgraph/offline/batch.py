"""What one or more runs measured, numbered through, and what is believed of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.files.run_log import RunLog
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Perceptions, concatenate
from semgraph.measurement_model import misfits2
from sensors.views import View


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Scans and perceptions of all sessions, one session after the other.

    Attributes:
        firsts: the first scan of each session.
        starts: map_T_start of each session, all in one map.
        stamps_ns: (n,) of each scan.
        motions: (n, 3) last_T_current; those of the first scans lead from the starts.
        motion_covariances: (n, 3, 3), each in the frame at its end.
        seen: (m) perceptions of all scans.
        scans: (m,) of each perception, in order.
        covariances: (m, 2, 2) of (range, bearing); unreliable perceptions weigh less.
        views: how far lasers saw, with the scan.
    """

    firsts: tuple[int, ...]
    starts: tuple[UncertainPose2, ...]
    stamps_ns: IntArray
    motions: FloatArray
    motion_covariances: FloatArray
    seen: Perceptions
    scans: IntArray
    covariances: FloatArray
    views: tuple[tuple[int, View], ...]

    @classmethod
    def of(cls, log: RunLog) -> Self:
        """What one run measured."""
        reliabilities = np.maximum(log.seen.reliabilities, 0.05)
        return cls(
            (0,),
            (log.start,),
            log.trajectory.stamps_ns,
            log.motions,
            log.motion_covariances,
            log.seen,
            log.scans,
            log.seen.covariances / reliabilities[:, None, None],
            log.views,
        )

    def joined(self, other: "Batch", start: UncertainPose2) -> "Batch":
        """Both, the other's one session beginning at `start` in this one's map."""
        n = len(self)
        pairs = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("stamps_ns", "motions", "motion_covariances", "covariances")
        }
        return Batch(
            firsts=(*self.firsts, n),
            starts=(*self.starts, start),
            seen=concatenate(0, [self.seen, other.seen]),
            scans=np.concatenate([self.scans, other.scans + n]),
            views=(*self.views, *((scan + n, view) for scan, view in other.views)),
            **pairs,
        )

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def motion(self, scan: int) -> UncertainPose2:
        """last_T_current of one scan."""
        return UncertainPose2(Pose2.from_array(self.motions[scan]), self.motion_covariances[scan])

    def session(self, number: int) -> slice:
        """The scans of one session."""
        ends = (*self.firsts[1:], len(self))
        return slice(self.firsts[number], ends[number])

    def map_t_seen(self, map_T_bases: FloatArray) -> FloatArray:
        """(m, 2) where each perception is, seen from poses (n, 3)."""
        poses = map_T_bases[self.scans]
        bearings = poses[:, 2] + self.seen.bearings
        unit = np.column_stack([np.cos(bearings), np.sin(bearings)])
        return np.asarray(poses[:, :2] + self.seen.ranges_m[:, None] * unit)

    def distances2(
        self, rows: IntArray, map_T_bases: FloatArray, map_t_landmarks: FloatArray
    ) -> FloatArray:
        """(k,) squared Mahalanobis distances of perceptions `rows` (k,) from landmarks (k, 2)."""
        polar = np.column_stack([self.seen.ranges_m[rows], self.seen.bearings[rows]])
        poses = map_T_bases[self.scans[rows]]
        return misfits2(poses, map_t_landmarks, polar, self.covariances[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Where a landmark was before: (2,) m in map, with its covariance (2, 2)."""

    landmark: int
    map_t_landmark: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Where everything is, and which perception is of which landmark.

    Attributes:
        map_T_bases: (n, 3) of each scan.
        landmarks: (m,) of each perception, -1 for none.
        map_t_landmarks: (2,) by landmark; of each that has a perception.
        priors: of landmarks, at most one each.
    """

    map_T_bases: FloatArray
    landmarks: IntArray
    map_t_landmarks: Mapping[int, FloatArray]
    priors: tuple[Prior, ...] = ()

    def places(self, landmarks: IntArray) -> FloatArray:
        """(k, 2) of landmarks (k,)."""
        ids, rows = np.unique(landmarks, return_inverse=True)
        places = np.array([self.map_t_landmarks[k] for k in ids.tolist()]).reshape(-1, 2)
        return np.asarray(places[rows])

    def assigned(self) -> BoolArray:
        """(m,) which perceptions are of a landmark."""
        return self.landmarks >= 0

    def fit(self, batch: Batch) -> FloatArray:
        """(m,) squared Mahalanobis distance of each perception from its landmark; NaN without."""
        rows = np.flatnonzero(self.assigned())
        distances2 = np.full(len(self.landmarks), np.nan)
        places = self.places(self.landmarks[rows])
        distances2[rows] = batch.distances2(rows, self.map_T_bases, places)
        return distances2

    def taken_for(self, landmarks: IntArray) -> "Belief":
        """The same, with perceptions taken for other landmarks that are known."""
        left = np.unique(landmarks[landmarks >= 0]).tolist()
        known = {landmark: self.map_t_landmarks[landmark] for landmark in left}
        priors = tuple(prior for prior in self.priors if prior.landmark in known)
        return replace(self, landmarks=landmarks, map_t_landmarks=known, priors=priors)
