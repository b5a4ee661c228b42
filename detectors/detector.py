"""The protocol that every detector keeps, and what the catalog knows of one."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from pydantic import BaseModel

from semgraph.landmarks import Perceptions
from sensors.measurements import LaserScan


class Detector(Protocol):
    """Finds one kind of landmark in one class of sensor. It never sees the map.

    Implementations are final classes built from frozen settings.
    """

    def detect(self, scan: LaserScan) -> Perceptions:
        """Perceptions relative to the *sensor*, stamped as the scan. No return is no perception."""
        ...


@dataclass(frozen=True, slots=True)
class DetectorType:
    """A kind of detector: its settings (a frozen pydantic model with defaults) and how to build it.

    An entry point of the group `semgraph.detectors` names one of these.
    """

    settings: type[BaseModel]
    build: Callable[[Any], Detector]
