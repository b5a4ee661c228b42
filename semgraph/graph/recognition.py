"""Finds the surroundings again where drift is larger than any gate: by their constellation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.constellations.constellation import Constellation, MapIndex, Placement
from semgraph.geometry import Pose2
from semgraph.graph.drift import sigma_m
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.graph.loop_closure import Closure
from semgraph.measurement_model import CHI2_3DOF_999


@dataclass(frozen=True, slots=True)
class Recognition:
    """Landmarks in sight that are older ones, and how far off the surroundings were believed.

    `correction` takes what was believed in map to where it is.
    """

    closures: tuple[Closure, ...]
    correction: Pose2


# With so many landmarks within its gate, a thing in sight may be any of them.
_LOOK_ALIKES: Final = 50
_LEAST_REACH_M: Final = 10.0
# What landmarks of a map may be off from each other where nobody asks the graph.
_MAP_SIGMA_M: Final = 0.1
# Fewer are found anywhere.
_LEAST_SEEN: Final = 4
_LEAST_SIGHTINGS: Final = 3
_MAX_MAPPED: Final = 20_000
_WELL_KNOWN_M: Final = 1.0
# In rows one tree farther on four fifths fit; of things that stand by chance three of a few do.
_ALIKE: Final = 0.75


def is_lost(graph: FactorGraph) -> bool:
    """Whether the last pose is so unsure, for landmarks so dense, that gates hold too many."""
    drift = graph.drift()
    if drift.reach_m < _LEAST_REACH_M:
        return False
    here = graph.pose(graph.num_poses - 1).as_array()[:2]
    around = graph.near(here, drift.reach_m)
    distances = np.linalg.norm(np.array(list(around.values())).reshape(-1, 2) - here, axis=1)
    in_reach = distances <= drift.reaches_m(list(around))
    return int(in_reach.sum()) > _LOOK_ALIKES


def recognise(
    graph: FactorGraph,
    landmarks: Mapping[int, GraphLandmark],
    recent: Sequence[int],
    least_log_odds: float,
) -> Recognition | None:
    """The landmarks in sight that are older ones, by where all of them together stand.

    The place must be possible by what is known of the pose. Rows of trees, which look alike, find
    no place that is sure enough.

    Args:
        graph: updated.
        landmarks: all that are in the graph.
        recent: those in sight now.
        least_log_odds: how sure is sure enough.
    """
    covariance = graph.pose_covariance(graph.num_poses - 1)
    along_m = sigma_m(covariance)
    seen = [each for each in recent if landmarks[each].num_sightings >= _LEAST_SIGHTINGS]
    if len(seen) < _LEAST_SEEN:
        return None
    map_T_base = graph.pose(graph.num_poses - 1)
    mapped = _older(graph, landmarks, set(recent), map_T_base, along_m)
    if len(mapped) < _LEAST_SEEN:
        return None
    seen, positions, covariances = _well_known(graph, seen, map_T_base)
    if len(seen) < _LEAST_SEEN:
        return None
    here = _constellation(landmarks, seen, positions, covariances)
    places = np.array(list(mapped.values()))
    known = np.tile(_MAP_SIGMA_M**2 * np.eye(2), (len(mapped), 1, 1))
    index = MapIndex(_constellation(landmarks, list(mapped), places, known))
    placement = _unlike_others(index.place(here, max_placements=2))
    if placement is None or placement.log_odds < least_log_odds:
        return None
    if not _is_possible(placement, map_T_base, covariance):
        return None
    closures = _closures(landmarks, seen, list(mapped), placement)
    return Recognition(closures, placement.map_T_local.pose @ map_T_base.inverse())


def _unlike_others(placements: Sequence[Placement]) -> Placement | None:
    """The best of two placements; None where nearly as much fits somewhere else.

    As rows of trees do one tree farther on, or from their other end. Then the best place is where
    most of the map is, if the true one is outside it.
    """
    if not placements:
        return None
    best, *others = placements
    is_alike = any(len(each.rows) >= _ALIKE * len(best.rows) for each in others)
    return None if is_alike else best


def _older(
    graph: FactorGraph,
    landmarks: Mapping[int, GraphLandmark],
    recent: set[int],
    map_T_base: Pose2,
    along_m: float,
) -> dict[int, FloatArray]:
    """Where the landmarks are that may be in sight: the nearest, if there are too many."""
    centre = map_T_base.as_array()[:2]
    places = {
        landmark: place
        for landmark, place in graph.near(centre, CHI2_3DOF_999**0.5 * along_m + 20.0).items()
        if landmark not in recent and landmarks[landmark].num_sightings >= _LEAST_SIGHTINGS
    }
    nearest = sorted(places, key=lambda each: float(np.hypot(*(places[each] - centre))))
    return {landmark: places[landmark] for landmark in nearest[:_MAX_MAPPED]}


def _well_known(
    graph: FactorGraph, seen: Sequence[int], map_T_base: Pose2
) -> tuple[list[int], FloatArray, FloatArray]:
    """Of the landmarks seen those that are known to a metre, if the last pose were known.

    With their (n, 2) m in base and covariances (n, 2, 2).
    """
    positions = map_T_base.inverse().transform(np.array([graph.landmark(each) for each in seen]))
    covariances = graph.covariances_given_last_pose(seen)
    is_known = np.linalg.eigvalsh(covariances)[:, -1] <= _WELL_KNOWN_M**2
    known = [each for each, is_in in zip(seen, is_known.tolist(), strict=True) if is_in]
    return known, positions[is_known], covariances[is_known]


def _constellation(
    landmarks: Mapping[int, GraphLandmark],
    chosen: Sequence[int],
    positions: FloatArray,
    covariances: FloatArray,
) -> Constellation:
    known = [landmarks[each] for each in chosen]
    outlines2 = np.array([each.outline_sigma_m() ** 2 for each in known])
    diameters = np.array([each.diameter() for each in known])
    return Constellation(
        positions,
        covariances + outlines2[:, None, None] * np.eye(2),
        np.array([each.kind for each in known], dtype=np.int64),
        diameters[:, 0],
        diameters[:, 1],
        np.array([each.identity for each in known], dtype=np.str_),
    )


def _is_possible(placement: Placement, map_T_base: Pose2, covariance: FloatArray) -> bool:
    """Whether the pose may be there, at 99.9 %.

    Distance and angle each for itself: with so unsure a heading the position lies on an arc, which
    no ellipse describes.
    """
    error = map_T_base.between(placement.map_T_local.pose)
    total = covariance + placement.map_T_local.covariance
    of_position2 = float(np.linalg.eigvalsh(total[:2, :2])[-1])
    near = error.x**2 + error.y**2 <= CHI2_3DOF_999 * of_position2
    return bool(near and error.theta**2 <= CHI2_3DOF_999 * total[2, 2])


def _closures(
    landmarks: Mapping[int, GraphLandmark],
    seen: Sequence[int],
    mapped: Sequence[int],
    placement: Placement,
) -> tuple[Closure, ...]:
    pairs = [
        (seen[row], mapped[column])
        for row, column in zip(placement.rows.tolist(), placement.columns.tolist(), strict=True)
    ]
    return tuple(
        Closure(recent, old, placement.log_odds)
        for recent, old in pairs
        if landmarks[recent].may_be(landmarks[old])
    )
