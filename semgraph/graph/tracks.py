"""One object while it stays in sight: a stretch of sightings, and whether it stays in its place."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.landmarks import Perceptions
from semgraph.measurement_model import CHI2_2DOF_999, mahalanobis2

# What the estimate of the pose may err while the object is in sight.
_DRIFT_M: Final = 0.05
_SPAN_NS: Final = 2_000_000_000
_GAP_NS: Final = 500_000_000
_LOOKS: Final = 5
_MOVED_LOOKS: Final = 3


@dataclass(slots=True)
class Track:
    """What the fast estimator follows under one number since `first_ns`, and what it is.

    Attributes:
        number: of the track, in the order of their beginnings.
        landmark: of the graph, which the track is taken to show.
        known: of that landmark.
        own: what this track alone says of it; the same as long as no other shows it.
    """

    number: int
    landmark: int
    known: GraphLandmark
    first_ns: int
    own: GraphLandmark = field(init=False)
    last_scan: int = -1
    tested: int = 0
    is_moving: bool = False
    _last_ns: int = field(init=False)
    _places: list[tuple[int, FloatArray, FloatArray]] = field(default_factory=list)
    _away: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        self._last_ns = self.first_ns
        self.own = self.known

    def part(self) -> None:
        """Other tracks are to show its landmark too."""
        if self.own is self.known:
            self.own = self.known.copy()

    def join(self) -> None:
        """Others have shown its landmark, it did not as yet."""
        known = self.known
        # Whether it is there is no matter of tracks.
        self.own = GraphLandmark(known.kind, known.identity, existence=known.existence)

    @property
    def is_due(self) -> bool:
        """Whether there is so much new evidence that looking for older selves may pay.

        Of what has an identity there are none: whenever that is read it is the same landmark.
        """
        return not self.known.identity and self.known.num_sightings > 1.3 * self.tested

    def sight(self, scan: int, perceptions: Perceptions, row: int) -> None:
        """It is sighted in its place; of a gap before that only half a second counts as stayed."""
        stayed_ns = min(perceptions.stamp_ns - self._last_ns, _GAP_NS)
        for known in (self.known,) if self.own is self.known else (self.own, self.known):
            known.sight(scan, perceptions, row)
            known.stayed_ns += stayed_ns
        self._last_ns = perceptions.stamp_ns
        self.last_scan = scan

    def look(self, stamp_ns: int, odom_t_thing: FloatArray, covariance: FloatArray) -> bool:
        """Whether it is perceived away from where it was up to 2 s before.

        Args:
            stamp_ns: of the perception.
            odom_t_thing: (2,) m in the frame that drifts but does not jump.
            covariance: (2, 2) m2 of it.
        """
        return bool(mahalanobis2(*self.moved(stamp_ns, odom_t_thing, covariance)) > CHI2_2DOF_999)

    def moved(
        self, stamp_ns: int, odom_t_thing: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """How far (2,) m it is from where it was up to 2 s before, and the (2, 2) m2 of that.

        As `look`, for many tracks to be judged at once.
        """
        self._places.append((stamp_ns, odom_t_thing, covariance))
        while stamp_ns - self._places[0][0] > _SPAN_NS:
            del self._places[0]
        _, before, its_covariance = self._places[0]
        outline2 = self.known.outline_sigma_m() ** 2
        S = covariance + its_covariance + (_DRIFT_M**2 + 2.0 * outline2) * np.eye(2)
        return odom_t_thing - before, S

    def note(self, *, is_away: bool) -> None:
        """What is away in 3 of 5 looks moves."""
        self._away = (*self._away, is_away)[-_LOOKS:]
        self.is_moving = self.is_moving or sum(self._away) >= _MOVED_LOOKS

    def rest(self, now_ns: int) -> bool:
        """Whether it is out of sight for so long that its looks say nothing more; they are gone.

        There are hundreds of thousands of tracks, and each look keeps what was perceived with it.
        """
        if self._places and now_ns - self._places[-1][0] <= _SPAN_NS:
            return False
        self._places, self._away = [], ()
        return True
