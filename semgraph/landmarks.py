"""The semantic world model's objects (paper, Fig. 2).

A semantic object is a tree, a rock or a marker with a reliability. Two specialisations: a
*landmark* has a position in the map, a *perception* a range and a bearing from the robot.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from semgraph.geometry import Pose2, frozen_covariance, rotation, wrap_angle

LEAST_RANGE_M: Final = 1e-3


class Kind(IntEnum):
    """What a semantic object is. The numbers are codes in arrays; files use the names."""

    TREE = 0
    ROCK = 1
    MARKER = 2

    @property
    def label(self) -> str:
        """The name in files: tree, rock, marker."""
        return self.name.lower()

    @classmethod
    def from_label(cls, label: str) -> Self:
        """The kind of a name in a file.

        Raises:
            InputError: unknown name.
        """
        try:
            return cls[label.strip().upper()]
        except KeyError:
            known = ", ".join(kind.label for kind in cls)
            raise InputError(f"kind: expected one of {known}, got {label!r}") from None


@dataclass(frozen=True, slots=True)
class Diameter:
    """A trunk's or rock's diameter with its standard deviation.

    Raises:
        InputError: not positive or not finite.
    """

    mean_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        if not (0.0 < self.mean_m < np.inf and 0.0 < self.sigma_m < np.inf):
            raise InputError(f"diameter: expected positive mean and sigma, got {self}")


@dataclass(frozen=True, slots=True)
class Tree:
    """A trunk; the position is its centre at the height of the sensor."""

    diameter: Diameter | None = None
    identity: str = ""
    kind: Kind = field(default=Kind.TREE, init=False)


@dataclass(frozen=True, slots=True)
class Rock:
    """A rock; the position is its centre."""

    diameter: Diameter | None = None
    identity: str = ""
    kind: Kind = field(default=Kind.ROCK, init=False)


@dataclass(frozen=True, slots=True)
class Marker:
    """An artificial marker, reflecting or optical; optical ones can be told apart by identity."""

    diameter: Diameter | None = None
    identity: str = ""
    kind: Kind = field(default=Kind.MARKER, init=False)


SemanticObject = Tree | Rock | Marker
_CLASSES: dict[Kind, type[Tree] | type[Rock] | type[Marker]] = {
    Kind.TREE: Tree,
    Kind.ROCK: Rock,
    Kind.MARKER: Marker,
}


def semantic_object(
    kind: Kind, diameter_m: float = np.nan, diameter_sigma_m: float = np.nan, identity: str = ""
) -> SemanticObject:
    """The tree, rock or marker of the columns in arrays and files; NaN means no diameter."""
    diameter = (
        None if np.isnan(diameter_m) else Diameter(float(diameter_m), float(diameter_sigma_m))
    )
    return _CLASSES[kind](diameter=diameter, identity=identity)


@dataclass(frozen=True, slots=True, eq=False)
class Landmark:
    """A semantic object of the navigation map.

    `map_t_landmark` (2,) m with its `covariance` (2, 2) in map; `num_sightings` is the paper's
    sighting counter; `reliability` in [0, 1].
    """

    id: int
    semantics: SemanticObject
    map_t_landmark: FloatArray
    covariance: FloatArray
    num_sightings: int
    reliability: float

    def __post_init__(self) -> None:
        position = frozen_floats("landmark position", self.map_t_landmark, (2,))
        covariance = frozen_covariance("landmark covariance", self.covariance, 2)
        object.__setattr__(self, "map_t_landmark", position)
        object.__setattr__(self, "covariance", covariance)
        if not 0.0 <= self.reliability <= 1.0:
            raise InputError(f"reliability: expected 0 to 1, got {self.reliability}")


@dataclass(frozen=True, slots=True)
class Gone:
    """A landmark that was there once, and in how many looks at its place it then was not."""

    landmark: Landmark
    num_misses: int


@dataclass(frozen=True, slots=True, eq=False)
class Perception:
    """A semantic object as perceived now: range and bearing to its centre, from base.

    `covariance` (2, 2) has the order (range, bearing), m and rad.
    """

    semantics: SemanticObject
    range_m: float
    bearing: float
    covariance: FloatArray
    reliability: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Perceptions:
    """All perceptions of one moment, as a structure of arrays. Iterating gives `Perception`s.

    Attributes:
        stamp_ns: when they were perceived.
        kinds: (n,) codes of `Kind`.
        ranges_m: (n,) to the centre, 1 mm or more: nearer there is no bearing.
        bearings: (n,) rad, 0 ahead, counter-clockwise.
        covariances: (n, 2, 2) of (range, bearing).
        diameters_m, diameter_sigmas_m: (n,) NaN where there is none.
        identities: (n,) text, empty where there is none.
        reliabilities: (n,) in [0, 1].
        common_shares: (n,) in [0, 1], of the range's variance: what all sightings of the thing have
            in common, from whichever side.

    Raises:
        InputError: shapes disagree, or a value is out of its domain.
    """

    stamp_ns: int
    kinds: IntArray
    ranges_m: FloatArray
    bearings: FloatArray
    covariances: FloatArray
    diameters_m: FloatArray
    diameter_sigmas_m: FloatArray
    identities: NDArray[np.str_]
    reliabilities: FloatArray
    common_shares: FloatArray

    def __post_init__(self) -> None:
        n = len(self.ranges_m)
        checked = {
            "kinds": frozen_ints("kinds", self.kinds, (n,)),
            "ranges_m": frozen_floats("ranges", self.ranges_m, (n,)),
            "bearings": frozen_floats("bearings", self.bearings, (n,)),
            "covariances": frozen_floats("covariances", self.covariances, (n, 2, 2)),
            "diameters_m": frozen_floats("diameters", self.diameters_m, (n,), finite=False),
            "diameter_sigmas_m": frozen_floats(
                "diameter sigmas", self.diameter_sigmas_m, (n,), finite=False
            ),
            "reliabilities": frozen_floats("reliabilities", self.reliabilities, (n,)),
            "common_shares": frozen_floats("common shares", self.common_shares, (n,)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        self._check_domains()

    def _check_domains(self) -> None:
        variances = self.covariances[:, [0, 1], [0, 1]]
        upper, lower = self.covariances[:, 0, 1], self.covariances[:, 1, 0]
        products = variances.prod(axis=1)
        has_diameter = ~np.isnan(self.diameters_m)
        diameters = self.diameters_m[has_diameter]
        sigmas = self.diameter_sigmas_m[has_diameter]
        rules = {
            "kinds: expected codes of Kind": _CLASSES.keys() >= set(self.kinds.tolist()),
            "ranges: expected 1 mm or more": (self.ranges_m >= LEAST_RANGE_M).all(),
            "covariances: expected symmetric positive definite": (variances > 0.0).all()
            and (products > upper * lower).all()
            and ((upper - lower) ** 2 <= 1e-12 * products).all(),
            "diameters: expected positive with a positive sigma": (diameters > 0.0).all()
            and np.isfinite(diameters).all()
            and (sigmas > 0.0).all()
            and np.isfinite(sigmas).all(),
            "reliabilities: expected 0 to 1": (
                (self.reliabilities >= 0.0) & (self.reliabilities <= 1.0)
            ).all(),
            "common shares: expected 0 to 1": (
                (self.common_shares >= 0.0) & (self.common_shares <= 1.0)
            ).all(),
            "identities: expected one text each": self.identities.shape == self.ranges_m.shape,
        }
        for rule, holds in rules.items():
            if not holds:
                raise InputError(rule)

    def __len__(self) -> int:
        return len(self.ranges_m)

    def __iter__(self) -> Iterator[Perception]:
        for k in range(len(self)):
            yield Perception(
                self.semantics(k),
                float(self.ranges_m[k]),
                float(self.bearings[k]),
                self.covariances[k],
                float(self.reliabilities[k]),
            )

    def semantics(self, k: int) -> SemanticObject:
        """What perception `k` is: its kind, diameter and identity."""
        return semantic_object(
            Kind(self.kinds[k]),
            self.diameters_m[k],
            self.diameter_sigmas_m[k],
            str(self.identities[k]),
        )

    @classmethod
    def from_arrays(
        cls,
        stamp_ns: int,
        kind: Kind | IntArray,
        ranges_m: FloatArray,
        bearings: FloatArray,
        covariances: FloatArray,
        *,
        diameters_m: FloatArray | None = None,
        diameter_sigmas_m: FloatArray | None = None,
        identities: NDArray[np.str_] | None = None,
        reliabilities: FloatArray | None = None,
        common_shares: FloatArray | None = None,
    ) -> Self:
        """Perceptions of the arrays at hand; what is left out is absent.

        Reliabilities are 1 then, and no errors are common.
        """
        n = len(ranges_m)
        nothing = np.full(n, np.nan)
        return cls(
            stamp_ns,
            np.full(n, kind) if isinstance(kind, Kind) else kind,
            ranges_m,
            bearings,
            covariances,
            nothing if diameters_m is None else diameters_m,
            nothing if diameter_sigmas_m is None else diameter_sigmas_m,
            np.full(n, "", dtype=np.str_) if identities is None else identities,
            np.ones(n) if reliabilities is None else reliabilities,
            np.zeros(n) if common_shares is None else common_shares,
        )

    def select(self, rows: NDArray[np.bool_] | IntArray) -> "Perceptions":
        """The perceptions of a mask or of indices."""
        return Perceptions(
            self.stamp_ns,
            self.kinds[rows],
            self.ranges_m[rows],
            self.bearings[rows],
            self.covariances[rows],
            self.diameters_m[rows],
            self.diameter_sigmas_m[rows],
            self.identities[rows],
            self.reliabilities[rows],
            self.common_shares[rows],
        )

    def base_t_landmarks(self) -> FloatArray:
        """(n, 2) m, the positions relative to the robot."""
        return cartesian(self.ranges_m, self.bearings)

    def base_covariances(self) -> FloatArray:
        """(n, 2, 2) m2, the covariances of `base_t_landmarks`, to first order."""
        jacobians = cartesian_jacobians(self.ranges_m, self.bearings)
        return jacobians @ self.covariances @ jacobians.transpose(0, 2, 1)

    def seen_from(self, base_T_sensor: Pose2) -> "Perceptions":
        """Perceptions relative to the sensor, as seen from base.

        Positions are exact; covariances are carried to first order. A landmark nearer to base
        than 1 mm has no bearing and is left out.
        """
        if base_T_sensor == Pose2():
            return self
        base_t_landmarks = base_T_sensor.transform(self.base_t_landmarks())
        R = rotation(base_T_sensor.theta)
        covariances = R @ self.base_covariances() @ R.T
        ranges_m = np.linalg.norm(base_t_landmarks, axis=1)
        kept = ranges_m >= LEAST_RANGE_M
        bearings = np.arctan2(base_t_landmarks[:, 1], base_t_landmarks[:, 0])
        inverse = np.linalg.inv(cartesian_jacobians(ranges_m[kept], bearings[kept]))
        rest = self.select(kept)
        return Perceptions(
            rest.stamp_ns,
            rest.kinds,
            ranges_m[kept],
            wrap_angle(bearings[kept]),
            inverse @ covariances[kept] @ inverse.transpose(0, 2, 1),
            rest.diameters_m,
            rest.diameter_sigmas_m,
            rest.identities,
            rest.reliabilities,
            rest.common_shares,
        )


def polar_covariances(range_sigmas_m: FloatArray, bearing_sigmas: FloatArray) -> FloatArray:
    """(n, 2, 2) of (range, bearing) for independent sigmas (n,), m and rad."""
    covariances = np.zeros((len(range_sigmas_m), 2, 2))
    covariances[:, 0, 0] = range_sigmas_m**2
    covariances[:, 1, 1] = bearing_sigmas**2
    return covariances


def concatenate(stamp_ns: int, parts: Sequence[Perceptions]) -> Perceptions:
    """The perceptions of several sensors at one moment, in one value."""
    none = Perceptions.from_arrays(
        stamp_ns, Kind.TREE, np.zeros(0), np.zeros(0), np.zeros((0, 2, 2))
    )
    return Perceptions(
        stamp_ns,
        *(
            np.concatenate([getattr(part, name) for part in (none, *parts)])
            for name in Perceptions.__slots__[1:]
        ),
    )


def cartesian(ranges_m: FloatArray, bearings: FloatArray) -> FloatArray:
    """(n, 2) m of polar coordinates."""
    points = np.empty((len(ranges_m), 2))
    points[:, 0], points[:, 1] = ranges_m * np.cos(bearings), ranges_m * np.sin(bearings)
    return points


def cartesian_jacobians(ranges_m: FloatArray, bearings: FloatArray) -> FloatArray:
    """(n, 2, 2): d(x, y) / d(range, bearing)."""
    c, s = np.cos(bearings), np.sin(bearings)
    J = np.empty((len(ranges_m), 2, 2))
    J[:, 0, 0], J[:, 0, 1] = c, -ranges_m * s
    J[:, 1, 0], J[:, 1, 1] = s, ranges_m * c
    return J
