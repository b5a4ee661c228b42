"""The map of landmarks: sighting counters, means over all sightings, and a spatial index.

Stored as a structure of arrays with a hash grid, so that what is near is found in time independent
of the map's size.
"""

from collections.abc import Iterator
from enum import Enum

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.landmarks import Kind, Landmark, Perceptions, semantic_object
from semgraph.point_grid import PointGrid

_CELL_M = 5.0


class Averaging(Enum):
    """How a landmark's position is averaged over its sightings."""

    INFORMATION = "information"
    SIGHTINGS = "sightings"


class NavigationMap:
    """Landmarks by id (0, 1, 2, ... in the order of insertion).

    Source: paper section 3.3, third step. Differs: INFORMATION weighs each sighting by its own
    covariance; SIGHTINGS is the paper's plain mean.
    """

    def __init__(self, averaging: Averaging = Averaging.INFORMATION) -> None:
        self._averaging = averaging
        self._size = 0
        self._positions = np.zeros((64, 2))
        # Of the sightings' information, or for SIGHTINGS of their covariances.
        self._sums = np.zeros((64, 2, 2))
        self._num_sightings = np.zeros(64, dtype=np.int64)
        self._kinds = np.zeros(64, dtype=np.int64)
        self._num_diameters = np.zeros(64, dtype=np.int64)
        self._diameter_weights = np.zeros(64)
        self._diameters = np.full(64, np.nan)
        self._misses = np.ones(64)
        self._seen_at_m = np.zeros(64)
        self._identities: list[str] = []
        self._by_identity: dict[tuple[int, str], int] = {}
        self._grid = PointGrid(_CELL_M)

    def __len__(self) -> int:
        return self._size

    def __iter__(self) -> Iterator[Landmark]:
        return (self.landmark(landmark_id) for landmark_id in range(self._size))

    def near(self, map_t_point: FloatArray, radius_m: float, since_m: float = -np.inf) -> IntArray:
        """Ids, ascending, of the landmarks within `radius_m` of a point (2,).

        Only those last sighted at a distance driven of `since_m` or more.
        """
        ids = np.array(self._grid.around(map_t_point, radius_m), dtype=np.int64)
        offsets = self._positions[ids] - map_t_point
        is_near = np.hypot(offsets[:, 0], offsets[:, 1]) <= radius_m
        return ids[is_near & (self._seen_at_m[ids] >= since_m)]

    def forget(self, before_m: float) -> None:
        """What was last sighted before this distance driven is near nothing until sighted again."""
        seen_at_m = self._seen_at_m[: self._size]
        ids = np.flatnonzero((seen_at_m < before_m) & np.isfinite(seen_at_m))
        for landmark_id in ids.tolist():
            self._grid.remove(landmark_id)
        seen_at_m[ids] = -np.inf

    def with_identity(self, kind: Kind, identity: str) -> int | None:
        """The id of the landmark that bears this identity."""
        return self._by_identity.get((int(kind), identity))

    def positions(self, ids: IntArray) -> FloatArray:
        """map_t_landmarks (n, 2)."""
        return self._positions[ids]

    def covariances(self, ids: IntArray) -> FloatArray:
        """(n, 2, 2) in map; for SIGHTINGS that of the plain mean."""
        if self._averaging is Averaging.INFORMATION:
            return np.linalg.inv(self._sums[ids])
        covariances: FloatArray = self._sums[ids] / self._num_sightings[ids][:, None, None] ** 2
        return covariances

    def kinds(self, ids: IntArray) -> IntArray:
        """(n,) codes of `Kind`."""
        return self._kinds[ids]

    def diameters(self, ids: IntArray) -> tuple[FloatArray, FloatArray]:
        """(n,) mean diameters and their sigmas, NaN where none was ever perceived.

        A mean is as sure as one perception: what shows one side of a thing errs alike, and the
        other side shows another diameter.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            sigmas = np.sqrt(self._num_diameters[ids] / self._diameter_weights[ids])
        return self._diameters[ids], sigmas

    def identities(self, ids: IntArray) -> list[str]:
        """(n,) identities, empty where there is none."""
        return [self._identities[landmark_id] for landmark_id in ids]

    def num_sightings(self, ids: IntArray) -> IntArray:
        """(n,) the paper's sighting counters."""
        return self._num_sightings[ids]

    def insert(
        self,
        perceptions: Perceptions,
        map_t_landmarks: FloatArray,
        covariances: FloatArray,
        driven_m: float = 0.0,
    ) -> IntArray:
        """Ids (n,) of new landmarks, one for each perception at its position (n, 2) in map."""
        ids = np.arange(self._size, self._size + len(perceptions))
        self._grow_to(self._size + len(perceptions))
        self._positions[ids] = map_t_landmarks
        self._sums[ids] = 0.0
        self._num_sightings[ids] = 0
        self._kinds[ids] = perceptions.kinds
        self._num_diameters[ids] = 0
        self._diameter_weights[ids] = 0.0
        self._diameters[ids] = np.nan
        self._misses[ids] = 1.0
        for k, landmark_id in enumerate(ids.tolist()):
            identity = str(perceptions.identities[k])
            self._identities.append(identity)
            if identity:
                self._by_identity[(int(perceptions.kinds[k]), identity)] = landmark_id
            self._grid.put(landmark_id, map_t_landmarks[k])
        self._size += len(perceptions)
        self.update(ids, perceptions, map_t_landmarks, covariances, driven_m)
        return ids

    def update(
        self,
        ids: IntArray,
        perceptions: Perceptions,
        map_t_landmarks: FloatArray,
        covariances: FloatArray,
        driven_m: float = 0.0,
    ) -> None:
        """Counts one sighting of each of `ids` (n,), distinct, and averages it in.

        Args:
            ids: (n,) landmark of each perception.
            perceptions: n of them.
            map_t_landmarks: (n, 2) where they were perceived, in map.
            covariances: (n, 2, 2) of those, in map.
            driven_m: distance driven when they were sighted.
        """
        self._seen_at_m[ids] = driven_m
        before = self._positions[ids]
        self._num_sightings[ids] += 1
        if self._averaging is Averaging.INFORMATION:
            weights = np.linalg.inv(covariances)
            self._sums[ids] += weights
            gain = np.linalg.solve(self._sums[ids], weights)
            after = before + np.einsum("nij,nj->ni", gain, map_t_landmarks - before)
        else:
            self._sums[ids] += covariances
            after = before + (map_t_landmarks - before) / self._num_sightings[ids][:, None]
        self._positions[ids] = after
        for landmark_id, position in zip(ids.tolist(), after, strict=True):
            self._grid.put(landmark_id, position)
        self._average_attributes(ids, perceptions)

    def landmark(self, landmark_id: int) -> Landmark:
        """The landmark as a value; its reliability: that not all of its sightings were false."""
        ids = np.array([landmark_id])
        diameters, sigmas = self.diameters(ids)
        return Landmark(
            landmark_id,
            semantic_object(
                Kind(self._kinds[landmark_id]),
                diameters[0],
                sigmas[0],
                self._identities[landmark_id],
            ),
            self._positions[landmark_id],
            self.covariances(ids)[0],
            int(self._num_sightings[landmark_id]),
            float(1.0 - self._misses[landmark_id]),
        )

    def _average_attributes(self, ids: IntArray, perceptions: Perceptions) -> None:
        self._misses[ids] *= 1.0 - perceptions.reliabilities
        seen = ~np.isnan(perceptions.diameters_m)
        if not seen.any():
            return
        ids = ids[seen]
        weights = perceptions.diameter_sigmas_m[seen] ** -2.0
        self._num_diameters[ids] += 1
        self._diameter_weights[ids] += weights
        before = np.nan_to_num(self._diameters[ids])
        share = weights / self._diameter_weights[ids]
        self._diameters[ids] = before + share * (perceptions.diameters_m[seen] - before)

    def _grow_to(self, size: int) -> None:
        if size <= len(self._positions):
            return
        capacity = max(size, 2 * len(self._positions))
        for name in (
            "_positions",
            "_sums",
            "_num_sightings",
            "_kinds",
            "_num_diameters",
            "_diameter_weights",
            "_diameters",
            "_misses",
            "_seen_at_m",
        ):
            old = getattr(self, name)
            grown = np.zeros((capacity, *old.shape[1:]), dtype=old.dtype)
            grown[: len(old)] = old
            setattr(self, name, grown)
