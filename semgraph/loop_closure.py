"""Finds landmarks that are one object: where older ones are in sight again, a loop closes."""

from collections.abc import Sequence, Set
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.association import associate
from semgraph.factor_graph import FactorGraph
from semgraph.landmarks import Kind, Perceptions, SemanticObject, semantic_object
from semgraph.measurement_model import CHI2_2DOF_999, diameters_contradict

_MAX_OLD: Final = 20
_MAX_REACH_M: Final = 40.0
_LEAST_REACH_M: Final = 2.0
_DUPLICATES_WITHIN_M: Final = 3.0
_SURROUNDINGS_M: Final = 20.0
# How many of a place's landmarks escaped notice at the first pass.
_UNMAPPED: Final = 0.1


@dataclass(slots=True)
class GraphLandmark:
    """What is known of a landmark of the graph beside its position."""

    kind: Kind
    identity: str
    scans: set[int] = field(default_factory=set)
    diameter_m: float = np.nan
    diameter_weight: float = 0.0
    unreliability: float = 1.0

    @property
    def num_sightings(self) -> int:
        """In how many scans it was sighted."""
        return len(self.scans)

    def sight(self, scan: int, perceptions: Perceptions, row: int) -> None:
        """Counts a sighting and averages its attributes in."""
        self.scans.add(scan)
        self.unreliability *= 1.0 - float(perceptions.reliabilities[row])
        diameter_m = float(perceptions.diameters_m[row])
        if np.isfinite(diameter_m):
            weight = float(perceptions.diameter_sigmas_m[row]) ** -2
            self._average(diameter_m, weight)

    def absorb(self, other: "GraphLandmark") -> None:
        """Takes over all that was known of another landmark which is the same object."""
        self.scans |= other.scans
        self.unreliability *= other.unreliability
        if other.diameter_weight > 0.0:
            self._average(other.diameter_m, other.diameter_weight)

    def may_be(self, other: "GraphLandmark") -> bool:
        """Whether nothing but the position could speak against both being one object."""
        if self.kind is not other.kind or self.identity != other.identity:
            return False
        if not self.scans.isdisjoint(other.scans):
            return False
        return not diameters_contradict(*self.diameter(), *other.diameter())

    def semantics(self) -> SemanticObject:
        """The tree, rock or marker that it is."""
        return semantic_object(self.kind, *self.diameter(), self.identity)

    def diameter(self) -> tuple[float, float]:
        """Its mean and sigma in m, NaN where none was perceived."""
        sigma_m = self.diameter_weight**-0.5 if self.diameter_weight > 0.0 else np.nan
        return self.diameter_m, sigma_m

    def _average(self, diameter_m: float, weight: float) -> None:
        self.diameter_weight += weight
        before = np.nan_to_num(self.diameter_m)
        self.diameter_m = before + weight / self.diameter_weight * (diameter_m - before)


@dataclass(frozen=True, slots=True)
class Closure:
    """Two landmarks that are one: `recent` is what was taken for new, `old` stays."""

    recent: int
    old: int
    log_odds: float


def find_closures(
    graph: FactorGraph,
    landmarks: dict[int, GraphLandmark],
    recent: Sequence[int],
    least_log_odds: float,
) -> list[Closure]:
    """The landmarks among `recent` that are older ones, as far as it is sure enough.

    Args:
        graph: updated; its joint covariance says how far the drift may have gone.
        landmarks: all that are in the graph.
        recent: those in sight now.
        least_log_odds: how sure is sure enough.
    """
    if not recent:
        return []
    estimate = graph.estimate().map_t_landmarks
    old = _candidates(graph, recent, estimate)
    allowed = np.array([[landmarks[a].may_be(landmarks[b]) for b in old] for a in recent])
    if not allowed.any():
        return []
    rows, columns = np.flatnonzero(allowed.any(axis=1)), np.flatnonzero(allowed.any(axis=0))
    return _closures(
        graph,
        estimate,
        [recent[row] for row in rows.tolist()],
        [old[column] for column in columns.tolist()],
        allowed[np.ix_(rows, columns)],
        least_log_odds,
    )


