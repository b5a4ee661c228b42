"""How far a trajectory lies from the true path: absolute and relative errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.alignment import (
    Alignment,
    reference_outliers,
    rigid_alignment,
    robust_alignment,
)
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2, relative_poses, transform_points, wrap_angle
from sensors.truth import TruePath

MAX_GAP_NS = 2_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class PathErrors:
    """An estimate beside the truth, at those of the truth's times where both are known.

    Attributes:
        rows: (n,) rows of the true path that are compared.
        num_left_out: how many of its rows are not, for want of an estimate within 2 s.
        world_T_map: the alignment.
        world_T_bases: (n, 3) the estimate, interpolated and aligned.
        errors: (n, 2) m, estimate minus truth of the reference point, in world.
        heading_errors: (n,) rad, estimate minus truth, or None where the truth has no headings.
        is_outlier: (n,) fixes that jump, by `alignment.reference_outliers`; none if the truth
            says that it has no outliers.
    """

    rows: IntArray
    num_left_out: int
    world_T_map: Pose2
    world_T_bases: FloatArray
    errors: FloatArray
    heading_errors: FloatArray | None
    is_outlier: BoolArray

    @property
    def distances(self) -> FloatArray:
        """(n,) m, the lengths of the errors."""
        lengths: FloatArray = np.linalg.norm(self.errors, axis=1)
        return lengths


@dataclass(frozen=True, slots=True)
class RelativeErrors:
    """RMS errors of the motion over segments of one length."""

    length_m: float
    num_segments: int
    translation_rmse_m: float
    heading_rmse: float


def compare_path(
    estimate: Trajectory, truth: TruePath, alignment: Alignment = Alignment.RIGID
) -> PathErrors | None:
    """The estimate beside the truth, or None where fewer than two times can be compared.

    The rigid alignment is the robust one if the truth has outliers. The first pose is laid onto
    the first only in position where the truth has no headings.
    """
    rows = comparable_rows(estimate, truth.stamps_ns)
    if len(rows) < 2:
        return None
    map_T_bases = estimate.interpolate(truth.stamps_ns[rows])
    world_T_map = _align(map_T_bases, truth, rows, alignment)
    world_T_bases = compose(world_T_map, map_T_bases)
    errors = transform_points(world_T_bases, truth.base_t_reference) - truth.world_t_reference[rows]
    heading_errors = (
        None if truth.headings is None else wrap_angle(world_T_bases[:, 2] - truth.headings[rows])
    )
    return PathErrors(
        rows=rows,
        num_left_out=len(truth.stamps_ns) - len(rows),
        world_T_map=world_T_map,
        world_T_bases=world_T_bases,
        errors=errors,
        heading_errors=heading_errors,
        is_outlier=_outliers(map_T_bases, truth, rows),
    )


def comparable_rows(estimate: Trajectory, stamps_ns: IntArray) -> IntArray:
    """Rows of times (n,) that lie between two estimates no more than 2 s apart, or upon one."""
    if len(estimate) == 0:
        return np.empty(0, dtype=np.int64)
    after = np.searchsorted(estimate.stamps_ns, stamps_ns, side="left")
    before = np.searchsorted(estimate.stamps_ns, stamps_ns, side="right") - 1
    inside = (before >= 0) & (after < len(estimate))
    rows = np.flatnonzero(inside)
    gaps_ns = estimate.stamps_ns[after[rows]] - estimate.stamps_ns[before[rows]]
    return rows[gaps_ns <= MAX_GAP_NS]


def compose(world_T_map: Pose2, map_T_bases: FloatArray) -> FloatArray:
    """world_T_bases (n, 3) of map_T_bases (n, 3)."""
    world_t_bases = world_T_map.transform(map_T_bases[:, :2])
    return np.column_stack([world_t_bases, wrap_angle(map_T_bases[:, 2] + world_T_map.theta)])


def true_poses(truth: TruePath) -> FloatArray | None:
    """world_T_bases (n, 3) of the truth, or None where it has no headings."""
    if truth.headings is None:
        return None
    at_reference = np.column_stack([truth.world_t_reference, truth.headings])
    return np.column_stack(
        [transform_points(at_reference, -truth.base_t_reference), truth.headings]
    )


def rmse(values: FloatArray) -> float:
    """The root of the mean square of values (n,), or of vectors' lengths (n, d)."""
    return float(np.sqrt(np.sum(np.square(values)) / len(values)))


