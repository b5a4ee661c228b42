"""What a batch's looks say of places where nothing was found: how often it was looked in vain."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import Pose2, relative_poses
from semgraph.graph.existence import Tally
from semgraph.offline.batch import Batch, Belief
from sensors.views import View

if TYPE_CHECKING:
    from scipy.spatial import KDTree

# Two looks from places nearer than this are one look.
_APART_M: Final = 0.3
# Where no view says what was in the way, something sighted so near says that it was looked there.
_NEIGHBOUR_M: Final = 6.0
_FIELD_QUANTILE: Final = 0.98
_NUM_BANDS: Final = 4
# So near a landmark there is no other, as in `reassociation.py`.
_TAKEN_M: Final = 0.5
# How often something is perceived where nothing stands.
_CLUTTER: Final = 0.05
# No look is surer than this to show what is there.
_SURE: Final = 0.99
# What lies on a circle's edge is rounded in or out of it.
_A_LITTLE_MORE: Final = 1.000001
# A place known to a sigma is looked at in so many points about it, in sigmas.
_RADII: Final = np.array([0.0, *[0.8] * 6, *[1.7] * 8])
_TURNS: Final = np.array([0.0, *np.arange(6) / 6.0, *(np.arange(8) + 0.5) / 8.0])


@dataclass(frozen=True, slots=True, eq=False)
class Absence:
    """How often each of k places was looked at in vain, and what that says.

    Attributes:
        looks: (k,) from how many places where it had to show.
        log_odds: (k,) what the looks add to the log odds of being there, 0 or below.
    """

    looks: IntArray
    log_odds: FloatArray


@final
class MapLooks:
    """Looks of a batch, 0.3 m apart, and how often what stands there is perceived in one.

    Args:
        batch: what was measured.
        belief: where everything is.
        there: landmarks that are there, for how often such are perceived.
        diameters_m: (k,) of the same.
    """

    def __init__(
        self, batch: Batch, belief: Belief, there: IntArray, diameters_m: FloatArray
    ) -> None:
        self._batch, self._belief = batch, belief
        self._scans = _apart(belief.map_T_bases, batch.firsts)
        self._views: dict[int, list[View]] = {}
        for scan, view in batch.views:
            self._views.setdefault(scan, []).append(view)
        if self._views:
            self._scans = np.array(sorted(self._views), dtype=np.int64)
        self._field = _Field.of(batch)
        self._places = belief.places(there)
        self._band_m = self._field.range_m / _NUM_BANDS
        self._rates = self._perceived(there, diameters_m)

    def absence(
        self, map_t_places: FloatArray, covariances: FloatArray, diameters_m: FloatArray
    ) -> Absence:
        """Of things that stand somewhere about places (k, 2) and were not found.

        The places are known to covariances (k, 2, 2): what was not looked at in all of where it
        may be is not known to be absent. By Bayes' rule, over points about each place where nothing
        else stands.
        """
        k, points = len(map_t_places), len(_RADII)
        spread = np.linalg.cholesky(covariances)
        unit = _RADII[:, None] * np.column_stack(
            [np.cos(2.0 * np.pi * _TURNS), np.sin(2.0 * np.pi * _TURNS)]
        )
        about = map_t_places[:, None] + np.einsum("kij,pj->kpi", spread, unit)
        flat, wide = about.reshape(-1, 2), np.repeat(diameters_m, points)
        in_vain, counts = np.zeros(len(flat)), np.zeros(len(flat))
        things = _Things.at(flat, wide)
        for scan in self._scans.tolist():
            seen = self._shown(scan, things)
            rates = self._rates[self._bands(scan, flat[seen])]
            in_vain[seen] += np.minimum(np.log((1.0 - rates) / (1.0 - _CLUTTER)), 0.0)
            counts[seen] += 1.0
        likelihoods = np.exp(np.maximum(in_vain, -50.0)).reshape(k, points)
        free = self._is_free(flat).reshape(k, points)
        looks = np.median(counts.reshape(k, points), axis=1)
        return Absence(
            looks.astype(np.int64), np.log(np.average(likelihoods, axis=1, weights=free))
        )

    def _is_free(self, map_t_places: FloatArray) -> FloatArray:
        """(n,) 1 where no landmark stands; next to 0 where one does, and so nothing else."""
        from scipy.spatial import KDTree

        if not len(self._places):
            return np.ones(len(map_t_places))
        apart_m, _ = KDTree(self._places).query(map_t_places)
        return np.where(apart_m > _TAKEN_M, 1.0, 1e-6)

    def _perceived(self, there: IntArray, diameters_m: FloatArray) -> FloatArray:
        """(bands,) how often what stands there is perceived, by how far away it is."""
        tallies = [Tally() for _ in range(_NUM_BANDS)]
        starts, ends = (
            np.searchsorted(self._batch.scans, self._scans, side) for side in ("left", "right")
        )
        things = _Things.at(self._places, diameters_m)
        for scan, start, end in zip(self._scans.tolist(), starts, ends, strict=True):
            shown = self._shown(scan, things)
            hits = np.isin(there[shown], self._belief.landmarks[start:end])
            for band, is_hit in zip(self._bands(scan, self._places[shown]), hits, strict=True):
                tallies[band].count(is_hit=bool(is_hit))
        return np.minimum([tally.rate() for tally in tallies], _SURE)

    def _shown(self, scan: int, things: "_Things") -> IntArray:
        """Which things, ascending, had to show in this scan."""
        pose = Pose2.from_array(self._belief.map_T_bases[scan])
        rows = things.within(pose, self._field.range_m)
        rows = rows[self._field.holds(pose, things.map_t_places[rows])]
        if self._views:
            where = (pose, things.map_t_places[rows], things.diameters_m[rows])
            return rows[np.any([view.sees(*where) for view in self._views[scan]], axis=0)]
        return rows[self._has_neighbour(scan, things.map_t_places[rows])]

    def _has_neighbour(self, scan: int, map_t_places: FloatArray) -> BoolArray:
        """(n,) whether something near each place was sighted, so that it was looked there."""
        start, end = np.searchsorted(self._batch.scans, [scan, scan + 1])
        sighted = self._belief.landmarks[start:end]
        neighbours = self._belief.places(sighted[sighted >= 0])
        apart_m = np.linalg.norm(map_t_places[:, None] - neighbours[None], axis=2)
        near: BoolArray = apart_m.min(axis=1, initial=np.inf) <= _NEIGHBOUR_M
        return near

    def _bands(self, scan: int, map_t_places: FloatArray) -> IntArray:
        apart = map_t_places - self._belief.map_T_bases[scan, :2]
        distances_m = np.hypot(apart[:, 0], apart[:, 1])
        bands = (distances_m / self._band_m).astype(np.int64)
        return np.minimum(bands, _NUM_BANDS - 1)


@dataclass(frozen=True, slots=True, eq=False)
class _Things:
    """Some things, to be found by where they are: a scan shows few of all there are."""

    map_t_places: FloatArray
    diameters_m: FloatArray
    tree: "KDTree"

    @classmethod
    def at(cls, map_t_places: FloatArray, diameters_m: FloatArray) -> "_Things":
        """Things (n, 2) m of such diameters (n,) m."""
        from scipy.spatial import KDTree

        return cls(map_t_places, diameters_m, KDTree(map_t_places.reshape(-1, 2)))

    def within(self, map_T_base: Pose2, range_m: float) -> IntArray:
        """Which of them, ascending, lie not farther than that, or hardly."""
        here = (map_T_base.x, map_T_base.y)
        near = self.tree.query_ball_point(here, range_m * _A_LITTLE_MORE, return_sorted=True)
        return np.array(near, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class _Field:
    """What perceptions come from: up to a range, between two bearings."""

    range_m: float
    bearings: tuple[float, float]

    @classmethod
    def of(cls, batch: Batch) -> "_Field":
        if not len(batch.seen):
            return cls(1e-9, (0.0, 0.0))
        bearings = np.quantile(batch.seen.bearings, [1.0 - _FIELD_QUANTILE, _FIELD_QUANTILE])
        low, high = bearings.tolist()
        return cls(float(np.quantile(batch.seen.ranges_m, _FIELD_QUANTILE)), (low, high))

    def holds(self, map_T_base: Pose2, map_t_places: FloatArray) -> BoolArray:
        """(n,) which places are in it."""
        base_t_places = map_T_base.inverse().transform(map_t_places)
        bearings = np.arctan2(base_t_places[:, 1], base_t_places[:, 0])
        low, high = self.bearings
        inside: BoolArray = np.hypot(base_t_places[:, 0], base_t_places[:, 1]) <= self.range_m
        return inside & (bearings >= low) & (bearings <= high)


def _apart(map_T_bases: FloatArray, firsts: tuple[int, ...]) -> IntArray:
    """Scans from places apart, of each session by itself."""
    steps = relative_poses(map_T_bases[:-1], map_T_bases[1:])
    driven_m = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    places = (driven_m / _APART_M).astype(np.int64)
    is_new = np.diff(places, prepend=-1) > 0
    is_new[list(firsts)] = True
    return np.flatnonzero(is_new)
