"""A laser scan cut into pieces that may each be one thing, and which of their edges are free."""

import math
from dataclasses import dataclass

import numpy as np

from detectors.tree_settings import TreeSettings
from semgraph.arrays import BoolArray, FloatArray, IntArray
from sensors.measurements import LaserScan


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Runs of beams (k of them), counter-clockwise.

    Attributes:
        beams: (n,) of all segments, one segment after the other.
        ranges_m: (n,).
        starts: (k,) where each segment begins in `beams`.
        counts: (k,) beams of each.
        steps_m: (2, k) how much farther the next beam is, beyond the first and the last beam of a
            segment; +inf where nothing returns, -inf outside the field or behind something nearer.
    """

    beams: IntArray
    ranges_m: FloatArray
    starts: IntArray
    counts: IntArray
    steps_m: FloatArray

    def select(self, kept: BoolArray) -> "Segments":
        """The segments of a mask (k,)."""
        of_kept = np.repeat(kept, self.counts)
        counts = self.counts[kept]
        return Segments(
            self.beams[of_kept],
            self.ranges_m[of_kept],
            np.cumsum(counts) - counts,
            counts,
            self.steps_m[:, kept],
        )


def cut_scan(scan: LaserScan, settings: TreeSettings) -> Segments:
    """Segments of the valid beams, cut where the range steps or beams are missing.

    Source: adaptive breakpoints, Borges and Aldon 2004: a surface steeper than `break_angle` to the
    beam is taken for two things.
    """
    ranges_m = scan.ranges_m
    near = max(scan.geometry.range_min_m, settings.range_min_m)
    far = min(scan.geometry.range_max_m, settings.range_max_m)
    beams = np.flatnonzero((ranges_m >= near) & (ranges_m <= far))
    valid_m = ranges_m[beams]
    if not len(beams):
        nothing = np.zeros(0, dtype=np.int64)
        return Segments(nothing, valid_m, nothing, nothing, np.zeros((2, 0)))

    increment = abs(scan.geometry.angle_increment)
    slope = math.sin(increment) / math.sin(max(settings.break_angle - increment, 0.5 * increment))
    nearer_m = np.minimum(valid_m[1:], valid_m[:-1])
    gaps_m = np.minimum(slope * nearer_m, settings.max_gap_m) + 3.0 * settings.range_sigma_m
    cut = (np.abs(np.diff(valid_m)) > gaps_m) | (np.diff(beams) > 2)
    starts = np.append(0, np.flatnonzero(cut) + 1)
    ends = np.append(starts[1:], len(beams)) - 1
    steps_m = _steps(ranges_m, near, beams[[starts, ends]], valid_m[[starts, ends]])
    return Segments(beams, valid_m, starts, ends - starts + 1, steps_m)


def _steps(
    ranges_m: FloatArray, near_m: float, edge_beams: IntArray, edge_ranges_m: FloatArray
) -> FloatArray:
    """(2, k) step from each edge to the nearer of the two beams beyond it."""
    beyond = np.full(len(ranges_m) + 4, np.inf)
    # A return from nearer than the field, or none that can be read, hides what is there.
    beyond[2:-2] = np.where(ranges_m >= near_m, ranges_m, -np.inf)
    beyond[[1, -2]] = -np.inf
    next_m = beyond[2 + edge_beams + [[-1], [1]]]
    second_m = beyond[2 + edge_beams + [[-2], [2]]]
    hidden = (second_m < edge_ranges_m - 0.05) & np.isfinite(second_m)
    steps_m: FloatArray = np.where(hidden, -np.inf, next_m - edge_ranges_m)
    return steps_m
