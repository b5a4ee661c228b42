"""Whether a landmark is two things after all: its sightings weighed in two groups, each its own."""

from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.geometry import transform_points
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.graph_log import Sighted
from semgraph.landmarks import cartesian, cartesian_jacobians
from semgraph.measurement_model import mahalanobis2

# So many sightings of a group say all that it can say.
_MOST: Final = 60
# The share of a sighting's variance that all sightings from one side have in common.
_COMMON: Final = 0.25


def log_odds_of_one(
    graph: FactorGraph,
    first: Sighted,
    second: Sighted,
    outline_m2: float,
    density: float,
) -> float:
    """Log odds: how much more probable one thing is than two that stand there by chance.

    As in `association.py`: ln N(difference; 0, S) - ln density, but from the sightings themselves,
    by the poses as the graph has them now with all it has learned since.

    Args:
        graph: updated.
        first: sightings of the one group.
        second: sightings of the other.
        outline_m2: m2 how far the centre may seem off from one side, of both together.
        density: of unknown things, per m2.
    """
    (one, its_covariance), (other, others_covariance) = _place(graph, first), _place(graph, second)
    S = its_covariance + others_covariance + outline_m2 * np.eye(2)
    log_likelihood = -0.5 * (mahalanobis2(one - other, S) + np.log(np.linalg.det(2.0 * np.pi * S)))
    return float(log_likelihood - np.log(density))


def _place(graph: FactorGraph, sightings: Sighted) -> tuple[FloatArray, FloatArray]:
    """(2,) m the weighted mean of sightings in map, and its (2, 2) covariance."""
    chosen = sightings.some(np.unique(np.linspace(0, len(sightings) - 1, _MOST).astype(int)))
    map_T_bases = graph.poses(chosen.poses)
    ranges_m, bearings = chosen.polar.T
    places = transform_points(map_T_bases, cartesian(ranges_m, bearings))
    jacobians = cartesian_jacobians(ranges_m, bearings + map_T_bases[:, 2])
    weights = np.linalg.inv(jacobians @ chosen.covariances @ jacobians.transpose(0, 2, 1))
    mean_covariance = np.linalg.inv(weights.sum(axis=0))
    mean = mean_covariance @ np.einsum("nij,nj->i", weights, places)
    return mean, (_COMMON * len(chosen) + 1.0 - _COMMON) * mean_covariance
