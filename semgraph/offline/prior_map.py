"""A map from before: an earlier run's, or a list of stems with one sigma for all."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from semgraph.given_maps import MOST_LANDMARKS, read_given_map
from semgraph.landmarks import Landmark


@dataclass(frozen=True, slots=True, eq=False)
class PriorMap:
    """Landmarks as somebody had them before, each by itself.

    Attributes:
        names: (k) what the file calls each.
        kinds: (k,) codes of `Kind`.
        map_t_landmarks: (k, 2) m.
        covariances: (k, 2, 2) m2, positive definite.
        diameters_m, diameter_sigmas_m: (k,) NaN where unknown.
        identities: (k) text, empty where there is none.

    Raises:
        InputError: shapes disagree, or a value is out of its domain.
    """

    names: tuple[str, ...]
    kinds: IntArray
    map_t_landmarks: FloatArray
    covariances: FloatArray
    diameters_m: FloatArray
    diameter_sigmas_m: FloatArray
    identities: tuple[str, ...]

    def __post_init__(self) -> None:
        k = len(self.names)
        checked = {
            "kinds": frozen_ints("kinds", self.kinds, (k,)),
            "map_t_landmarks": frozen_floats("positions", self.map_t_landmarks, (k, 2)),
            "covariances": frozen_floats("covariances", self.covariances, (k, 2, 2)),
            "diameters_m": frozen_floats("diameters", self.diameters_m, (k,), finite=False),
            "diameter_sigmas_m": frozen_floats(
                "diameter sigmas", self.diameter_sigmas_m, (k,), finite=False
            ),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if not 0 < k <= MOST_LANDMARKS:
            raise InputError(f"expected 1 to {MOST_LANDMARKS} landmarks, got {k}")
        try:
            np.linalg.cholesky(self.covariances)
        except np.linalg.LinAlgError:
            raise InputError("expected positive definite covariances") from None

    def __len__(self) -> int:
        return len(self.names)

    def select(self, rows: IntArray) -> "PriorMap":
        """Some of the landmarks."""
        return PriorMap(
            tuple(self.names[row] for row in rows.tolist()),
            self.kinds[rows],
            self.map_t_landmarks[rows],
            self.covariances[rows],
            self.diameters_m[rows],
            self.diameter_sigmas_m[rows],
            tuple(self.identities[row] for row in rows.tolist()),
        )

    @classmethod
    def of_landmarks(cls, landmarks: Sequence[Landmark]) -> Self:
        """The landmarks of a run."""
        diameters = [each.semantics.diameter for each in landmarks]
        return cls(
            tuple(str(each.id) for each in landmarks),
            np.array([each.semantics.kind for each in landmarks], dtype=np.int64),
            np.array([each.map_t_landmark for each in landmarks]).reshape(-1, 2),
            np.array([each.covariance for each in landmarks]).reshape(-1, 2, 2),
            np.array([each.mean_m if each else np.nan for each in diameters]),
            np.array([each.sigma_m if each else np.nan for each in diameters]),
            tuple(each.semantics.identity for each in landmarks),
        )


def read_prior_map(path: Path, sigma_m: float) -> PriorMap:
    """All that `read_given_map` reads.

    Args:
        path: a file or folder.
        sigma_m: of one axis, of all landmarks of a list, which says nothing of it.

    Raises:
        InputError: unreadable, or nothing that a map may be.
    """
    landmarks = read_given_map(path, sigma_m)
    try:
        return PriorMap.of_landmarks(landmarks)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
