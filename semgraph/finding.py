"""Where perceptions stand in the map around, where the motion hardly says: by constellation."""

from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.constellations.constellation import Constellation, MapIndex
from semgraph.constellations.pairing import log_share
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Perceptions
from semgraph.measurement_model import CHI2_3DOF_999, log_odds_of_pairs
from semgraph.navigation_map import NavigationMap

# A hundred to one: of what a guess has found, of a place after a blindness, and against rivals.
SURE_LOG_ODDS: Final = float(np.log(100.0))
_LEAST_SEEN: Final = 4
# Farther than this nobody looks, however unsure the motion is.
_MAX_REACH_M: Final = 40.0
# What the map around may be off in itself.
_MAP_SIGMA_M: Final = 0.05


def find_pose(
    navigation_map: NavigationMap,
    perceptions: Perceptions,
    map_T_last: Pose2,
    map_T_proposed: UncertainPose2,
    since_m: float,
    least_log_odds: float,
) -> UncertainPose2 | None:
    """map_T_base where all perceptions together fit the map; None where no place is sure enough.

    Neither where another one may be it: rows of trees fit as well one tree farther on, and only the
    motion tells them apart.

    Args:
        navigation_map: what is known.
        perceptions: relative to base.
        map_T_last: where the robot was before.
        map_T_proposed: by the motion model; the place lies within its 99.9 %. Where that is farther
            than anybody looks, the model says nothing, and the place is near the last one.
        since_m: only landmarks last sighted at this distance driven or later.
        least_log_odds: how sure it must be that the place is none outside the map.
    """
    sigma_m = float(np.sqrt(np.linalg.eigvalsh(map_T_proposed.covariance[:2, :2])[-1]))
    map_T_centre = map_T_last if sigma_m > _MAX_REACH_M else map_T_proposed.pose
    reach_m = min(CHI2_3DOF_999**0.5 * sigma_m, _MAX_REACH_M)
    centre = map_T_centre.as_array()[:2]
    in_sight_m = float(perceptions.ranges_m.max(initial=0.0))
    ids = navigation_map.near(centre, in_sight_m + reach_m, since_m)
    if min(len(ids), len(perceptions)) < _LEAST_SEEN:
        return None
    diameters_m, diameter_sigmas_m = navigation_map.diameters(ids)
    mapped = Constellation(
        navigation_map.positions(ids),
        navigation_map.covariances(ids) + _MAP_SIGMA_M**2 * np.eye(2),
        navigation_map.kinds(ids),
        diameters_m,
        diameter_sigmas_m,
        np.array(navigation_map.identities(ids), dtype=np.str_),
    )
    seen = Constellation(
        perceptions.base_t_landmarks(),
        perceptions.base_covariances(),
        perceptions.kinds,
        perceptions.diameters_m,
        perceptions.diameter_sigmas_m,
        perceptions.identities,
    )
    prior = map_T_proposed if sigma_m <= _MAX_REACH_M else None
    best, *others = MapIndex(mapped).place(seen, max_placements=2, prior=prior) or (None,)
    if best is None or any(other.log_odds > -SURE_LOG_ODDS for other in others):
        return None
    apart = map_T_centre.between(best.map_T_local.pose)
    is_near = np.hypot(apart.x, apart.y) <= reach_m
    return best.map_T_local if is_near and best.log_odds >= least_log_odds else None


def log_odds_of_matches(
    perceived: FloatArray,
    mapped: FloatArray,
    covariances: FloatArray,
    prior_covariance: FloatArray,
    proposed_T_base: UncertainPose2,
    perceptions: Perceptions,
) -> float:
    """The ln odds that these are matches, and not things that stand there by chance.

    Args:
        perceived: (k, 2) m in base.
        mapped: (k, 2) m in the proposed frame, of the same things.
        covariances: (k, 2, 2) of their differences, in base.
        prior_covariance: (3, 3) of the proposed frame.
        proposed_T_base: the pose by both, matches and prior.
        perceptions: all there are, one at least.

    Source: Laplace's method; a wide prior has many places for matches to be found at.
    """
    pose = proposed_T_base.pose
    density = len(perceptions) / (np.pi * float(perceptions.ranges_m.max()) ** 2)
    residuals = pose.inverse().transform(mapped) - perceived
    of_pairs = log_odds_of_pairs(residuals, covariances, density).sum()
    moved = pose.as_array()
    of_motion = -0.5 * moved @ np.linalg.solve(prior_covariance, moved)
    left, before = (
        0.5 * np.linalg.slogdet(each)[1] for each in (proposed_T_base.covariance, prior_covariance)
    )
    num_others = len(perceptions) - len(perceived)
    share = log_share(np.array(len(perceived)), np.array(num_others))
    return float(of_pairs + of_motion + left - before + share)
