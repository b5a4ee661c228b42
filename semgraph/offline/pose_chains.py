"""Poses that nothing was sighted from, composed away and found again."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.offline.batch import Batch


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """What leads to the pose of scan `end`.

    `motion` is start_T_end from the pose of scan `start`; where that is None, map_T_end by the
    start of the session.
    """

    session: int
    start: int | None
    end: int
    motion: UncertainPose2


def links(batch: Batch, kept: BoolArray) -> list[Link]:
    """What joins the kept scans (n,), mean and covariance of the motions between composed.

    To first order that is what marginalizing the poses between gives; those behind the last kept
    scan of a session have no say.
    """
    made = []
    for session, prior in enumerate(batch.starts):
        start, motion = None, prior
        for scan in _range(batch, session):
            motion = motion @ batch.motion(scan)
            if kept[scan]:
                made.append(Link(session, start, scan, motion))
                start, motion = scan, UncertainPose2(Pose2(), np.zeros((3, 3)))
    return made


def fill(batch: Batch, made: Sequence[Link], map_T_bases: FloatArray) -> FloatArray:
    """(n, 3): the poses (n, 3) of the kept scans, between them what is most probable.

    What the kept poses contradict the motions by is shared out by the motions' covariances; behind
    the last kept scan the motions carry on.
    """
    poses = np.array(map_T_bases)
    last = [-1] * len(batch.starts)
    for link in made:
        _share_out(batch, link, poses)
        last[link.session] = link.end
    for session, kept in enumerate(last):
        scans = _range(batch, session)
        pose = Pose2.from_array(poses[kept]) if kept >= 0 else batch.starts[session].pose
        for scan in range(max(kept + 1, scans.start), scans.stop):
            pose = pose @ batch.motion(scan).pose
            poses[scan] = pose.as_array()
    return poses


def _share_out(batch: Batch, link: Link, poses: FloatArray) -> None:
    """Source: the mean of a Gaussian given its end, cov(a, b) cov(b)^-1 (b - mean)."""
    first = batch.firsts[link.session] if link.start is None else link.start + 1
    if first == link.end:
        return
    if link.start is None:
        at = batch.starts[link.session]
        map_T_end = link.motion.pose
    else:
        at = UncertainPose2(Pose2.from_array(poses[link.start]), np.zeros((3, 3)))
        map_T_end = at.pose @ link.motion.pose
    error = map_T_end.between(Pose2.from_array(poses[link.end])).as_array()
    weighed = np.linalg.solve(link.motion.covariance, error)
    for scan in range(first, link.end):
        at = at @ batch.motion(scan)
        end_Ad_here = map_T_end.between(at.pose).adjoint()
        correction = Pose2.from_array(at.covariance @ end_Ad_here.T @ weighed)
        poses[scan] = (at.pose @ correction).as_array()


def _range(batch: Batch, session: int) -> range:
    scans = batch.session(session)
    return range(scans.start, scans.stop)
