"""Pieces of a scan that may be trunks."""

import numpy as np

from detectors.scan_segments import Segments, cut_scan
from detectors.tree_settings import TreeSettings
from detectors.trunk_fit import apparent_diameters
from semgraph.arrays import BoolArray, FloatArray
from sensors.measurements import LaserScan, ScannerGeometry


def trunk_candidates(
    scan: LaserScan, settings: TreeSettings
) -> tuple[Segments, BoolArray, FloatArray]:
    """Segments in counter-clockwise order, their free edges (2, k), apparent diameters (k,) m.

    An edge is free if what is beyond it is farther: it is then the outline of the thing itself.
    """
    segments = cut_scan(counter_clockwise(scan), settings)
    if not len(segments.counts):
        return segments, np.zeros((2, 0), dtype=bool), np.zeros(0)
    increment = abs(scan.geometry.angle_increment)
    diameters_m = apparent_diameters(segments, increment, settings)
    fronts_m = np.minimum.reduceat(segments.ranges_m, segments.starts)
    depths_m = np.maximum.reduceat(segments.ranges_m, segments.starts) - fronts_m
    free = segments.steps_m > settings.free_edge_step_m
    wide_enough = (diameters_m > 0.35 * settings.diameter_min_m) | ~free.all(axis=0)
    kept = (
        free.any(axis=0)
        & ((segments.counts >= settings.min_beams) | _stands_alone(segments, settings))
        & wide_enough
        & (diameters_m < 1.35 * settings.diameter_max_m)
        & (depths_m < 0.5 * diameters_m + 0.12 + 0.25 * settings.beam_divergence * fronts_m)
    )
    return segments.select(kept), free[:, kept], diameters_m[kept]


def _stands_alone(segments: Segments, settings: TreeSettings) -> BoolArray:
    """(k,) all else is far behind, or with two beams and more, something nearer hides one edge."""
    hidden = np.isneginf(segments.steps_m) & (segments.counts >= 2)
    first, last = (segments.steps_m > settings.isolated_step_m) | hidden
    alone: BoolArray = first & last
    return alone


def counter_clockwise(scan: LaserScan) -> LaserScan:
    """The scan with its beams in the order of increasing angle."""
    geometry = scan.geometry
    if geometry.angle_increment > 0.0:
        return scan
    last = geometry.angle_min + (len(scan.ranges_m) - 1) * geometry.angle_increment
    turned = ScannerGeometry(
        last,
        -geometry.angle_increment,
        geometry.range_min_m,
        geometry.range_max_m,
        geometry.base_T_laser,
    )
    return LaserScan(scan.stamp_ns, turned, scan.ranges_m[::-1])
