"""A scan whose points were moved, as a scan on evenly spaced bearings again."""

from dataclasses import replace

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from sensors.measurements import LaserScan


def beam_bearings(scan: LaserScan) -> FloatArray:
    """(m,) rad in the laser frame, not wrapped."""
    geometry = scan.geometry
    return geometry.angle_min + geometry.angle_increment * np.arange(len(scan.ranges_m))


def has_point(ranges_m: FloatArray) -> BoolArray:
    """(m,) whether a range is a distance at all."""
    return np.asarray(np.isfinite(ranges_m) & (ranges_m > 0.0))


def resample(
    scan: LaserScan, ranges_m: FloatArray, shifts: FloatArray, max_step_m: float
) -> LaserScan:
    """What each beam of `scan` would have measured of points that have moved a little.

    Where both moved neighbours of a beam lie on one surface, its range is interpolated between
    them; at an edge, or where one is no return, the nearer one in bearing counts alone: a range
    between two things would be a point where nothing is. Beams beyond the first or last moved one
    saw nothing that is known: NaN.

    Args:
        scan: gives the bearings.
        ranges_m: (m,) of the moved points, not finite where there is none.
        shifts: (m,) rad that each point moved counter-clockwise.
        max_step_m: two neighbours with a larger step are two things.
    """
    m = len(ranges_m)
    if m < 2:
        return replace(scan, ranges_m=ranges_m)
    beams = np.arange(m)
    moved = beams + shifts / scan.geometry.angle_increment
    # A near point can overtake its neighbour; the beams between belong to both then.
    moved = np.maximum.accumulate(moved)
    before = np.clip(np.searchsorted(moved, beams, side="right") - 1, 0, m - 2)
    spans = np.maximum(moved[before + 1] - moved[before], 1e-9)
    weights = np.clip((beams - moved[before]) / spans, 0.0, 1.0)
    nearest = before + (weights > 0.5)
    one = np.where(has_point(ranges_m), ranges_m, np.nan)
    steps_m = one[before + 1] - one[before]
    between_m = (1.0 - weights) * one[before] + weights * one[before + 1]
    resampled_m = np.where(np.abs(steps_m) <= max_step_m, between_m, ranges_m[nearest])
    beyond = (beams < moved[0] - 0.5) | (beams > moved[-1] + 0.5)
    return replace(
        scan,
        ranges_m=np.where(beyond, np.nan, resampled_m),
        intensities=None if scan.intensities is None else scan.intensities[nearest],
    )
