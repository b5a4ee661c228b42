"""What is known of landmarks beside where they are, as a structure of arrays."""

from collections.abc import Sequence
from typing import final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Kind, Landmark, Perceptions, semantic_object
from semgraph.matching import LocalMap, compatible


@final
class Sighted:
    """Kinds, diameters, identities and sightings of landmarks 0, 1, 2, ... in order of their first.

    A landmark is tentative until it was sighted `min_sightings` times, and is given up if that
    does not come about before it was not sighted for `in_sight_scans`. It is in the map once it
    was also sighted over `least_seconds`: the smoother's settings, and its rules but for movers.
    """

    def __init__(self, settings: SmootherSettings) -> None:
        self._settings = settings
        self._kinds = np.zeros(0, dtype=np.int64)
        self._identities = np.zeros(0, dtype=np.str_)
        self._diameters_m = np.zeros(0)
        self._diameter_weights = np.zeros(0)
        self._misses = np.zeros(0)
        self._num_sightings = np.zeros(0, dtype=np.int64)
        self._last_scans = np.zeros(0, dtype=np.int64)
        self._first_ns = np.zeros(0, dtype=np.int64)
        self._last_ns = np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._kinds)

    def add(self, scan: int, perceptions: Perceptions) -> IntArray:
        """(n,) numbers of new landmarks, one for each perception."""
        n = len(perceptions)
        new = np.arange(len(self), len(self) + n)
        self._kinds = np.append(self._kinds, perceptions.kinds)
        self._identities = np.append(self._identities, perceptions.identities)
        for name in ("_diameters_m", "_diameter_weights"):
            setattr(self, name, np.append(getattr(self, name), np.zeros(n)))
        self._misses = np.append(self._misses, np.ones(n))
        for name in ("_num_sightings", "_last_scans"):
            setattr(self, name, np.append(getattr(self, name), np.zeros(n, dtype=np.int64)))
        stamps_ns = np.full(n, perceptions.stamp_ns, dtype=np.int64)
        self._first_ns = np.append(self._first_ns, stamps_ns)
        self._last_ns = np.append(self._last_ns, stamps_ns)
        self.sight(scan, new, perceptions)
        return new

    def sight(self, scan: int, landmarks: IntArray, perceptions: Perceptions) -> None:
        """One sighting more of each of these landmarks (n,), distinct."""
        self._num_sightings[landmarks] += 1
        self._last_scans[landmarks] = scan
        self._last_ns[landmarks] = perceptions.stamp_ns
        self._misses[landmarks] *= 1.0 - perceptions.reliabilities
        seen = ~np.isnan(perceptions.diameters_m)
        some, weights = landmarks[seen], perceptions.diameter_sigmas_m[seen] ** -2.0
        self._diameter_weights[some] += weights
        off_m = perceptions.diameters_m[seen] - self._diameters_m[some]
        self._diameters_m[some] += weights / self._diameter_weights[some] * off_m

    def is_given_up(self, scan: int) -> BoolArray:
        """(m,) of each landmark, whether it never came out of being tentative."""
        unseen = scan - self._last_scans > self._settings.in_sight_scans
        given_up: BoolArray = unseen & (self._num_sightings < self._settings.min_sightings)
        return given_up

    def compatible(self, perceptions: Perceptions, landmarks: IntArray) -> BoolArray:
        """(n, k) whether a perception may be a landmark by kind, identity and diameter."""
        diameters_m, sigmas_m = self._diameters(landmarks)
        k = len(landmarks)
        local = LocalMap(
            landmarks,
            np.zeros((k, 2)),
            np.zeros((k, 2, 2)),
            self._kinds[landmarks],
            diameters_m,
            sigmas_m,
            self._identities[landmarks].tolist(),
        )
        return compatible(perceptions, local)

    def same_kind(self, perceptions: Perceptions, landmarks: IntArray) -> BoolArray:
        """(n, k) whether a perception could be a landmark but for its diameter."""
        same: BoolArray = perceptions.kinds[:, None] == self._kinds[None, landmarks]
        same &= perceptions.identities[:, None] == self._identities[None, landmarks]
        return same

    def is_borne(self, perceptions: Perceptions, scan: int) -> BoolArray:
        """(n,) whether a landmark that is not given up bears a perception's identity."""
        alive = np.flatnonzero(~self.is_given_up(scan))
        named = perceptions.identities != ""
        borne: BoolArray = named & self.same_kind(perceptions, alive).any(axis=1)
        return borne

    def landmarks(
        self, numbers: Sequence[int], places: FloatArray, covariances: FloatArray
    ) -> tuple[Landmark, ...]:
        """Those of some landmarks that are in the map, at places (n, 2) with covariances."""
        stayed_ns = self._last_ns - self._first_ns
        is_in_map = (self._num_sightings >= self._settings.min_sightings) & (
            stayed_ns >= self._settings.least_seconds * 1e9
        )
        diameters_m, sigmas_m = self._diameters(np.arange(len(self)))
        return tuple(
            Landmark(
                number,
                semantic_object(
                    Kind(int(self._kinds[number])),
                    diameters_m[number],
                    sigmas_m[number],
                    str(self._identities[number]),
                ),
                place,
                covariance,
                int(self._num_sightings[number]),
                float(1.0 - self._misses[number]),
            )
            for number, place, covariance in zip(numbers, places, covariances, strict=True)
            if is_in_map[number]
        )

    def _diameters(self, landmarks: IntArray) -> tuple[FloatArray, FloatArray]:
        """(k,) means and sigmas, NaN where none was perceived."""
        weights = self._diameter_weights[landmarks]
        known = weights > 0.0
        sigmas_m = np.where(known, 1.0 / np.sqrt(np.where(known, weights, 1.0)), np.nan)
        return np.where(known, self._diameters_m[landmarks], np.nan), sigmas_m
