"""A graph at one moment: where everything is, and all that going back to it takes."""

from dataclasses import dataclass, field

from semgraph.arrays import FloatArray, IntArray
from semgraph.graph.incremental import Incremental, Slots


@dataclass(frozen=True, slots=True, eq=False)
class GraphEstimate:
    """All variables at one moment.

    Attributes:
        map_T_bases: (n, 3), row k is pose k.
        map_t_landmarks: position (2,) by landmark.
    """

    map_T_bases: FloatArray
    map_t_landmarks: dict[int, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class AllSlots:
    """Where everything is in iSAM2."""

    holds: Slots = field(default_factory=Slots)
    motions: Slots = field(default_factory=Slots)
    sightings: Slots = field(default_factory=Slots)
    windows: Slots = field(default_factory=Slots)

    def copy(self) -> "AllSlots":
        """As they are now."""
        return AllSlots(
            Slots(self.holds),
            Slots(self.motions),
            Slots(self.sightings),
            Slots(self.windows),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A graph with nothing waiting, to go back to.

    Attributes:
        estimate: where everything is.
        isam, slots: copies.
        landmarks: (m,) of each sighting, as the log has them.
        num_windows: that were condensed.
        glimpsed: landmarks that were left out of those.
        num_choices: how often what rests was chosen before.
    """

    estimate: GraphEstimate
    isam: Incremental
    slots: AllSlots
    landmarks: IntArray
    num_windows: int
    glimpsed: frozenset[int]
    num_choices: int