def _closures(
    graph: FactorGraph,
    estimate: dict[int, FloatArray],
    recent: Sequence[int],
    old: Sequence[int],
    allowed: BoolArray,
    least_log_odds: float,
) -> list[Closure]:
    """The pairs of both sides that are sure enough, among those that `allowed` (a, b) permits."""
    differences = np.array([[estimate[a] - estimate[b] for b in old] for a in recent])
    pairs = associate(
        differences,
        graph.landmark_covariance([*recent, *old]),
        allowed,
        _density(estimate, recent),
    )
    return [
        Closure(recent[pair.recent], old[pair.old], pair.log_odds)
        for pair in pairs
        if pair.log_odds >= least_log_odds
    ]


def _candidates(
    graph: FactorGraph,
    recent: Sequence[int],
    estimate: dict[int, FloatArray],
) -> list[int]:
    """The nearest of the landmarks that drift may have brought apart from a recent one."""
    others = [landmark for landmark in estimate if landmark not in set(recent)]
    if not others:
        return []
    positions = np.array([estimate[landmark] for landmark in others])
    seen = np.array([estimate[landmark] for landmark in recent])
    distances = np.linalg.norm(positions[:, None] - seen[None], axis=2).min(axis=1)
    reach_m = _reach(graph.pose_covariance(graph.num_poses - 1))
    order = np.argsort(distances, kind="stable")[:_MAX_OLD]
    return [others[k] for k in order if distances[k] <= reach_m]


def _reach(covariance: FloatArray) -> float:
    """How far what is seen from a pose of this covariance may be from its other self, at 99.9 %."""
    largest = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])
    return float(np.clip((2.0 * CHI2_2DOF_999 * largest) ** 0.5, _LEAST_REACH_M, _MAX_REACH_M))


def _density(estimate: dict[int, FloatArray], recent: Sequence[int]) -> float:
    """Unmapped landmarks per m2 around those in sight."""
    positions = np.array(list(estimate.values()))
    centre = np.mean([estimate[landmark] for landmark in recent], axis=0)
    near = np.linalg.norm(positions - centre, axis=1) < _SURROUNDINGS_M
    return _UNMAPPED * (1.0 + float(near.sum())) / (np.pi * _SURROUNDINGS_M**2)


def duplicates(
    graph: FactorGraph,
    landmarks: dict[int, GraphLandmark],
    changed: Set[int],
    least_log_odds: float,
) -> list[Closure]:
    """Pairs of landmarks anywhere that are one object, each landmark at most once.

    Only pairs with one of `changed` are looked at.
    """
    from scipy.spatial import KDTree

    estimate = graph.estimate().map_t_landmarks
    if len(estimate) < 2:
        return []
    ids = list(estimate)
    tree = KDTree(np.array(list(estimate.values())))
    found: list[Closure] = []
    for recent, rows in zip(
        ids, tree.query_ball_point(tree.data, _DUPLICATES_WITHIN_M), strict=True
    ):
        near = [ids[row] for row in rows if ids[row] < recent]
        if recent not in changed:
            near = [landmark for landmark in near if landmark in changed]
        old = [landmark for landmark in near if landmarks[recent].may_be(landmarks[landmark])]
        if old:
            every = np.ones((1, len(old)), dtype=np.bool_)
            found.extend(_closures(graph, estimate, [recent], old, every, least_log_odds))
    return _disjoint(found)


def _disjoint(closures: list[Closure]) -> list[Closure]:
    """The surest first, no landmark twice."""
    taken: set[int] = set()
    kept = []
    for closure in sorted(closures, key=lambda closure: -closure.log_odds):
        if taken.isdisjoint((closure.recent, closure.old)):
            taken |= {closure.recent, closure.old}
            kept.append(closure)
    return kept
