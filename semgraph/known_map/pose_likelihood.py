"""How well poses explain what is perceived, in a fixed map, against being anywhere else in it."""

from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import KDTree

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import rotation, wrap_angle
from semgraph.known_map.fixed_map import FixedMap
from semgraph.known_map.likelihood_field import LikelihoodField, Seen
from semgraph.landmarks import Kind, Perceptions
from semgraph.measurement_model import CHI2_2DOF_999, diameter_log_likelihoods

# Of so many landmarks it is told how usual a diameter is.
_SAMPLE: Final = 500
# A diameter may be wrong altogether, by another thing before the trunk.
_WRONG_DIAMETER: Final = 0.05
# A name that is in the map, and yet is of nothing in it.
_MISREAD: Final = 0.01
# A diameter that no tree of the map has.
_LEAST_USUAL: Final = 1e-3
# More poses times candidates than this are looked up in the field, and poses that turn more.
_MOST_EXACT: Final = 400_000
_MOST_TURNED: Final = 0.3


class LikelihoodSettings(BaseModel):
    """What is known of map and detectors.

    `clutter` is the probability that a perception is of nothing in the map: a false one, or one of
    a thing that the map lacks. `map_sigma_m` is how far a landmark may be off, on top of what its
    own covariance says.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    clutter: float = Field(0.2, gt=0.0, lt=1.0)
    map_sigma_m: float = Field(0.05, ge=0.0, le=10.0)


class PoseLikelihood:
    """log L(x) = sum over perceptions of log(clutter + detected * sum_j N(e_j) q_j / mean(q) rho).

    e_j is where a landmark is perceived minus where it is, q_j how well diameters agree, rho the
    density of landmarks of its kind. Averaged over all poses of the map L is 1: L is the odds
    against being anywhere in the map. What is not perceived says nothing, for without the scan
    nobody knows what was hidden.

    Source: Thrun, Burgard and Fox 2005, sections 6.4 and 6.6. Differs: the noise beside the
    landmarks is a clutter density, as in multi-target tracking, and the sum over landmarks is kept.
    """

    def __init__(self, fixed_map: FixedMap, settings: LikelihoodSettings) -> None:
        self._map = fixed_map
        self._area_m2 = fixed_map.area_m2
        self._settings = settings
        self._tree = KDTree(fixed_map.map_t_landmarks)
        self._field: LikelihoodField | None = None
        self._largest_variance = float(np.trace(fixed_map.covariances, axis1=1, axis2=2).max())
        self._of_kind = {
            kind: np.flatnonzero(fixed_map.kinds == kind) for kind in set(fixed_map.kinds.tolist())
        }
        # Of the map's area, by code of kind; what no landmark is gets none.
        self._area_each = np.zeros(len(Kind))
        for kind, columns in self._of_kind.items():
            self._area_each[kind] = fixed_map.area_m2 / len(columns)

    @property
    def fixed_map(self) -> FixedMap:
        """The map."""
        return self._map

    def see(self, perceptions: Perceptions) -> Seen:
        """Perceptions prepared for many poses."""
        is_known = perceptions.identities != ""
        if is_known.any():
            is_known &= np.isin(perceptions.identities, self._map.identities)
        of_none = np.where(is_known, min(_MISREAD, self._settings.clutter), self._settings.clutter)
        clutter = 1.0 - (1.0 - of_none) * perceptions.reliabilities
        return Seen(
            perceptions.base_t_landmarks(),
            perceptions.kinds,
            perceptions.base_covariances() + self._settings.map_sigma_m**2 * np.eye(2),
            np.log(clutter),
            perceptions.diameters_m,
            perceptions.diameter_sigmas_m,
            perceptions.identities,
            self._usual(perceptions),
        )

    def log_weights(self, seen: Seen, rows: IntArray, columns: IntArray) -> FloatArray:
        """Log of how much more a landmark may be a perception than any place of the map may.

        Args:
            seen: perceptions.
            rows: of perceptions.
            columns: of landmarks, broadcast with the rows.

        Returns:
            As broadcast, m2: the density at the landmark is still to come; -inf where it cannot.
        """
        kinds = seen.kinds[rows]
        agreements = np.exp(
            diameter_log_likelihoods(
                seen.diameters_m[rows],
                seen.diameter_sigmas_m[rows],
                self._map.diameters_m[columns],
                self._map.diameter_sigmas_m[columns],
            )
        )
        ratios = (1.0 - _WRONG_DIAMETER) * agreements / seen.usual[rows] + _WRONG_DIAMETER
        ratios = np.where(np.isnan(ratios), 1.0, ratios) * self._area_each[kinds]
        is_named = seen.identities[rows] != ""
        is_same = seen.identities[rows] == self._map.identities[columns]
        ratios = np.where(is_named, self._area_m2, ratios)
        may_be = (kinds == self._map.kinds[columns]) & (is_same | ~is_named)
        detected = np.maximum(-np.expm1(seen.log_clutter[rows]), 1e-6)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.where(may_be, ratios * detected, 0.0)))

    def sparseness(self, map_t_point: FloatArray, radius_m: float) -> float:
        """One minus the number of landmarks in a circle by that in the mean of all places."""
        if radius_m <= 0.0:
            return 0.0
        count = int(self._tree.query_ball_point(map_t_point, radius_m, return_length=True))
        usual = len(self._map) / self._area_m2 * np.pi * radius_m**2
        return float(1.0 - count / usual)

    def log_likelihoods(self, seen: Seen, map_T_bases: FloatArray) -> FloatArray:
        """(n,) log L of poses (n, 3).

        Exact where they are all near each other and few; else by the field.
        """
        if not len(seen) or not len(map_T_bases):
            return np.zeros(len(map_T_bases))
        middle = _middle(map_T_bases)
        spread = map_T_bases - middle
        turned = float(np.abs(wrap_angle(spread[:, 2])).max())
        moved = float(np.hypot(spread[:, 0], spread[:, 1]).max())
        if turned <= _MOST_TURNED:
            columns = self.candidates(seen, middle, moved, turned)
            if columns.size * len(map_T_bases) <= _MOST_EXACT:
                return self._exact(seen, map_T_bases, columns, float(middle[2]))
        if self._field is None:
            self._field = LikelihoodField(self._map)
        rows, columns = np.arange(len(seen))[:, None], np.arange(len(self._map))[None]
        return self._field.log_likelihoods(seen, map_T_bases, self.log_weights(seen, rows, columns))

    def num_explained(self, seen: Seen, map_T_base: FloatArray) -> int:
        """How many perceptions are rather of something in the map than not, from a pose (3,)."""
        columns = self.candidates(seen, map_T_base, 0.0, 0.0)
        if not columns.size:
            return 0
        logs = self.pair_log_likelihoods(seen, map_T_base[None], columns, float(map_T_base[2]))
        return int((logs[0].max(axis=1) > seen.log_clutter).sum())

    def candidates(
        self, seen: Seen, map_T_base: FloatArray, moved_m: float, turned: float
    ) -> IntArray:
        """(k, c) landmarks that each perception may be from poses about (3,); -1: no more."""
        map_t = base_to_map(map_T_base[None], seen.base_t)[0]
        far = np.hypot(seen.base_t[:, 0], seen.base_t[:, 1])
        sigmas = np.sqrt(np.trace(seen.covariances, axis1=1, axis2=2) + self._largest_variance)
        radii = moved_m + far * turned + np.sqrt(CHI2_2DOF_999) * sigmas
        lists = self._tree.query_ball_point(map_t, radii)
        columns = np.full((len(seen), max(map(len, lists), default=0)), -1, dtype=np.int64)
        for row, found in enumerate(lists):
            columns[row, : len(found)] = found
        return columns

    def pair_log_likelihoods(
        self, seen: Seen, map_T_bases: FloatArray, columns: IntArray, heading: float
    ) -> FloatArray:
        """(n, k, c) log of each candidate's share in L, -inf where there is none.

        Covariances are turned by `heading` for all poses.
        """
        rows = np.arange(len(seen))[:, None]
        R = rotation(heading)
        S = (R @ seen.covariances @ R.T)[:, None] + self._map.covariances[columns]
        a, b, d = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
        determinant = a * d - b * b
        map_t = base_to_map(map_T_bases, seen.base_t)[:, :, None]
        x, y = np.moveaxis(map_t - self._map.map_t_landmarks[columns], -1, 0)
        distances2 = (d * x * x - 2.0 * b * x * y + a * y * y) / determinant
        peaks = np.where(columns >= 0, self.log_weights(seen, rows, columns), -np.inf)
        peaks = peaks - np.log(2.0 * np.pi * np.sqrt(determinant))
        logs: FloatArray = peaks - 0.5 * distances2
        return logs

    def _exact(
        self, seen: Seen, map_T_bases: FloatArray, columns: IntArray, heading: float
    ) -> FloatArray:
        logs = self.pair_log_likelihoods(seen, map_T_bases, columns, heading)
        sums = np.exp(logs).sum(axis=2) + np.exp(seen.log_clutter)
        total: FloatArray = np.log(sums).sum(axis=1)
        return total

    def _usual(self, perceptions: Perceptions) -> FloatArray:
        """(k,) the mean density of each diameter over landmarks of its kind; 1 if unknown."""
        usual = np.ones(len(perceptions))
        for kind, columns in self._of_kind.items():
            rows = np.flatnonzero(perceptions.kinds == kind)
            sample = columns[:: max(1, len(columns) // _SAMPLE)]
            densities = np.exp(
                diameter_log_likelihoods(
                    perceptions.diameters_m[rows, None],
                    perceptions.diameter_sigmas_m[rows, None],
                    self._map.diameters_m[None, sample],
                    self._map.diameter_sigmas_m[None, sample],
                )
            )
            is_known = ~np.isnan(densities)
            sums = np.where(is_known, densities, 0.0).sum(axis=1)
            means = sums / np.maximum(is_known.sum(axis=1), 1)
            usual[rows] = np.maximum(means, _LEAST_USUAL)
        return usual


def base_to_map(map_T_bases: FloatArray, base_t: FloatArray) -> FloatArray:
    """(n, k, 2) of poses (n, 3) and points (k, 2), each from each pose."""
    c, s = np.cos(map_T_bases[:, 2, None]), np.sin(map_T_bases[:, 2, None])
    x, y = base_t[:, 0], base_t[:, 1]
    return np.stack(
        [map_T_bases[:, 0, None] + c * x - s * y, map_T_bases[:, 1, None] + s * x + c * y], axis=-1
    )


def _middle(map_T_bases: FloatArray) -> FloatArray:
    """(3,) the mean position and heading of poses (n, 3)."""
    x, y = map_T_bases[:, :2].mean(axis=0)
    theta = np.arctan2(np.sin(map_T_bases[:, 2]).mean(), np.cos(map_T_bases[:, 2]).mean())
    return np.array([x, y, theta])
