"""Landmarks of one frame as arrays, and what a map of them tells of its surroundings and sizes."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from semgraph.arrays import BoolArray, FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from semgraph.landmarks import Kind

_NUM_NEIGHBOURS: Final = 8
_NUM_QUANTILES: Final = 64


@dataclass(frozen=True, slots=True, eq=False)
class Constellation:
    """Landmarks in one frame, as a structure of arrays.

    Attributes:
        positions: (n, 2) m.
        covariances: (n, 2, 2) m2, each landmark's own in that frame.
        kinds: (n,) codes of `Kind`.
        diameters_m, diameter_sigmas_m: (n,) NaN where unknown.
        identities: (n,) text, empty where there is none.

    Raises:
        InputError: shapes disagree, or a value is out of its domain.
    """

    positions: FloatArray
    covariances: FloatArray
    kinds: IntArray
    diameters_m: FloatArray
    diameter_sigmas_m: FloatArray
    identities: NDArray[np.str_]

    def __post_init__(self) -> None:
        n = len(self.positions)
        checked = {
            "positions": frozen_floats("positions", self.positions, (n, 2)),
            "covariances": frozen_floats("covariances", self.covariances, (n, 2, 2)),
            "kinds": frozen_ints("kinds", self.kinds, (n,)),
            "diameters_m": frozen_floats("diameters", self.diameters_m, (n,), finite=False),
            "diameter_sigmas_m": frozen_floats(
                "diameter sigmas", self.diameter_sigmas_m, (n,), finite=False
            ),
            "identities": _frozen_texts(self.identities, n),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        self._check_domains()

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def variances(self) -> FloatArray:
        """(n,) m2, of the position per axis, on average over directions."""
        means: FloatArray = 0.5 * np.trace(self.covariances, axis1=1, axis2=2)
        return means

    def _check_domains(self) -> None:
        variances = self.covariances[:, [0, 1], [0, 1]]
        known = ~np.isnan(self.diameters_m)
        sizes = np.stack([self.diameters_m[known], self.diameter_sigmas_m[known]])
        rules = {
            "covariances: expected positive definite": (variances > 0.0).all()
            and (np.linalg.det(self.covariances) > 0.0).all(),
            "kinds: expected codes of Kind": np.isin(self.kinds, list(Kind)).all(),
            "diameters: expected positive with a positive sigma": (sizes > 0.0).all()
            and np.isfinite(sizes).all(),
        }
        for rule, holds in rules.items():
            if not holds:
                raise InputError(f"constellation {rule}")


@dataclass(frozen=True, slots=True, eq=False)
class MappedConstellation:
    """A map with what its landmarks' surroundings and sizes are like.

    Attributes:
        landmarks: of the map.
        tree: of their positions.
        spacings_m: (n,) within which there nearly always is a landmark, if there are any.
        densities: of each kind, per m2, around a typical landmark.
        area_m2: that the map covers.
        sizes: of each kind, quantiles of its diameters and their typical sigma, m.
    """

    landmarks: Constellation
    tree: KDTree
    spacings_m: FloatArray
    densities: dict[int, float]
    area_m2: float
    sizes: dict[int, tuple[FloatArray, float]]

    @classmethod
    def of(cls, landmarks: Constellation) -> Self:
        """What the landmarks of a map tell together."""
        tree = KDTree(landmarks.positions)
        areas_m2 = _areas_m2(tree)
        density = float(np.exp(-np.log(areas_m2).mean())) if len(landmarks) else 0.0
        kinds, counts = np.unique(landmarks.kinds, return_counts=True)
        shares = dict(zip(kinds.tolist(), (counts / len(landmarks)).tolist(), strict=True))
        return cls(
            landmarks,
            tree,
            # exp(-4): the share of a forest's circles of this radius that are empty.
            2.0 * np.sqrt(areas_m2 / np.pi),
            {kind: density * share for kind, share in shares.items()},
            float(areas_m2.sum()),
            {kind: _sizes(landmarks, landmarks.kinds == kind) for kind in shares},
        )


def surrounding_density(positions: FloatArray) -> float:
    """Landmarks per m2 around a typical one of (n, 2) positions, n > 1."""
    return float(np.exp(-np.log(_areas_m2(KDTree(positions))).mean()))


def _areas_m2(tree: KDTree) -> FloatArray:
    """(n,) of the ground that is each landmark's share, by the distance of its neighbours."""
    k = max(min(_NUM_NEIGHBOURS, tree.n - 1), 1)
    farthest_m = tree.query(tree.data, [k + 1])[0][:, 0]
    areas_m2: FloatArray = np.maximum(np.pi * farthest_m**2 / k, 1e-6)
    return areas_m2


def _sizes(landmarks: Constellation, chosen: BoolArray) -> tuple[FloatArray, float]:
    known = chosen & ~np.isnan(landmarks.diameters_m)
    if not known.any():
        return np.zeros(0), np.nan
    shares = (np.arange(_NUM_QUANTILES) + 0.5) / _NUM_QUANTILES
    quantiles_m = np.quantile(landmarks.diameters_m[known], shares)
    return quantiles_m, float(np.median(landmarks.diameter_sigmas_m[known]))


def _frozen_texts(values: NDArray[np.str_], n: int) -> NDArray[np.str_]:
    texts = np.array(values, dtype=np.str_)
    if texts.shape != (n,):
        raise InputError(f"identities: expected shape {(n,)}, got {texts.shape}")
    texts.flags.writeable = False
    return texts
