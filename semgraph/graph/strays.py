"""Sightings that fit nothing once all is known: they were of something else."""

from collections.abc import Set
from typing import Final

import numpy as np

from semgraph.arrays import IntArray
from semgraph.graph.graph_log import NOWHERE, GraphLog
from semgraph.graph.graph_solver import GraphEstimate
from semgraph.measurement_model import CHI2_2DOF_999, misfits2

_LEAST_OF_A_TRACK: Final = 2


def strays(log: GraphLog, estimate: GraphEstimate, landmarks: Set[int]) -> IntArray:
    """(k,) rows of sightings of these landmarks beyond the 99.9 % gate, two or more of a track.

    One in a thousand is there by chance. A landmark that half of its sightings do not fit is in
    doubt itself, and keeps all of them.
    """
    rows = np.flatnonzero(log.landmarks != NOWHERE)
    rows = rows[np.isin(log.landmarks[rows], list(landmarks))]
    names, numbers = np.unique(log.landmarks[rows], return_inverse=True)
    if not len(names):
        return rows
    places = np.array([estimate.map_t_landmarks[name] for name in names.tolist()])
    poses = estimate.map_T_bases[log.poses[rows]]
    is_off = (
        misfits2(poses, places[numbers], log.polar[rows], log.covariances(rows)) > CHI2_2DOF_999
    )
    share_off = np.bincount(numbers, is_off) / np.bincount(numbers)
    tracks = np.unique(log.tracks[rows], return_inverse=True)[1]
    is_no_chance = np.bincount(tracks, is_off)[tracks] >= _LEAST_OF_A_TRACK
    found: IntArray = rows[is_off & is_no_chance & (share_off[numbers] < 0.5)]
    return found
