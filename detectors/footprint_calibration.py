"""How wide a scanner's beam is, from scans of trunks alone."""

from collections.abc import Sequence

import numpy as np

from detectors.tree_settings import TreeSettings
from detectors.trunk_candidates import trunk_candidates
from detectors.trunk_fit import edge_offsets, fit_circles
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from sensors.measurements import LaserScan

MIN_TRUNKS = 100
_DIVERGENCES = np.arange(0.002, 0.032, 0.002)
_MIN_BEAMS = 4
_RANGES_M = (1.0, 8.0)
_MAX_EXCESS = 0.006


def calibrate_footprint(scans: Sequence[LaserScan], settings: TreeSettings) -> TreeSettings:
    """The settings with the beam divergence that these scans show.

    A trunk's front tells its diameter by its curvature, its edges by their distance, and only the
    second depends on the beam's width. With the right width the edges lie, on average, where the
    fit of both expects them. Diameters need not be known; poses neither.

    Args:
        scans: about 50 in a forest; more in a park.
        settings: all but `beam_divergence` is kept.

    Raises:
        InputError: fewer than `MIN_TRUNKS` free-standing trunks between 1 and 8 m, or no width
            between 2 and 30 mrad explains them.
    """
    per_divergence = [
        _edge_excesses(scans, settings.model_copy(update={"beam_divergence": float(divergence)}))
        for divergence in _DIVERGENCES
    ]
    num_trunks = max(len(excesses) for excesses in per_divergence)
    if num_trunks < MIN_TRUNKS:
        raise InputError(
            f"footprint: expected {MIN_TRUNKS} free-standing trunks from 1 to 8 m, "
            f"got {num_trunks}; record more scans among trees"
        )
    means = np.array(
        [
            np.clip(excesses, -_MAX_EXCESS, _MAX_EXCESS).sum() / max(len(excesses), 1)
            for excesses in per_divergence
        ]
    )
    # Rising: the curvature holds the circle up while the beam that is assumed grows.
    crossings = np.flatnonzero((means[:-1] < 0.0) & (means[1:] >= 0.0))
    if not len(crossings):
        raise InputError(
            "footprint: no beam width from 2 to 30 mrad explains the trunks in these scans; "
            "expected a scanner with a wide beam in a stand of round trunks"
        )
    k = crossings[0]
    share = means[k] / (means[k] - means[k + 1])
    divergence = _DIVERGENCES[k] + share * (_DIVERGENCES[k + 1] - _DIVERGENCES[k])
    return settings.model_copy(update={"beam_divergence": float(divergence)})


def _edge_excesses(scans: Sequence[LaserScan], settings: TreeSettings) -> FloatArray:
    """How much wider than fitted the good free-standing trunks of all scans look, rad."""
    return np.concatenate([np.zeros(0), *(_of_scan(scan, settings) for scan in scans)])


def _of_scan(scan: LaserScan, settings: TreeSettings) -> FloatArray:
    """Apparent minus fitted width of each good free-standing trunk, rad."""
    increment = abs(scan.geometry.angle_increment)
    segments, free, diameters_m = trunk_candidates(scan, settings)
    if not len(diameters_m):
        return diameters_m
    circles = fit_circles(segments, free, diameters_m, increment, settings)
    fronts_m = np.minimum.reduceat(segments.ranges_m, segments.starts)
    last = segments.beams[segments.starts + segments.counts - 1]
    widths = (last - segments.beams[segments.starts] + 1) * increment
    fitted = 2.0 * np.arcsin(circles.radii_m / circles.distances_m)
    good = (
        free.all(axis=0)
        & (segments.counts >= _MIN_BEAMS)
        & (circles.distances_m > _RANGES_M[0])
        & (circles.distances_m < _RANGES_M[1])
        & (circles.misfits < 2.0)
    )
    excesses: FloatArray = (widths - fitted - edge_offsets(fronts_m, settings))[good]
    return excesses
