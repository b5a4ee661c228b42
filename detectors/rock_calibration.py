"""What a part that stands out of the ground says of a rock: size, centre, how surely it is one."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from detectors.rock_segments import RockSegments
from semgraph.arrays import FloatArray
from semgraph.landmarks import polar_covariances

# Fitted on simulated terrain (smooth, medium and rough; seeds 1 to 20). Lengths in m.
_LOG_DIAMETER: Final = np.array([0.189, 0.952, -1.138, 1.642])
_CENTRE_BEHIND: Final = (0.398, -0.184)
_RANGE_SIGMA: Final = (0.1, 0.5, 0.015)
_ACROSS_SIGMA: Final = (0.06, 0.1, 0.012)
_LOG_DIAMETER_SIGMA: Final = 0.18
_WEIGHTS: Final = np.array([-0.96, -4.05, 0.35, -0.23, -3.42, 3.52, -2.99, 2.1, 1.48, 4.63, -0.79, 0.04, 1.91, 0.55])
_SCORES: Final = tuple(np.linspace(-6,6,25))
_FREQUENCIES: Final = tuple(1/(1+np.exp(-np.linspace(-6,6,25))))


@dataclass(frozen=True, slots=True, eq=False)
class Rocks:
    """Rocks (k,) that the segments may be: centre, diameter, and covariance of range, bearing."""

    ranges_m: FloatArray
    bearings: FloatArray
    diameters_m: FloatArray
    covariances: FloatArray
    diameter_sigmas_m: FloatArray


def rocks_of(segments: RockSegments) -> Rocks:
    """The rock that each segment would be.

    Its width grows by what the cut-off hides; its centre lies behind the middle of what is seen.
    """
    cut_off = segments.least_m / segments.heights_m
    regressors = [np.ones_like(cut_off), np.log(widths_m(segments) + 0.03), cut_off, cut_off**2]
    diameters_m = np.exp(_LOG_DIAMETER @ np.stack(regressors))
    behind, less = _CENTRE_BEHIND
    ranges_m = segments.ranges_m + diameters_m * (behind + less * cut_off)
    range_sigmas_m = _sigmas_m(_RANGE_SIGMA, diameters_m, segments.range_sigmas_m)
    across_sigmas_m = _sigmas_m(_ACROSS_SIGMA, diameters_m, segments.range_sigmas_m)
    return Rocks(
        ranges_m,
        0.5 * (segments.lefts + segments.rights),
        diameters_m,
        polar_covariances(range_sigmas_m, across_sigmas_m / ranges_m),
        _LOG_DIAMETER_SIGMA * diameters_m,
    )


def scores(segments: RockSegments) -> FloatArray:
    """(k,) log-odds, up to calibration, that each segment is one rock and where it seems to be."""
    return np.asarray(_WEIGHTS @ features(segments))


def reliabilities(scores_: FloatArray) -> FloatArray:
    """(k,) in [0, 1]: how often such a score was a rock."""
    return np.asarray(np.interp(scores_, _SCORES, _FREQUENCIES))


def features(segments: RockSegments) -> FloatArray:
    """(14, k) what the score is linear in."""
    width_m = widths_m(segments) + 0.02
    tens_of_m = segments.ranges_m / 10.0
    log_width = np.log(width_m)
    log_extent = np.log((segments.extents_m + 0.02) / width_m)
    return np.stack(
        [
            np.ones_like(width_m),
            tens_of_m,
            log_width,
            log_width**2,
            np.log(segments.heights_m / width_m) ** 2,
            np.log(segments.heights_m / segments.spreads_m),
            segments.least_m / segments.heights_m,
            segments.shadows,
            segments.sides,
            segments.sides**2,
            log_extent,
            log_extent**2,
            segments.fills,
            np.log(segments.spreads_m),
        ]
    )


def widths_m(segments: RockSegments) -> FloatArray:
    """(k,) across the line of sight."""
    return np.asarray(2.0 * segments.ranges_m * np.sin(0.5 * (segments.lefts - segments.rights)))


def _sigmas_m(
    shares: tuple[float, float, float], diameters_m: FloatArray, range_sigmas_m: FloatArray
) -> FloatArray:
    of_diameter, of_range_sigma, rest = shares
    return np.asarray(
        np.sqrt((of_diameter * diameters_m) ** 2 + (of_range_sigma * range_sigmas_m) ** 2 + rest**2)
    )
