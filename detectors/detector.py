"""The protocol that every detector keeps."""

from typing import Protocol

from semgraph.landmarks import Perceptions
from sensors.measurements import LaserScan


class Detector(Protocol):
    """Finds one kind of landmark in one class of sensor. It never sees the map.

    Implementations are final classes built from frozen settings.
    """

    def detect(self, scan: LaserScan) -> Perceptions:
        """Perceptions relative to the *sensor*, stamped as the scan. No return is no perception."""
        ...
