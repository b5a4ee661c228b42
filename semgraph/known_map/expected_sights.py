"""What should have been seen from a place, and was or was not: what speaks for open places."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree
from scipy.special import betaln

from semgraph.arrays import FloatArray, IntArray, flattened
from semgraph.geometry import composed_poses, points_from, transform_points
from semgraph.known_map.fixed_map import FixedMap
from semgraph.landmarks import Perceptions
from semgraph.measurement_model import CHI2_2DOF_999

# How much is hidden differs from thing to thing: what is not seen is half believed.
_BELIEVED: Final = 0.5
_NUM_ANYWHERE: Final = 100


@dataclass(frozen=True, slots=True, eq=False)
class Lately:
    """What was seen lately, and from where.

    Attributes:
        perceptions: each thing once, relative to base now.
        base_T_then: (t, 3) where base was, relative to where it is now, and it itself.
    """

    perceptions: Perceptions
    base_T_then: FloatArray

    @classmethod
    def now(cls, perceptions: Perceptions) -> "Lately":
        """Seen from here, now."""
        return cls(perceptions, np.zeros((1, 3)))


class ExpectedSights:
    """Of the landmarks that come into view on the way to a place, how many are seen.

    The share that is seen is not known, and any is as probable as any other: to see these m of c
    then has the probability m! (c - m)! / (c + 1)!. At most places nothing of the map is seen.
    """

    def __init__(self, fixed_map: FixedMap, rng: np.random.Generator) -> None:
        self._map = fixed_map
        self._tree = KDTree(fixed_map.map_t_landmarks)
        low, high = fixed_map.bounds()
        self._anywhere = np.column_stack(
            [rng.uniform(low, high, (_NUM_ANYWHERE, 2)), rng.uniform(-np.pi, np.pi, _NUM_ANYWHERE)]
        )

    def evidence(
        self, places: FloatArray, lately: Lately, reach_m: float, half_field: float
    ) -> FloatArray:
        """(h,) logs of how much better places (h, 3) explain it than all do on average."""
        if not len(places):
            return np.zeros(0)
        in_view, of_anywhere = (
            self._in_view(poses, lately, reach_m, half_field) for poses in (places, self._anywhere)
        )
        seen = np.isin(in_view, self._seen(places, lately.perceptions))
        num_mapped = len(self._map)
        num_expected = np.bincount(in_view // num_mapped, minlength=len(places))
        num_seen = np.bincount(in_view[seen] // num_mapped, minlength=len(places))
        usual = np.bincount(of_anywhere // num_mapped, minlength=_NUM_ANYWHERE)
        log_usual = np.log(np.mean((1.0 + usual) ** -_BELIEVED))
        evidence: FloatArray = _BELIEVED * _log_seen(num_seen, num_expected) - log_usual
        return evidence

    def _in_view(
        self, places: FloatArray, lately: Lately, reach_m: float, half_field: float
    ) -> IntArray:
        """(v,) place times number of landmarks plus landmark, each once."""
        then = lately.base_T_then
        owners = np.repeat(np.arange(len(places)), len(then))
        poses = composed_poses(places[owners], np.tile(then, (len(places), 1)))
        numbers, columns = flattened(self._tree.query_ball_point(poses[:, :2], reach_m))
        base_t = points_from(poses[numbers], self._map.map_t_landmarks[columns])
        bearings = np.arctan2(base_t[:, 1], base_t[:, 0])
        kept = (np.abs(bearings) <= half_field) & np.isin(
            self._map.kinds[columns], lately.perceptions.kinds
        )
        keys: IntArray = np.unique(owners[numbers[kept]] * len(self._map) + columns[kept])
        return keys

    def _seen(self, places: FloatArray, perceptions: Perceptions) -> IntArray:
        """(s,) the same, of the landmarks nearest to what is perceived."""
        k = len(perceptions)
        owners = np.repeat(np.arange(len(places)), k)
        base_t = np.tile(perceptions.base_t_landmarks(), (len(places), 1))
        distances_m, nearest = self._tree.query(transform_points(places[owners], base_t))
        variances = np.trace(perceptions.base_covariances(), axis1=1, axis2=2)
        variances = np.tile(variances, len(places)) + np.trace(
            self._map.covariances[nearest], axis1=1, axis2=2
        )
        is_it = distances_m**2 <= CHI2_2DOF_999 * variances
        keys: IntArray = owners[is_it] * len(self._map) + nearest[is_it]
        return keys


def _log_seen(num_seen: IntArray, num_expected: IntArray) -> FloatArray:
    """Log of the probability of seeing these of those, whatever share is seen."""
    logs: FloatArray = betaln(num_seen + 1, num_expected - num_seen + 1)
    return logs
