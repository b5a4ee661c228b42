"""Trees in the plane of a laser scanner, by range and both edges of a trunk together."""

from typing import Final, final

import numpy as np

from detectors.detector import DetectorType
from detectors.tree_settings import TreeSettings
from detectors.trunk_candidates import counter_clockwise, trunk_candidates
from detectors.trunk_fit import Circles, fit_circles
from detectors.trunk_reliability import trunk_reliabilities
from semgraph.arrays import FloatArray
from semgraph.geometry import wrap_angle
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import LaserScan


@final
class TreeDetector:
    """Breakpoints, then a joint fit of ranges and edges through the beam's footprint."""

    def __init__(self, settings: TreeSettings) -> None:
        self._settings: Final = settings

    def detect(self, scan: LaserScan) -> Perceptions:
        """Trees relative to the laser: centre, diameter, covariance, reliability."""
        increment = abs(scan.geometry.angle_increment)
        segments, free, diameters_m = trunk_candidates(scan, self._settings)
        if not len(diameters_m):
            return Perceptions.from_arrays(
                scan.stamp_ns, Kind.TREE, np.zeros(0), np.zeros(0), np.zeros((0, 2, 2))
            )
        circles = fit_circles(segments, free, diameters_m, increment, self._settings)
        reliabilities = trunk_reliabilities(segments, free, circles, increment)
        return self._perceptions(scan, circles, reliabilities)

    def _perceptions(
        self, scan: LaserScan, circles: Circles, reliabilities: FloatArray
    ) -> Perceptions:
        settings = self._settings
        diameters_m = 2.0 * circles.radii_m
        kept = (
            (circles.misfits < settings.max_misfit)
            & (diameters_m > settings.diameter_min_m)
            & (diameters_m < settings.diameter_max_m)
            & (reliabilities >= settings.min_reliability)
        )
        first = counter_clockwise(scan).geometry.angle_min
        return Perceptions.from_arrays(
            scan.stamp_ns,
            Kind.TREE,
            circles.distances_m[kept],
            wrap_angle(first + circles.bearings[kept]),
            circles.covariances[kept, :2, :2],
            diameters_m=diameters_m[kept],
            diameter_sigmas_m=2.0 * np.sqrt(circles.covariances[kept, 2, 2]),
            reliabilities=reliabilities[kept],
            common_shares=np.full(kept.sum(), settings.common_share),
        )


TREES = DetectorType(TreeSettings, TreeDetector)
