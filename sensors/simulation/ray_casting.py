"""What a point light sees of circles in the plane, exactly and all at once."""

from dataclasses import dataclass

import numpy as np

from semgraph.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Arcs:
    """The visible pieces of circles, by angle.

    Attributes:
        owners: (k,) rows of the circles.
        starts, ends: (k,) rad, start < end.
    """

    owners: IntArray
    starts: FloatArray
    ends: FloatArray


def ragged_ranges(starts: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """Rows and values of starts[i], starts[i] + 1, ... (counts[i] of them), one after the other."""
    rows = np.repeat(np.arange(len(starts)), counts)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    return rows, starts[rows] + within


def chord_ranges(distances_m: FloatArray, radii_m: FloatArray, offsets: FloatArray) -> FloatArray:
    """Range to a circle along rays `offsets` rad off its centre."""
    half_chords_sq = radii_m**2 - (distances_m * np.sin(offsets)) ** 2
    return distances_m * np.cos(offsets) - np.sqrt(np.maximum(half_chords_sq, 0.0))


def visible_arcs(distances_m: FloatArray, bearings: FloatArray, radii_m: FloatArray) -> Arcs:
    """What the origin sees of circles that do not overlap.

    Between two neighbouring tangents of all the circles the nearest one stays the same: so it is
    asked once per such interval, at its middle.

    Args:
        distances_m: (n,) of the centres, above the radii.
        bearings: (n,) of the centres; angles do not wrap.
        radii_m: (n,).
    """
    halves = np.arcsin(radii_m / distances_m)
    tangents = np.sort(np.concatenate([bearings - halves, bearings + halves]))
    first = np.searchsorted(tangents, bearings - halves)
    circles, intervals = ragged_ranges(first, np.searchsorted(tangents, bearings + halves) - first)
    middles = 0.5 * (tangents[intervals] + tangents[intervals + 1])
    ranges_m = chord_ranges(distances_m[circles], radii_m[circles], middles - bearings[circles])

    # Written far to near: the nearest is written last.
    far_to_near = np.argsort(-ranges_m)
    nearest = np.full(max(len(tangents) - 1, 0), -1)
    nearest[intervals[far_to_near]] = circles[far_to_near]

    changes = np.flatnonzero(np.diff(nearest, prepend=-2, append=-2))
    owners = nearest[changes[:-1]] if len(nearest) else nearest
    arcs = Arcs(owners, tangents[changes[:-1]], tangents[changes[1:]])
    seen = (arcs.owners >= 0) & (arcs.ends > arcs.starts)
    return Arcs(arcs.owners[seen], arcs.starts[seen], arcs.ends[seen])


def mean_ranges(
    distances_m: FloatArray, radii_m: FloatArray, starts: FloatArray, ends: FloatArray
) -> FloatArray:
    """Range to a circle, averaged over offsets from `starts` to `ends` off its centre.

    With u = distance sin(offset) the half chord sqrt(R^2 - u^2) has a closed integral, also at the
    tangent where its slope has none.
    """
    us = distances_m * np.sin(starts), distances_m * np.sin(ends)
    areas = [
        0.5
        * (u * np.sqrt(np.maximum(radii_m**2 - u**2, 0.0)) + radii_m**2 * np.arcsin(u / radii_m))
        for u in (np.clip(u, -radii_m, radii_m) for u in us)
    ]
    widths = np.maximum(us[1] - us[0], 1e-12)
    middles = 0.5 * (starts + ends)
    along = distances_m * np.sinc((ends - starts) / (2.0 * np.pi)) * np.cos(middles)
    half_chords: FloatArray = (areas[1] - areas[0]) / widths
    return along - half_chords
