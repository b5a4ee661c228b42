"""What really was: for judging only. No estimator, detector or pipeline may import this file."""

from dataclasses import dataclass, field

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from sensors.measurements import Recording


@dataclass(frozen=True, slots=True, eq=False)
class TruePath:
    """Reference positions over time.

    Attributes:
        stamps_ns: (n,), strictly increasing.
        world_t_reference: (n, 2) m, of the point `base_t_reference` of the vehicle.
        headings: (n,) rad, or None where only positions are known (GNSS).
        base_t_reference: (2,) m, e.g. the antenna's place on the vehicle.
        has_outliers: the reference itself jumps now and then, so that medians say more than means.
        sigma_m: the reference's own standard deviation of one axis; 0 where it is negligible.
    """

    stamps_ns: IntArray
    world_t_reference: FloatArray
    headings: FloatArray | None = None
    base_t_reference: FloatArray = field(default_factory=lambda: np.zeros(2))
    has_outliers: bool = False
    sigma_m: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        object.__setattr__(self, "stamps_ns", frozen_ints("truth stamps", self.stamps_ns, (n,)))
        positions = frozen_floats("truth positions", self.world_t_reference, (n, 2))
        object.__setattr__(self, "world_t_reference", positions)
        offset = frozen_floats("truth reference point", self.base_t_reference, (2,))
        object.__setattr__(self, "base_t_reference", offset)
        if not 0.0 <= self.sigma_m < np.inf:
            raise InputError(f"truth: expected sigma_m of at least 0, got {self.sigma_m}")
        if self.headings is not None:
            headings = frozen_floats("truth headings", self.headings, (n,))
            object.__setattr__(self, "headings", headings)


@dataclass(frozen=True, slots=True, eq=False)
class TrueLandmarks:
    """Where the landmarks really stand.

    Attributes:
        world_t_landmarks: (m, 2) m.
        kinds: (m,) codes of `semgraph.landmarks.Kind`.
        diameters_m: (m,), NaN where unknown.
    """

    world_t_landmarks: FloatArray
    kinds: IntArray
    diameters_m: FloatArray

    def __post_init__(self) -> None:
        m = len(self.world_t_landmarks)
        positions = frozen_floats("true landmarks", self.world_t_landmarks, (m, 2))
        object.__setattr__(self, "world_t_landmarks", positions)
        object.__setattr__(self, "kinds", frozen_ints("true kinds", self.kinds, (m,)))
        diameters_m = frozen_floats("true diameters", self.diameters_m, (m,), finite=False)
        object.__setattr__(self, "diameters_m", diameters_m)


@dataclass(frozen=True, slots=True)
class Truth:
    """What is known of a recording's truth; None where it is not known.

    `associations` maps the stamp of a set of perceptions to (n,) rows of `landmarks`, -1 for
    clutter; the stamp of a scan or image to the rows that are clearly in sight.
    `landmarks` are those that stand at the end, `felled` those that stood before; `walked` (n, 2)
    is where somebody walked, in world.
    """

    path: TruePath | None = None
    landmarks: TrueLandmarks | None = None
    associations: dict[int, IntArray] | None = None
    felled: TrueLandmarks | None = None
    walked: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Source:
    """A recording, and apart from it its truth."""

    recording: Recording
    truth: Truth
