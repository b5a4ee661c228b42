"""A winding closed way between things that stand there, none of which it touches."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from sensors.simulation.courses.track import Track

_STEP_M: Final = 0.25
_LANE_M: Final = 0.2
_REACH_SHARE: Final = 0.45
_MAX_CHANGE: Final = 1
_CHANGE_COST: Final = 0.05
_STRAIGHTENED_M: Final = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Obstacles:
    """Circles: world_t_obstacles (n, 2) and radii (n,), m."""

    world_t_obstacles: FloatArray
    radii_m: FloatArray

    def gaps_m(self, world_t_points: FloatArray) -> FloatArray:
        """(...) from points (..., 2) to the surface of the nearest one; +inf without any."""
        from scipy.spatial import KDTree

        flat = world_t_points.reshape(-1, 2)
        gaps_m = np.full(len(flat), np.inf)
        if len(self.radii_m):
            near = min(8, len(self.radii_m))
            distances_m, rows = KDTree(self.world_t_obstacles).query(flat, k=np.arange(near) + 1)
            gaps_m = (distances_m - self.radii_m[rows]).min(axis=1)
        return gaps_m.reshape(world_t_points.shape[:-1])


def free_way(
    obstacles: Obstacles, radius_m: float, half_width_m: float, rng: np.random.Generator
) -> Track:
    """A way around the origin, near the circle, that keeps `half_width_m` to all obstacles.

    The cheapest chain of lanes over the angle (Viterbi), straightened a little.

    Raises:
        InputError: there is none.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, round(2.0 * np.pi * radius_m / _STEP_M), endpoint=False)
    ahead = np.column_stack([np.cos(angles), np.sin(angles)])
    reach_m = _REACH_SHARE * radius_m
    lanes_m = np.arange(-reach_m, reach_m, _LANE_M) + radius_m
    wish_m = radius_m + reach_m * 0.4 * np.sin(3.0 * angles + rng.uniform(0.0, 2.0 * np.pi))
    gaps_m = obstacles.gaps_m(ahead[:, None] * lanes_m[:, None])
    for spare_m in (0.3, 0.2, 0.1, 0.4, 0.6):
        missing_m = np.maximum(half_width_m + spare_m - gaps_m, 0.0)
        wishes = 0.02 * (lanes_m - wish_m[:, None]) ** 2
        chain = _cheapest_chain(1e3 * missing_m**2 + wishes)
        straight_m = _straightened(lanes_m[chain], _STRAIGHTENED_M / _STEP_M)
        track = Track(straight_m[:, None] * ahead)
        along_m = np.arange(0.0, track.length_m, 0.5 * _STEP_M)
        if (obstacles.gaps_m(track.poses(along_m)[:, :2]) >= half_width_m).all():
            return track
    raise InputError(
        f"course: found no way {2.0 * half_width_m:g} m wide around a circle of {radius_m:g} m; "
        "take another seed, another radius, or fewer things in the way"
    )


def _cheapest_chain(costs: FloatArray) -> IntArray:
    """(n,) a column of costs (n, m) for each row, neighbours close together, the ends too."""
    around = np.concatenate([costs, costs, costs])
    changes = np.arange(-_MAX_CHANGE, _MAX_CHANGE + 1)
    best = around[0].copy()
    came = np.zeros(around.shape, dtype=np.int64)
    m = costs.shape[1]
    for k in range(1, len(around)):
        padded = np.pad(best, _MAX_CHANGE, constant_values=np.inf)
        ways = np.stack(
            [padded[_MAX_CHANGE + c : _MAX_CHANGE + c + m] + _CHANGE_COST * c**2 for c in changes]
        )
        choice = ways.argmin(axis=0)
        came[k] = np.arange(m) + changes[choice]
        best = ways[choice, np.arange(m)] + around[k]
    chain = [int(best.argmin())]
    for k in range(len(around) - 1, 0, -1):
        chain.append(int(came[k, chain[-1]]))
    # Of three laps the middle one begins where it ends.
    return np.array(chain[::-1])[len(costs) : 2 * len(costs)]


def _straightened(radii_m: FloatArray, sigma: float) -> FloatArray:
    from scipy.ndimage import gaussian_filter1d

    straight_m: FloatArray = gaussian_filter1d(radii_m, sigma, mode="wrap")
    return straight_m
