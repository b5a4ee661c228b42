"""Finds landmarks that are one object: where older ones are in sight again, a loop closes."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.graph.association import associate
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.measurement_model import log_odds_of_pairs

_MAX_OLD: Final = 20
_MAX_REACH_M: Final = 40.0
_LEAST_REACH_M: Final = 2.0
_DUPLICATES_WITHIN_M: Final = 3.0
_SURROUNDINGS_M: Final = 20.0
_BATCH: Final = 120
# Of what a set that closes a gap says, the best that contradicts it says less than half.
_AHEAD_BY: Final = 0.5
# How many of a place's landmarks escaped notice at the first pass.
_UNMAPPED: Final = 0.1


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
    due: Set[int] | None = None,
) -> list[Closure]:
    """The landmarks among `recent` that are older ones, as far as it is sure enough.

    Args:
        graph: updated; its joint covariance says how far the drift may have gone.
        landmarks: all that are in the graph.
        recent: those in sight now.
        least_log_odds: how sure is sure enough.
        due: those of which there is new evidence, None for all; without a pair of one of these
            nothing is asked of the graph.

    What was only glimpsed proves nothing, and is left to the end.
    """
    recent = [landmark for landmark in recent if landmark not in graph.glimpsed]
    if not recent:
        return []
    due = set(recent) if due is None else due
    drift = graph.drift()
    estimate = _surroundings(graph, recent, float(_limited(drift.reach_m)))
    known = [landmark for landmark in estimate if landmark not in graph.glimpsed]
    pairs = _pairs(landmarks, estimate, recent, known, drift.reaches_m)
    if not any(pairs.allowed[row].any() for row, each in enumerate(recent) if each in due):
        return []
    covariance = partial(graph.covariance_around, around=recent)
    return _closures(landmarks, estimate, pairs, covariance, least_log_odds)


def closures_across(
    graph: FactorGraph,
    landmarks: dict[int, GraphLandmark],
    recent: Sequence[int],
    reach_m: float,
    least_log_odds: float,
) -> list[Closure]:
    """The landmarks among `recent` that are others, of a graph of which nothing is condensed.

    None where they are known so well that `duplicates` finds them pair by pair.

    Args:
        graph: updated; by its joint covariance, wherever the last pose is.
        landmarks: all that are in the graph.
        recent: that were sighted together.
        reach_m: how far they may be off.
        least_log_odds: how sure is sure enough.
    """
    if reach_m <= _LEAST_REACH_M:
        return []
    estimate = _surroundings(graph, recent, float(_limited(reach_m)))
    pairs = _pairs(
        landmarks, estimate, recent, list(estimate), lambda old: np.full(len(old), reach_m)
    )
    covariance = graph.landmark_covariance
    return _closures(landmarks, estimate, pairs, covariance, least_log_odds, _AHEAD_BY)


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """(a, b) which of `recent` may be which of `old`."""

    recent: list[int]
    old: list[int]
    allowed: BoolArray

    def possible(self) -> "_Pairs":
        """Without what may be none."""
        rows, columns = (np.flatnonzero(self.allowed.any(axis=axis)) for axis in (1, 0))
        return _Pairs(
            [self.recent[row] for row in rows.tolist()],
            [self.old[column] for column in columns.tolist()],
            self.allowed[np.ix_(rows, columns)],
        )


def _pairs(
    landmarks: Mapping[int, GraphLandmark],
    estimate: Mapping[int, FloatArray],
    recent: Sequence[int],
    known: Iterable[int],
    reaches_m: Callable[[list[int]], FloatArray],
) -> _Pairs:
    """Which of those in sight may be which of those known, by kind, attributes and distance."""
    old = _candidates(recent, known, estimate, reaches_m)
    near = _distances(recent, old, estimate) <= _limited(reaches_m(old))
    allowed = np.zeros_like(near)
    for row, column in np.argwhere(near):
        allowed[row, column] = landmarks[recent[row]].may_be(landmarks[old[column]])
    return _Pairs(list(recent), old, allowed)


def _closures(
    landmarks: Mapping[int, GraphLandmark],
    estimate: Mapping[int, FloatArray],
    pairs: _Pairs,
    covariance: Callable[[list[int]], FloatArray],
    least_log_odds: float,
    ahead_by: float = 0.0,
) -> list[Closure]:
    """The pairs that are sure enough; `covariance` gives the joint one of landmarks."""
    pairs = pairs.possible()
    recent, old = pairs.recent, pairs.old
    if not recent:
        return []
    differences = np.array([[estimate[a] - estimate[b] for b in old] for a in recent])
    outlines2 = [
        np.array([landmarks[each].outline_sigma_m() ** 2 for each in side])
        for side in (recent, old)
    ]
    found = associate(
        differences,
        covariance([*recent, *old]),
        pairs.allowed,
        _density(estimate, recent),
        outlines2[0][:, None] + outlines2[1][None, :],
        ahead_by,
    )
    return [
        Closure(recent[pair.recent], old[pair.old], pair.log_odds)
        for pair in found
        if pair.log_odds >= least_log_odds
    ]


def _surroundings(
    graph: FactorGraph, recent: Sequence[int], reach_m: float
) -> dict[int, FloatArray]:
    """Positions of those in sight, and of all that drift may have brought apart from them."""
    places = {landmark: graph.landmark(landmark) for landmark in recent}
    centre = np.mean(list(places.values()), axis=0)
    spread_m = max(float(np.hypot(*(place - centre))) for place in places.values())
    return places | graph.near(centre, max(spread_m + reach_m, _SURROUNDINGS_M))


def _candidates(
    recent: Sequence[int],
    known: Iterable[int],
    estimate: Mapping[int, FloatArray],
    reaches_m: Callable[[list[int]], FloatArray],
) -> list[int]:
    """The nearest of those known that drift may have brought apart from a recent one."""
    others = [landmark for landmark in known if landmark not in set(recent)]
    if not others:
        return []
    distances = _distances(recent, others, estimate).min(axis=0)
    reaches = _limited(reaches_m(others))
    order = np.argsort(distances, kind="stable")[:_MAX_OLD]
    return [others[k] for k in order if distances[k] <= reaches[k]]


def _distances(
    recent: Sequence[int], old: Sequence[int], estimate: Mapping[int, FloatArray]
) -> FloatArray:
    """(a, b) m between each of both."""
    seen, known = (np.array([estimate[k] for k in side]).reshape(-1, 2) for side in (recent, old))
    distances: FloatArray = np.linalg.norm(seen[:, None] - known[None], axis=2)
    return distances


def _limited(reaches_m: FloatArray | float) -> FloatArray:
    """As far as it pays to look, and always a little."""
    limited: FloatArray = np.clip(np.asarray(reaches_m), _LEAST_REACH_M, _MAX_REACH_M)
    return limited


def _density(estimate: Mapping[int, FloatArray], recent: Sequence[int]) -> float:
    """Unmapped landmarks per m2 around those in sight."""
    positions = np.array(list(estimate.values()))
    centre = np.mean([estimate[landmark] for landmark in recent], axis=0)
    near = np.linalg.norm(positions - centre, axis=1) < _SURROUNDINGS_M
    return _unmapped(int(near.sum()))


def _densities(estimate: Mapping[int, FloatArray]) -> dict[int, float]:
    """Unmapped landmarks per m2 around each of all."""
    from scipy.spatial import KDTree

    if not estimate:
        return {}
    positions = np.array(list(estimate.values()))
    counts = KDTree(positions).query_ball_point(positions, _SURROUNDINGS_M, return_length=True)
    return {name: _unmapped(count) for name, count in zip(estimate, counts.tolist(), strict=True)}


def density(graph: FactorGraph, landmark: int) -> float:
    """Unmapped landmarks per m2 around a landmark."""
    return _unmapped(len(graph.near(graph.landmark(landmark), _SURROUNDINGS_M)))


def _unmapped(num_around: int) -> float:
    return _UNMAPPED * (1.0 + num_around) / (np.pi * _SURROUNDINGS_M**2)


class Places(Protocol):
    """Where landmarks are."""

    @property
    def map_t_landmarks(self) -> Mapping[int, FloatArray]:
        """(2,) by landmark."""
        ...


class Solved(Protocol):
    """A graph with an estimate, incremental or batch."""

    def estimate(self) -> Places:
        """Where everything is."""
        ...

    def landmark_covariance(self, landmarks: Sequence[int]) -> FloatArray:
        """(2n, 2n) joint covariance of landmarks, in map, in the order given."""
        ...


def duplicates(
    graph: Solved,
    landmarks: dict[int, GraphLandmark],
    changed: Set[int],
    least_log_odds: float,
) -> list[Closure]:
    """Pairs of landmarks anywhere that are one object, each landmark at most once.

    Only pairs with one of `changed` are looked at.
    """
    estimate = graph.estimate().map_t_landmarks
    densities = _densities(estimate)
    found: list[Closure] = []
    for batch in _batches(_suspects(landmarks, estimate, changed)):
        log_odds = _log_odds(graph, landmarks, estimate, densities, batch)
        for (recent, old), odds in zip(batch, log_odds, strict=True):
            found += [
                Closure(recent, one, its_odds)
                for one, its_odds in _against_rivals(landmarks, old, odds)
                if its_odds >= least_log_odds
            ]
    return _disjoint(found)


def _log_odds(
    graph: Solved,
    landmarks: Mapping[int, GraphLandmark],
    estimate: Mapping[int, FloatArray],
    densities: Mapping[int, float],
    batch: Sequence[tuple[int, list[int]]],
) -> list[FloatArray]:
    """Of each suspect's pairs, (k,) for k older landmarks: how surely each is one and not new."""
    members = sorted({landmark for recent, old in batch for landmark in (recent, *old)})
    joint = graph.landmark_covariance(members).reshape(len(members), 2, len(members), 2)
    pairs = np.array([(recent, one) for recent, old in batch for one in old])
    first, second = np.searchsorted(members, pairs).T
    places = np.array([estimate[each] for each in members])
    outlines2 = np.array([landmarks[each].outline_sigma_m() ** 2 for each in members])
    cross = joint[first, :, second]
    covariances = (
        joint[first, :, first]
        + joint[second, :, second]
        - cross
        - cross.transpose(0, 2, 1)
        + (outlines2[first] + outlines2[second])[:, None, None] * np.eye(2)
    )
    log_odds = log_odds_of_pairs(
        places[first] - places[second],
        covariances,
        np.array([densities[recent] for recent in pairs[:, 0].tolist()]),
    )
    return np.split(log_odds, np.cumsum([len(old) for _, old in batch])[:-1])


