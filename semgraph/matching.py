"""Corresponding landmarks in the map for what is perceived (section 3.3, step 1)."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from scipy.optimize import linear_sum_assignment

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import Pose2, rotation
from semgraph.landmarks import Kind, Perceptions
from semgraph.measurement_model import diameters_contradict
from semgraph.navigation_map import NavigationMap


class Assignment(Enum):
    """How perceptions and landmarks within the radius are paired."""

    ONE_TO_ONE = "one-to-one"
    NEAREST = "nearest"


class SweepRule(Enum):
    """Which of several proposed rotations is taken."""

    MOST_MATCHES = "most-matches"
    LOWEST_MEAN_DEVIATION = "lowest-mean-deviation"


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """The part of the map around the robot, brought into the proposed frame.

    Attributes:
        ids: (m,) in the map.
        proposed_t_landmarks: (m, 2) m.
        covariances: (m, 2, 2) m2 of those, as the map has them.
        kinds: (m,).
        diameters_m, diameter_sigmas_m: (m,), NaN where unknown.
        identities: (m,) text.
    """

    ids: IntArray
    proposed_t_landmarks: FloatArray
    covariances: FloatArray
    kinds: IntArray
    diameters_m: FloatArray
    diameter_sigmas_m: FloatArray
    identities: list[str]

    def seen_from(self, proposed_T_base: Pose2) -> "LocalMap":
        """The same landmarks in a better frame."""
        positions = proposed_T_base.inverse().transform(self.proposed_t_landmarks)
        base_R_proposed = rotation(-proposed_T_base.theta)
        covariances = base_R_proposed @ self.covariances @ base_R_proposed.T
        return replace(self, proposed_t_landmarks=positions, covariances=covariances)


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Pairs: perception `rows[k]` and local landmark `columns[k]`, `deviations_m[k]` apart."""

    rows: IntArray
    columns: IntArray
    deviations_m: FloatArray

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, kept: BoolArray) -> "Matches":
        """The matches of a mask."""
        return Matches(self.rows[kept], self.columns[kept], self.deviations_m[kept])


def local_map(
    navigation_map: NavigationMap,
    map_T_proposed: Pose2,
    perceptions: Perceptions,
    radius_m: float,
    since_m: float = -np.inf,
) -> LocalMap:
    """The landmarks that these perceptions could be, seen from the proposed frame.

    Those within reach of the perceptions and last sighted at `since_m` driven or later, and those
    of a perceived identity wherever they are.
    """
    reach = float(perceptions.ranges_m.max(initial=0.0)) + radius_m
    ids = navigation_map.near(map_T_proposed.as_array()[:2], reach, since_m)
    named = [
        navigation_map.with_identity(Kind(kind), str(identity))
        for kind, identity in zip(perceptions.kinds, perceptions.identities, strict=True)
        if identity
    ]
    known = [landmark for landmark in named if landmark is not None]
    ids = np.union1d(ids, known).astype(np.int64) if known else np.sort(ids)
    diameters_m, diameter_sigmas_m = navigation_map.diameters(ids)
    proposed_R_map = rotation(-map_T_proposed.theta)
    return LocalMap(
        ids,
        map_T_proposed.inverse().transform(navigation_map.positions(ids)),
        proposed_R_map @ navigation_map.covariances(ids) @ proposed_R_map.T,
        navigation_map.kinds(ids),
        diameters_m,
        diameter_sigmas_m,
        navigation_map.identities(ids),
    )


def match(
    perceptions: Perceptions,
    near: LocalMap,
    rotations: FloatArray,
    radius_m: float,
    assignment: Assignment = Assignment.ONE_TO_ONE,
    rule: SweepRule = SweepRule.MOST_MATCHES,
) -> Matches:
    """The matches under the best of the proposed rotations (k,), the first one tried first.

    Source: paper section 3.3, first step. Differs by default: most matches first and the mean
    deviation second, since the lowest mean deviation favours few matches.
    """
    allowed = compatible(perceptions, near)
    perceived = perceptions.base_t_landmarks()
    best = Matches(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))
    for angle in rotations.tolist():
        offsets = (perceived @ rotation(angle).T)[:, None, :] - near.proposed_t_landmarks[None]
        distances = np.hypot(offsets[..., 0], offsets[..., 1])
        found = _pair(distances, allowed & _in_reach(distances, radius_m, perceptions), assignment)
        if _score(found, rule) < _score(best, rule):
            best = found
        if rule is SweepRule.MOST_MATCHES and _is_beyond_doubt(found, len(perceptions), radius_m):
            break
    return best


def compatible(perceptions: Perceptions, near: LocalMap) -> BoolArray:
    """(n, m) whether a perception may be a landmark by kind, identity and diameter."""
    same_kind = perceptions.kinds[:, None] == near.kinds[None, :]
    contradicts = diameters_contradict(
        perceptions.diameters_m[:, None],
        perceptions.diameter_sigmas_m[:, None],
        near.diameters_m[None, :],
        near.diameter_sigmas_m[None, :],
    )
    allowed: BoolArray = same_kind & ~contradicts
    named = perceptions.identities != ""
    if named.any():
        identities = np.array(near.identities, dtype=np.str_)
        same = perceptions.identities[:, None] == identities[None, :]
        allowed[named] = (same_kind & same)[named]
    return allowed


def _in_reach(distances: FloatArray, radius_m: float, perceptions: Perceptions) -> BoolArray:
    """Within the radius; an identity says more than any distance."""
    reached: BoolArray = (distances <= radius_m) | (perceptions.identities != "")[:, None]
    return reached


def _is_beyond_doubt(matches: Matches, num_perceptions: int, radius_m: float) -> bool:
    """Everything is matched and nothing is far off: no other rotation can do better."""
    return len(matches) == num_perceptions and matches.deviations_m.max(initial=0.0) < radius_m / 4


def _score(matches: Matches, rule: SweepRule) -> tuple[float, float]:
    """Smaller is better."""
    if len(matches) == 0:
        return (np.inf, np.inf)
    deviation = float(matches.deviations_m.mean())
    count = float(len(matches)) if rule is SweepRule.MOST_MATCHES else 0.0
    return (-count, deviation)


def _pair(distances: FloatArray, allowed: BoolArray, assignment: Assignment) -> Matches:
    if assignment is Assignment.NEAREST:
        rows = np.flatnonzero(allowed.any(axis=1))
        columns = np.where(allowed, distances, np.inf)[rows].argmin(axis=1) if len(rows) else rows
    elif (allowed.sum(axis=0) <= 1).all() and (allowed.sum(axis=1) <= 1).all():
        rows, columns = np.nonzero(allowed)
    else:
        rows, columns = _assign(distances, allowed)
    return Matches(rows, columns, distances[rows, columns])


def _assign(distances: FloatArray, allowed: BoolArray) -> tuple[IntArray, IntArray]:
    """One to one: as many pairs as possible, and among those the least sum of squares."""
    gate = float(distances[allowed].max()) + 1e-9
    costs = np.where(allowed, (distances / gate) ** 2 - 1.0 - min(allowed.shape), 0.0)
    rows, columns = linear_sum_assignment(costs)
    kept = allowed[rows, columns]
    return rows[kept].astype(np.int64), columns[kept].astype(np.int64)
