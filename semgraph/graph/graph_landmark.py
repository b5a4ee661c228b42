"""What is known of a landmark of the graph beside its position, and what it may be one with."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from semgraph.graph.existence import Evidence, Existence
from semgraph.landmarks import Kind, Perceptions, SemanticObject, semantic_object
from semgraph.measurement_model import diameters_contradict
from semgraph.scan_set import ScanSet

# What the outline of even a round trunk leaves open of its centre.
_LEAST_OUTLINE_M: Final = 0.014


@dataclass(slots=True)
class GraphLandmark:
    """What is known of a landmark of the graph beside its position.

    `stayed_ns` is for how long it was seen to stay, without the time between.
    """

    kind: Kind
    identity: str
    scans: ScanSet = field(default_factory=ScanSet)
    stayed_ns: int = 0
    num_tracks: int = 1
    num_views: int = 0
    diameter_m: float = np.nan
    diameter_weight: float = 0.0
    num_diameters: int = 0
    evidence: Evidence = field(default_factory=Evidence)
    existence: Existence = field(default_factory=Existence)

    @property
    def num_sightings(self) -> int:
        """In how many scans it was sighted."""
        return len(self.scans)

    def copy(self) -> "GraphLandmark":
        """The same, to go on by itself; whether it is there stays one for both."""
        return replace(self, scans=self.scans.copy(), evidence=replace(self.evidence))

    def sight(self, scan: int, perceptions: Perceptions, row: int) -> None:
        """Counts a sighting and averages its attributes in."""
        self.scans.add(scan)
        self.evidence.look(float(perceptions.reliabilities[row]))
        diameter_m = float(perceptions.diameters_m[row])
        if np.isfinite(diameter_m):
            weight = float(perceptions.diameter_sigmas_m[row]) ** -2
            self.num_views = max(self.num_views, 1)
            self._average(diameter_m, weight, 1)

    def absorb(self, other: "GraphLandmark") -> None:
        """Takes over all that was known of another landmark which is the same object."""
        self.scans.update(other.scans)
        self.stayed_ns += other.stayed_ns
        self.num_tracks += other.num_tracks
        self.num_views += other.num_views
        self.evidence.absorb(other.evidence)
        self.existence.absorb(other.existence)
        if other.num_diameters > 0:
            self._average(other.diameter_m, other.diameter_weight, other.num_diameters)

    def may_be(self, other: "GraphLandmark") -> bool:
        """Whether nothing but the position could speak against both being one object."""
        if self.kind is not other.kind or self.identity != other.identity:
            return False
        if self.existence.is_gone or other.existence.is_gone:
            return False
        if not self.scans.isdisjoint(other.scans):
            return False
        return not diameters_contradict(*self.diameter(), *other.diameter())

    def semantics(self) -> SemanticObject:
        """The tree, rock or marker that it is."""
        return semantic_object(self.kind, *self.diameter(), self.identity)

    def diameter(self) -> tuple[float, float]:
        """Its mean and sigma in m, NaN where none was perceived.

        However often one side of a thing is perceived, it stays one side: only views from several
        tracks make the mean surer.
        """
        if self.num_diameters == 0:
            return np.nan, np.nan
        return self.diameter_m, self._diameter_sigma_m() * self.num_views**-0.5

    def outline_sigma_m(self) -> float:
        """How far its centre may seem off from one side: as far as its diameter seems wrong."""
        return max(_LEAST_OUTLINE_M, self._diameter_sigma_m() if self.num_diameters else 0.0)

    def _diameter_sigma_m(self) -> float:
        """Of one perception (the harmonic mean of the variances)."""
        return float((self.num_diameters / self.diameter_weight) ** 0.5)

    def _average(self, diameter_m: float, weight: float, count: int) -> None:
        self.num_diameters += count
        self.diameter_weight += weight
        before = self.diameter_m if self.num_diameters > count else diameter_m
        self.diameter_m = before + weight / self.diameter_weight * (diameter_m - before)
