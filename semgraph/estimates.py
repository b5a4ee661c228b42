"""What estimators give back: a pose or the reason why there is none, and trajectories."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from semgraph.geometry import Pose2, wrap_angle


class NoEstimateReason(Enum):
    """Why a pose could not be estimated from what was perceived."""

    NO_PERCEPTIONS = "nothing was perceived"
    TOO_FEW_MATCHES = "fewer than two perceptions match the map"
    DEGENERATE_GEOMETRY = "the matched landmarks stand too close together to give a heading"
    CONTRADICTORY_MATCHES = "the matches do not agree on one rigid motion"


@dataclass(frozen=True, slots=True)
class NoEstimate:
    """The typed absence of an estimate."""

    reason: NoEstimateReason


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses over time, stamps strictly increasing.

    Attributes:
        stamps_ns: (n,).
        map_T_bases: (n, 3) x, y, theta.

    Raises:
        InputError: shapes disagree, not finite, or times that do not increase.
    """

    stamps_ns: IntArray
    map_T_bases: FloatArray

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        stamps_ns = frozen_ints("trajectory stamps", self.stamps_ns, (n,))
        map_T_bases = frozen_floats("trajectory poses", self.map_T_bases, (n, 3))
        if n and not (np.diff(stamps_ns) > 0).all():
            raise InputError("trajectory: expected strictly increasing stamps")
        object.__setattr__(self, "stamps_ns", stamps_ns)
        object.__setattr__(self, "map_T_bases", map_T_bases)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def interpolate(self, stamps_ns: IntArray) -> FloatArray:
        """(m, 3) poses at other times, linear in x, y and the unwrapped heading.

        Raises:
            InputError: a time lies outside the trajectory; the nearest pose would be a guess.
        """
        inside = (stamps_ns >= self.stamps_ns[0]) & (stamps_ns <= self.stamps_ns[-1])
        if not inside.all():
            raise InputError("trajectory: asked for a pose outside its time span")
        since_start = (self.stamps_ns - self.stamps_ns[0]).astype(np.float64)
        at = (stamps_ns - self.stamps_ns[0]).astype(np.float64)
        x, y = (np.interp(at, since_start, self.map_T_bases[:, axis]) for axis in (0, 1))
        theta = np.interp(at, since_start, np.unwrap(self.map_T_bases[:, 2]))
        return np.column_stack([x, y, wrap_angle(theta)])

    def pose(self, k: int) -> Pose2:
        """map_T_base of row `k`."""
        return Pose2.from_array(self.map_T_bases[k])
