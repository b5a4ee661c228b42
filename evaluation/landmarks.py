"""How well a map stands on the true landmarks: position, missed, false and counted twice."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.alignment import rigid_alignment
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import Pose2
from semgraph.landmarks import Landmark
from sensors.truth import TrueLandmarks, Truth

MAX_GATE_M = 1.0
MIN_GATE_M = 0.3
MIN_TRUE_SIGHTINGS = 3
_MAX_ROUNDS = 20
_CERTAINLY_ONE_M = 0.3
_CHI_SQUARE_99_2DOF = -2.0 * np.log(0.01)


@dataclass(frozen=True, slots=True, eq=False)
class MapErrors:
    """A map beside the true landmarks.

    Attributes:
        gate_m: farther apart, a landmark and a true one are never the same.
        world_T_map: the map's own rigid alignment to its matched true landmarks.
        map_rows, true_rows: (k,) which landmark is which true one.
        errors: (k, 2) m, map minus truth in world, after the map's own alignment.
        path_errors: (k, 2) m, the same after the alignment that came in (the path's).
        diameter_errors_m: (j,) of the matched ones where both diameters are known.
        missed: rows of true landmarks without one in the map, of those that had to be found.
        false: rows of the map that are near no true landmark.
        duplicates: rows of the map near a true landmark that another one matches better.
    """

    gate_m: float
    world_T_map: Pose2
    map_rows: IntArray
    true_rows: IntArray
    errors: FloatArray
    path_errors: FloatArray
    diameter_errors_m: FloatArray
    missed: IntArray
    false: IntArray
    duplicates: IntArray


def compare_map(
    landmarks: Sequence[Landmark], truth: Truth, world_T_map: Pose2 | None
) -> MapErrors | None:
    """The map beside the truth, or None where there are no true landmarks.

    Landmarks and true ones of one kind pair one to one within a gate: half the median distance
    of a true landmark to its nearest neighbour, from 0.3 to 1 m. As many pairs as possible come
    first, then the least sum of squares. The alignment that comes in (None: the map's frame is the
    world's) starts it; the map's own alignment to its pairs follows, and both are repeated until
    the pairs stay. Had to be found: true landmarks with at least 3 true sightings, or all of them
    where the sightings are not known.
    """
    true = truth.landmarks
    if true is None:
        return None
    start = world_T_map or Pose2()
    positions, kinds, diameters_m = _columns(landmarks)
    gate_m = _gate_m(true.world_t_landmarks)
    aligned, pairs = start, np.empty((0, 2), dtype=np.int64)
    for _ in range(_MAX_ROUNDS):
        fresh = match(aligned.transform(positions), kinds, true, gate_m)
        if len(fresh) < len(pairs) or np.array_equal(fresh, pairs):
            break
        pairs = fresh
        if len(pairs) >= 2:
            aligned = rigid_alignment(true.world_t_landmarks[pairs[:, 1]], positions[pairs[:, 0]])
    map_rows, true_rows = pairs.T
    errors, path_errors = (
        alignment.transform(positions[map_rows]) - true.world_t_landmarks[true_rows]
        for alignment in (aligned, start)
    )
    diameter_errors_m = diameters_m[map_rows] - true.diameters_m[true_rows]
    unmatched = np.setdiff1d(np.arange(len(landmarks)), map_rows)
    near = _near_any(aligned.transform(positions[unmatched]), kinds[unmatched], true, gate_m)
    return MapErrors(
        gate_m=gate_m,
        world_T_map=aligned,
        map_rows=map_rows,
        true_rows=true_rows,
        errors=errors,
        path_errors=path_errors,
        diameter_errors_m=diameter_errors_m[np.isfinite(diameter_errors_m)],
        missed=np.setdiff1d(np.flatnonzero(_had_to_be_found(truth, true)), true_rows),
        false=unmatched[~near],
        duplicates=unmatched[near],
    )


def match(
    world_t_landmarks: FloatArray, kinds: IntArray, true: TrueLandmarks, gate_m: float
) -> IntArray:
    """Pairs (k, 2) of rows, one to one: as many as possible, then the least sum of squares.

    The pairs that the gate allows fall apart into small groups; each is solved by itself.
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    candidates = _candidates(world_t_landmarks, kinds, true, gate_m)
    n, m = len(world_t_landmarks), len(true.kinds)
    links = coo_matrix(
        (np.ones(len(candidates)), (candidates[:, 0], n + candidates[:, 1])), shape=(n + m, n + m)
    )
    num_groups, groups = connected_components(links, directed=False)
    order = np.argsort(groups[candidates[:, 0]], kind="stable")
    splits = np.searchsorted(groups[candidates[order, 0]], np.arange(1, num_groups))
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for rows in np.split(order, splits):
        of_map, a = np.unique(candidates[rows, 0], return_inverse=True)
        of_truth, b = np.unique(candidates[rows, 1], return_inverse=True)
        gains = np.zeros((len(of_map), len(of_truth)))
        offsets = world_t_landmarks[of_map[a]] - true.world_t_landmarks[of_truth[b]]
        worst = gate_m**2 * (1 + min(gains.shape, default=0))
        gains[a, b] = worst - np.sum(offsets**2, axis=1)
        i, j = linear_sum_assignment(gains, maximize=True)
        allowed = gains[i, j] > 0.0
        pairs.append(np.column_stack([of_map[i[allowed]], of_truth[j[allowed]]]))
    found = np.concatenate(pairs)
    in_order: IntArray = found[np.argsort(found[:, 0])]
    return in_order


def suspected_duplicates(landmarks: Sequence[Landmark]) -> IntArray:
    """Pairs (k, 2) of rows of a map that may be one landmark; needs no truth.

    Of one kind, not of two identities, and nearer than 0.3 m; or nearer than 1 m if the 99 % gate
    of the difference of the positions (as if independent) and of the diameters (3 sigma) takes
    them for one.
    """
    from scipy.spatial import cKDTree

    positions, kinds, _ = _columns(landmarks)
    if len(landmarks) < 2:
        return np.empty((0, 2), dtype=np.int64)
    pairs = cKDTree(positions).query_pairs(MAX_GATE_M, output_type="ndarray").astype(np.int64)
    pairs = pairs[kinds[pairs[:, 0]] == kinds[pairs[:, 1]]]
    suspected = [_may_be_one(landmarks[i], landmarks[j]) for i, j in pairs]
    may_be_one: IntArray = pairs[np.array(suspected, dtype=np.bool_)]
    return may_be_one


def _may_be_one(first: Landmark, second: Landmark) -> bool:
    identities = {first.semantics.identity, second.semantics.identity} - {""}
    if len(identities) > 1:
        return False
    offset = first.map_t_landmark - second.map_t_landmark
    if float(np.linalg.norm(offset)) < _CERTAINLY_ONE_M:
        return True
    a, b = first.semantics.diameter, second.semantics.diameter
    if a and b and abs(a.mean_m - b.mean_m) > 3.0 * np.hypot(a.sigma_m, b.sigma_m):
        return False
    d2 = offset @ np.linalg.pinv(first.covariance + second.covariance) @ offset
    return bool(d2 <= _CHI_SQUARE_99_2DOF)


def _columns(landmarks: Sequence[Landmark]) -> tuple[FloatArray, IntArray, FloatArray]:
    positions = np.array([landmark.map_t_landmark for landmark in landmarks]).reshape(-1, 2)
    kinds = np.array([landmark.semantics.kind for landmark in landmarks], dtype=np.int64)
    diameters = [landmark.semantics.diameter for landmark in landmarks]
    diameters_m = np.array([d.mean_m if d else np.nan for d in diameters], dtype=np.float64)
    return positions, kinds, diameters_m


def _gate_m(world_t_landmarks: FloatArray) -> float:
    from scipy.spatial import cKDTree

    if len(world_t_landmarks) < 2:
        return MAX_GATE_M
    nearest, _ = cKDTree(world_t_landmarks).query(world_t_landmarks, k=2)
    spacing_m = float(np.median(nearest[:, 1]))
    return float(np.clip(0.5 * spacing_m, MIN_GATE_M, MAX_GATE_M))


def _candidates(
    world_t_landmarks: FloatArray, kinds: IntArray, true: TrueLandmarks, gate_m: float
) -> IntArray:
    from scipy.spatial import cKDTree

    if len(world_t_landmarks) == 0 or len(true.kinds) == 0:
        return np.empty((0, 2), dtype=np.int64)
    near = cKDTree(world_t_landmarks).query_ball_tree(cKDTree(true.world_t_landmarks), gate_m)
    pairs = np.array([(i, j) for i, row in enumerate(near) for j in row], dtype=np.int64)
    pairs = pairs.reshape(-1, 2)
    same_kind: IntArray = pairs[kinds[pairs[:, 0]] == true.kinds[pairs[:, 1]]]
    return same_kind


def _near_any(
    world_t_landmarks: FloatArray, kinds: IntArray, true: TrueLandmarks, gate_m: float
) -> BoolArray:
    near = np.zeros(len(world_t_landmarks), dtype=np.bool_)
    near[_candidates(world_t_landmarks, kinds, true, gate_m)[:, 0]] = True
    return near


def _had_to_be_found(truth: Truth, true: TrueLandmarks) -> BoolArray:
    if truth.associations is None:
        return np.ones(len(true.kinds), dtype=np.bool_)
    sighted = np.concatenate([np.empty(0, dtype=np.int64), *truth.associations.values()])
    counts = np.bincount(sighted[sighted >= 0], minlength=len(true.kinds))
    had_to: BoolArray = counts >= MIN_TRUE_SIGHTINGS
    return had_to
