"""What a filter may need beside the scan."""

from dataclasses import dataclass

import numpy as np

from semgraph.errors import InputError
from sensors.measurements import Tilt


@dataclass(frozen=True, slots=True)
class ScanContext:
    """What is known of base at the time of a scan; None where nothing tells it.

    Attributes:
        twist: (vx, vy, omega) of base in its own frame, m/s and rad/s.
        tilt: base's roll and pitch.

    Raises:
        InputError: the twist is not finite.
    """

    twist: tuple[float, float, float] | None = None
    tilt: Tilt | None = None

    def __post_init__(self) -> None:
        if self.twist is not None and not np.isfinite(self.twist).all():
            raise InputError(f"scan context: expected a finite vx, vy, omega, got {self.twist}")


UNKNOWN = ScanContext()