def relative_errors(
    estimate: Trajectory, truth: TruePath, lengths_m: Sequence[float]
) -> tuple[RelativeErrors, ...]:
    """RMS errors of the relative pose over true path lengths; lengths never driven are left out.

    A segment begins at every compared time and ends at the first one at least the length further
    along the true path. Without true headings there is no relative pose, and nothing is returned.

    Source: Geiger et al. 2012 (KITTI), in metres and radians instead of per metre.
    """
    both = _both(estimate, truth)
    if both is None:
        return ()
    true_T_bases, map_T_bases = both
    steps = np.linalg.norm(np.diff(true_T_bases[:, :2], axis=0), axis=1)
    along_m = np.concatenate([[0.0], np.cumsum(steps)])
    found = []
    for length_m in lengths_m:
        ends = np.searchsorted(along_m, along_m + length_m)
        starts = np.flatnonzero(ends < len(along_m))
        if len(starts):
            error = _motion_errors(true_T_bases, map_T_bases, starts, ends[starts])
            found.append(
                RelativeErrors(length_m, len(starts), rmse(error[:, :2]), rmse(error[:, 2]))
            )
    return tuple(found)


def frame_errors(estimate: Trajectory, truth: TruePath, frames: int = 1) -> RelativeErrors | None:
    """RMS errors of the motion over so many compared times; None where there is none.

    From each compared time that is a multiple of `frames`, as evo's relative pose error in frames.
    The length is the mean one of these segments.

    Source: Sturm et al. 2012, eq. 2.
    """
    both = _both(estimate, truth)
    if both is None or len(both[0]) <= frames:
        return None
    true_T_bases, map_T_bases = both
    starts = np.arange(0, len(true_T_bases) - frames, frames)
    error = _motion_errors(true_T_bases, map_T_bases, starts, starts + frames)
    moved = true_T_bases[starts + frames, :2] - true_T_bases[starts, :2]
    length_m = float(np.linalg.norm(moved, axis=1).mean())
    return RelativeErrors(length_m, len(starts), rmse(error[:, :2]), rmse(error[:, 2]))


def _both(estimate: Trajectory, truth: TruePath) -> tuple[FloatArray, FloatArray] | None:
    """True and estimated poses (n, 3) at the compared times; None without headings or below two."""
    world_T_bases = true_poses(truth)
    rows = comparable_rows(estimate, truth.stamps_ns)
    if world_T_bases is None or len(rows) < 2:
        return None
    return world_T_bases[rows], estimate.interpolate(truth.stamps_ns[rows])


def _motion_errors(
    true_T_bases: FloatArray, map_T_bases: FloatArray, starts: IntArray, ends: IntArray
) -> FloatArray:
    """(k, 3) of the motions from each start to its end, in the frame of the true end."""
    return relative_poses(
        relative_poses(true_T_bases[starts], true_T_bases[ends]),
        relative_poses(map_T_bases[starts], map_T_bases[ends]),
    )


def trajectory_difference(first: Trajectory, second: Trajectory) -> float:
    """RMSE in m between the positions of two trajectories at their common times, aligned rigidly.

    Raises:
        InputError: fewer than two common times.
    """
    _, rows, other_rows = np.intersect1d(first.stamps_ns, second.stamps_ns, return_indices=True)
    if len(rows) < 2:
        raise InputError(f"trajectories: expected two or more common times, got {len(rows)}")
    a, b = first.map_T_bases[rows, :2], second.map_T_bases[other_rows, :2]
    return rmse(a - rigid_alignment(a, b).transform(b))


def _align(map_T_bases: FloatArray, truth: TruePath, rows: IntArray, alignment: Alignment) -> Pose2:
    map_t_references = transform_points(map_T_bases, truth.base_t_reference)
    world_t_references = truth.world_t_reference[rows]
    match alignment:
        case Alignment.NONE:
            return Pose2()
        case Alignment.RIGID if truth.has_outliers:
            return robust_alignment(world_t_references, map_t_references)
        case Alignment.RIGID:
            return rigid_alignment(world_t_references, map_t_references)
        case Alignment.ORIGIN:
            world_T_bases = true_poses(truth)
            if world_T_bases is None:
                x, y = world_t_references[0] - map_t_references[0]
                return Pose2(float(x), float(y))
            first = Pose2.from_array(world_T_bases[rows[0]])
            return first @ Pose2.from_array(map_T_bases[0]).inverse()


def _outliers(map_T_bases: FloatArray, truth: TruePath, rows: IntArray) -> BoolArray:
    if not truth.has_outliers:
        return np.zeros(len(rows), dtype=np.bool_)
    world_t_references = truth.world_t_reference[rows]
    map_t_references = transform_points(map_T_bases, truth.base_t_reference)
    world_T_map = robust_alignment(world_t_references, map_t_references)
    return reference_outliers(world_t_references, world_T_map.transform(map_t_references))