def _against_rivals(
    landmarks: Mapping[int, GraphLandmark], old: Sequence[int], log_odds: FloatArray
) -> Iterator[tuple[int, float]]:
    """Each older landmark with how surely it is the one, against those that are not that one."""
    possible = np.flatnonzero(np.isfinite(log_odds)).tolist()
    for k in possible:
        one = landmarks[old[k]]
        rivals = (log_odds[j] for j in possible if j != k and not one.may_be(landmarks[old[j]]))
        yield old[k], float(min(log_odds[k], log_odds[k] - max(rivals, default=0.0)))


def _suspects(
    landmarks: dict[int, GraphLandmark], estimate: Mapping[int, FloatArray], changed: Set[int]
) -> Iterator[tuple[int, list[int]]]:
    """Each landmark with the earlier ones around that it may be; neighbours follow each other."""
    from scipy.spatial import KDTree

    if len(estimate) < 2:
        return
    ids = list(estimate)
    tree = KDTree(np.array(list(estimate.values())))
    around = tree.query_ball_point(tree.data, _DUPLICATES_WITHIN_M)
    for row in tree.indices.tolist():
        recent = ids[row]
        near = [ids[other] for other in around[row] if ids[other] < recent]
        if recent not in changed:
            near = [landmark for landmark in near if landmark in changed]
        old = [landmark for landmark in near if landmarks[recent].may_be(landmarks[landmark])]
        if old:
            yield recent, old


def _batches(
    suspects: Iterable[tuple[int, list[int]]],
) -> Iterator[list[tuple[int, list[int]]]]:
    """Suspects that share a joint covariance, which costs for forty what it costs for two.

    Where they stand close together one covariance serves as many as there are of them.
    """
    batch: list[tuple[int, list[int]]] = []
    members: set[int] = set()
    for recent, old in suspects:
        if batch and len(members.union(old, [recent])) > _BATCH:
            yield batch
            batch, members = [], set()
        batch.append((recent, old))
        members.update(old, [recent])
    if batch:
        yield batch


def _disjoint(closures: list[Closure]) -> list[Closure]:
    """The surest first, no landmark twice."""
    taken: set[int] = set()
    kept = []
    for closure in sorted(closures, key=lambda closure: -closure.log_odds):
        if taken.isdisjoint((closure.recent, closure.old)):
            taken |= {closure.recent, closure.old}
            kept.append(closure)
    return kept
