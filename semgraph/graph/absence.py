"""Counts against landmarks that a scan should show and does not."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.geometry import Pose2
from semgraph.graph.existence import Tally
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.landmarks import Kind, Perceptions
from sensors.views import View

# Landmarks seen within so many scans of each other lie well to each other.
_SEEN_TOGETHER_SCANS: Final = 20
# A thing whose diameter nobody knows: rather too small, then fewer looks count against it.
_SOME_DIAMETER_M: Final = 0.1
# What is perceived so near a landmark may be it, whatever else it was taken for.
_SAME_PLACE_M: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What was to be seen at one moment, and from where.

    Attributes:
        odom_T_base: does not jump.
        map_T_base: by the graph.
        perceptions: relative to base.
        views: how far lasers saw.
    """

    odom_T_base: Pose2
    map_T_base: Pose2
    perceptions: Perceptions
    views: Sequence[View]


def count_misses(
    look: Look,
    landmarks: Mapping[int, GraphLandmark],
    places: Mapping[int, FloatArray],
    in_sight: Set[int],
    tallies: Mapping[Kind, Tally],
) -> list[int]:
    """Counts a miss of each landmark that should show now and is not perceived.

    Only where one that is in sight was seen together with it before: then drift is no excuse.

    Args:
        look: at this moment.
        landmarks: all that could be missed, or be in sight.
        places: (2,) of each, in map.
        in_sight: those sighted lately.
        tallies: looks at all things of a kind.

    Returns:
        Those that are gone now.
    """
    around = [landmarks[each] for each in in_sight if landmarks[each].existence.is_there]
    hidden = [
        each
        for each, known in landmarks.items()
        if each not in in_sight and not known.existence.is_gone
    ]
    if not hidden or not around:
        return []
    seen, passed = _visible(look, landmarks, places, hidden)
    gone = []
    for k in np.flatnonzero(seen).tolist():
        missed = landmarks[hidden[k]]
        if not any(_lie_well(missed, other) for other in around):
            continue
        missed.existence.miss(look.odom_T_base, tallies[missed.kind], passed=bool(passed[k]))
        if missed.existence.is_gone:
            gone.append(hidden[k])
    return gone


def _visible(
    look: Look,
    landmarks: Mapping[int, GraphLandmark],
    places: Mapping[int, FloatArray],
    hidden: Sequence[int],
) -> tuple[BoolArray, BoolArray]:
    """(n,) which places are in view with nothing perceived there, and where beams went through."""
    map_t_hidden = np.array([places[each] for each in hidden])
    diameters_m = np.nan_to_num(
        [landmarks[each].diameter()[0] for each in hidden], nan=_SOME_DIAMETER_M
    )
    where = (look.map_T_base, map_t_hidden, diameters_m)
    seen = np.any([view.sees(*where) for view in look.views], axis=0)
    passed = np.any([view.passes(*where) for view in look.views], axis=0)
    return seen & ~_is_perceived(look, landmarks, hidden, map_t_hidden), passed


def _is_perceived(
    look: Look,
    landmarks: Mapping[int, GraphLandmark],
    hidden: Sequence[int],
    map_t_hidden: FloatArray,
) -> BoolArray:
    """(n,) whether something of its kind is perceived at each place."""
    map_t_seen = look.map_T_base.transform(look.perceptions.base_t_landmarks())
    apart_m = np.linalg.norm(map_t_hidden[:, None] - map_t_seen[None], axis=2)
    kinds = np.array([landmarks[each].kind for each in hidden])
    same = kinds[:, None] == look.perceptions.kinds[None]
    return np.asarray((same & (apart_m < _SAME_PLACE_M)).any(axis=1))


def _lie_well(missed: GraphLandmark, sighted: GraphLandmark) -> bool:
    """Whether both were seen at about the same time."""
    last = missed.scans.last
    return sighted.scans.touches(last - _SEEN_TOGETHER_SCANS, last + _SEEN_TOGETHER_SCANS)
