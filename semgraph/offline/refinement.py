"""Offline refinement: all measurements at once, associations decided anew until nothing changes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.graph.loop_closure import duplicates
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Landmark
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.batch_graph import BatchGraph
from semgraph.offline.landmark_histories import confirmed, histories, reliabilities
from semgraph.offline.reassociation import reassociate, torn, with_places, without_strays

MAX_ROUNDS: Final = 12
# Afterwards landmarks are neither joined nor torn, and every change lowers the robust cost.
_RESTRUCTURING_ROUNDS: Final = 6


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """What a refinement came to.

    Attributes:
        batch: what was measured.
        belief: the optimum, and which perception is of which landmark.
        known: by landmark what is known of it.
        landmarks: those that are confirmed: the map.
        tentative: the others.
        pose_covariances: (n, 3, 3) of each scan's pose, in its own frame.
        changes: how many perceptions each round took for something else.
        cost: half the sum of squared residuals.
    """

    batch: Batch
    belief: Belief
    known: Mapping[int, GraphLandmark]
    landmarks: tuple[Landmark, ...]
    tentative: tuple[Landmark, ...]
    pose_covariances: FloatArray
    changes: tuple[int, ...]
    cost: float

    @property
    def is_settled(self) -> bool:
        """Whether the last round changed nothing."""
        return bool(self.changes) and self.changes[-1] == 0


def refine(
    batch: Batch,
    belief: Belief,
    settings: SmootherSettings,
    note: Callable[[str], None],
    max_rounds: int = MAX_ROUNDS,
) -> tuple[Belief, tuple[int, ...]]:
    """The optimum over all measurements, and how many associations each round changed.

    Each round moves to the optimum, makes one of what is one by joint covariances, decides for
    every perception anew, and lets what was torn off become something of its own. The last rounds
    only decide anew, so that joining and tearing cannot go on by turns.

    Raises:
        GraphError: the batch cannot be solved.
    """
    pool = belief.assigned()
    belief = with_places(batch, belief, without_strays(belief.landmarks))
    changes: list[int] = []
    for number in range(1, max_rounds + 1):
        graph = BatchGraph(batch, belief)
        belief = graph.optimum()
        if number <= _RESTRUCTURING_ROUNDS:
            after = _decide(batch, belief, graph, settings, pool)
        else:
            after = with_places(batch, belief, without_strays(reassociate(batch, belief)))
        changes.append(int((after.landmarks != belief.landmarks).sum()))
        note(f"round {number}, {changes[-1]} associations changed")
        if changes[-1] == 0:
            break
        belief = after
    else:
        belief = BatchGraph(batch, belief).optimum()
    return belief, tuple(changes)


def refined(
    batch: Batch, belief: Belief, settings: SmootherSettings, changes: Sequence[int]
) -> Refined:
    """The map and all covariances at an optimum."""
    known = histories(batch, belief)
    graph = BatchGraph(batch, belief, every_scan=True)
    every = _landmarks(belief, known, graph, reliabilities(batch, known))
    in_map = confirmed(batch, known, settings)
    return Refined(
        batch,
        belief,
        known,
        tuple(each for each in every if each.id in in_map),
        tuple(each for each in every if each.id not in in_map),
        graph.pose_covariances(),
        tuple(changes),
        graph.cost,
    )


def _landmarks(
    belief: Belief,
    known: Mapping[int, GraphLandmark],
    graph: BatchGraph,
    reliabilities: Mapping[int, float],
) -> list[Landmark]:
    """All of the belief, with their marginal covariances."""
    ids = sorted(known)
    return [
        Landmark(
            landmark,
            known[landmark].semantics(),
            belief.map_t_landmarks[landmark],
            covariance,
            known[landmark].num_sightings,
            reliabilities[landmark],
        )
        for landmark, covariance in zip(ids, graph.landmark_covariances(ids), strict=True)
    ]


def _decide(
    batch: Batch, belief: Belief, graph: BatchGraph, settings: SmootherSettings, pool: BoolArray
) -> Belief:
    """The same places with associations decided anew."""
    merged = _merged(batch, belief, graph, settings)
    belief = with_places(batch, belief, merged)
    landmarks = torn(batch, belief, reassociate(batch, belief), pool)
    return with_places(batch, belief, without_strays(landmarks))


def _merged(
    batch: Batch, belief: Belief, graph: BatchGraph, settings: SmootherSettings
) -> IntArray:
    """(m,) the landmarks of perceptions, with pairs that are one object made one."""
    known = histories(batch, belief)
    odds = float(np.log(settings.duplicate_odds))
    landmarks = np.array(belief.landmarks)
    for closure in duplicates(graph, known, set(known), odds):
        landmarks[landmarks == closure.recent] = closure.old
    return landmarks
