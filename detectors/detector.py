"""The protocol that every detector keeps, and what the catalog knows of one."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from pydantic import BaseModel

from semgraph.landmarks import Perceptions
from sensors.measurements import LaserScan, Raw

Looks = TypeVar("Looks", bound=Raw, contravariant=True)


class Detector(Protocol[Looks]):
    """Finds one kind of landmark in one class of sensor. It never sees the map.

    Implementations are final classes built from frozen settings.
    """

    def detect(self, measurement: Looks, /) -> Perceptions:
        """Perceptions relative to the *sensor*, stamped as what they were found in.

        Of what sees in three dimensions, relative to its point and heading in the plane.
        No return is no perception.
        """
        ...


@dataclass(frozen=True, slots=True)
class DetectorType:
    """A kind of detector: its settings (a frozen pydantic model with defaults) and how to build it.

    `looks_at` is the class of measurements that it takes. An entry point of the group
    `semgraph.detectors` names one of these.
    """

    settings: type[BaseModel]
    build: Callable[[Any], Detector[Any]]
    looks_at: type[Raw] = LaserScan
