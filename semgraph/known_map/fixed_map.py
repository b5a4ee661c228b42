"""A map that is known before and does not change, as a structure of arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.constellations.mapped_constellation import Constellation
from semgraph.errors import InputError
from semgraph.landmarks import Kind, Landmark, Perceptions, semantic_object
from semgraph.navigation_map import NavigationMap

# How far the robot may be from the box about all landmarks.
_AROUND_M: Final = 5.0
# Surveyed landmarks are not surer than this.
_LEAST_VARIANCE: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class FixedMap:
    """Landmarks of a known map.

    Attributes:
        map_t_landmarks: (m, 2) m, m > 0.
        covariances: (m, 2, 2) m2, in map.
        kinds: (m,) codes of `Kind`.
        diameters_m, diameter_sigmas_m: (m,), NaN where unknown.
        identities: (m,) text, empty where there is none.

    Raises:
        InputError: no landmark, shapes disagree, or positions are not finite.
    """

    map_t_landmarks: FloatArray
    covariances: FloatArray
    kinds: IntArray
    diameters_m: FloatArray
    diameter_sigmas_m: FloatArray
    identities: NDArray[np.str_]

    def __post_init__(self) -> None:
        m = len(self.map_t_landmarks)
        if m == 0:
            raise InputError("map: expected at least one landmark, there is none")
        checked = {
            "map_t_landmarks": frozen_floats("map positions", self.map_t_landmarks, (m, 2)),
            "covariances": frozen_floats("map covariances", self.covariances, (m, 2, 2)),
            "kinds": frozen_ints("map kinds", self.kinds, (m,)),
            "diameters_m": frozen_floats("map diameters", self.diameters_m, (m,), finite=False),
            "diameter_sigmas_m": frozen_floats(
                "map diameter sigmas", self.diameter_sigmas_m, (m,), finite=False
            ),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.kinds)

    @classmethod
    def of_landmarks(cls, landmarks: Sequence[Landmark]) -> Self:
        """The same landmarks in arrays.

        Raises:
            InputError: there are none.
        """
        diameters = [each.semantics.diameter for each in landmarks]
        return cls(
            np.array([each.map_t_landmark for each in landmarks]).reshape(-1, 2),
            np.array([each.covariance for each in landmarks]).reshape(-1, 2, 2),
            np.array([each.semantics.kind for each in landmarks], dtype=np.int64),
            np.array([each.mean_m if each else np.nan for each in diameters]),
            np.array([each.sigma_m if each else np.nan for each in diameters]),
            np.array([each.semantics.identity for each in landmarks], dtype=np.str_),
        )

    def landmarks(self) -> tuple[Landmark, ...]:
        """The same as values, numbered by row."""
        return tuple(
            Landmark(
                row,
                semantic_object(
                    Kind(self.kinds[row]),
                    self.diameters_m[row],
                    self.diameter_sigmas_m[row],
                    str(self.identities[row]),
                ),
                self.map_t_landmarks[row],
                self.covariances[row],
                1,
                1.0,
            )
            for row in range(len(self))
        )

    def navigation_map(self) -> NavigationMap:
        """The same as a map to match with, numbered by row."""
        m = len(self)
        as_seen = Perceptions.from_arrays(
            0,
            self.kinds,
            np.ones(m),
            np.zeros(m),
            np.tile(np.eye(2), (m, 1, 1)),
            diameters_m=self.diameters_m,
            diameter_sigmas_m=self.diameter_sigmas_m,
            identities=self.identities,
        )
        made = NavigationMap()
        made.insert(as_seen, self.map_t_landmarks, self.covariances + _LEAST_VARIANCE * np.eye(2))
        return made

    def constellation(self) -> Constellation:
        """The same for constellation matching."""
        return Constellation(
            self.map_t_landmarks,
            self.covariances + _LEAST_VARIANCE * np.eye(2),
            self.kinds,
            self.diameters_m,
            self.diameter_sigmas_m,
            self.identities,
        )

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """(2,) lower and upper corner of the box where the robot may be."""
        low = self.map_t_landmarks.min(axis=0) - _AROUND_M
        high = self.map_t_landmarks.max(axis=0) + _AROUND_M
        return low, high

    @property
    def area_m2(self) -> float:
        """Of that box."""
        low, high = self.bounds()
        return float(np.prod(high - low))
