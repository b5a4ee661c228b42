"""Where a reflecting post stands between the beams, from where its light begins and ends.

A beam answers as soon as the rim of its footprint touches the post, and within a small share of
the footprint the intensity saturates. So which beams answer bounds the post's bearing, and a beam
that is not yet saturated at the rim tells it exactly.
"""

from dataclasses import dataclass

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray

SAME_SURFACE_M = 0.1
"""A dim beam belongs to a post if its range is that near to the bright ones'."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A scan's ranges (m,) and intensities (m,), the latter in shares of saturation."""

    ranges_m: FloatArray
    brightness: FloatArray


def beam_bounds(
    sweep: Sweep,
    ends: tuple[IntArray, IntArray],
    ranges_m: FloatArray,
    reaches: FloatArray,
    saturations: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Least and greatest beam number (n,), with fractions, of n posts; crossed if they disagree.

    Args:
        sweep: what the laser measured.
        ends: first and last bright beam of each post.
        ranges_m: (n,) of each post's face.
        reaches: (n,) beams from a post's centre to one whose footprint just touches it.
        saturations: (n,) beams of overlap at which the intensity saturates.
    """
    first, first_near, first_far = _side(sweep, ends[0], -1, ranges_m, reaches, saturations)
    last, last_near, last_far = _side(sweep, ends[1], 1, ranges_m, reaches, saturations)
    return (
        np.maximum(first + first_near, last - last_far),
        np.minimum(first + first_far, last - last_near),
    )


def _side(
    sweep: Sweep,
    ends: IntArray,
    step: int,
    ranges_m: FloatArray,
    reaches: FloatArray,
    saturations: FloatArray,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """The outermost beam (n,) that a post answers, and least and greatest way to the centre."""
    next_ranges_m, next_brightness = _at(sweep, ends + step)
    lit = (np.abs(next_ranges_m - ranges_m) <= SAME_SURFACE_M) & (next_brightness > 0.0)
    outer = np.where(lit, ends + step, ends)
    _, brightness = _at(sweep, outer)
    overlaps = np.minimum(brightness, 1.0) * saturations
    beyond_m, _ = _at(sweep, outer + step)
    is_dark: BoolArray = beyond_m > ranges_m + SAME_SURFACE_M
    unsaturated = np.where(is_dark, reaches - 1.0, -np.inf)
    return outer, np.where(brightness < 1.0, reaches - overlaps, unsaturated), reaches - overlaps


def _at(sweep: Sweep, beams: IntArray) -> tuple[FloatArray, FloatArray]:
    """Ranges and brightness of beams; NaN beyond the field."""
    inside = (beams >= 0) & (beams < len(sweep.ranges_m))
    within = np.where(inside, beams, 0)
    return (
        np.where(inside, sweep.ranges_m[within], np.nan),
        np.where(inside, sweep.brightness[within], np.nan),
    )
