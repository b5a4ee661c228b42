"""What a part that stands out of the ground says of a rock: size, centre, how surely it is one."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from detectors.rock_segments import RockSegments
from semgraph.arrays import FloatArray
from semgraph.landmarks import polar_covariances

# Fitted on simulated terrain (smooth, medium and rough; seeds 1 to 20), stereo of 0.12 and 0.24 m
# and time of flight together. Lengths in m.
_LOG_DIAMETER: Final = np.array([0.194, 0.928, -1.301, 1.79])
_CENTRE_BEHIND: Final = (0.31, -0.179, 0.401)
_RANGE_SIGMA: Final = (0.069, 0.433, 0.008)
_ACROSS_SIGMA: Final = (0.05, 0.12, 0.005)
_CUT_SIGMA: Final = 0.17
_LOG_DIAMETER_SIGMA: Final = 0.18
_WEIGHTS: Final = np.array(
    [
        -10.15,  # constant
        -3.12,  # log width
        -0.45,  # its square
        -2.23,  # squared log of height over width
        3.94,  # log of height over spread
        -2.1,  # height of the cut-off over height
        2.39,  # shadow
        1.63,  # sides
        3.32,  # their square
        -1.39,  # log of extent over width
        0.34,  # its square
        2.12,  # fill
        1.16,  # log spread
        -1.27,  # range sigma over width
        0.77,  # log count
    ]
)
# How often such a score was a rock, of the stereo camera of 0.24 m.
_SCORES: Final = (-2.0, -1.25, -0.5, 0.0, 0.5, 1.0, 1.75, 2.5, 3.5)
_FREQUENCIES: Final = (0.15, 0.264, 0.334, 0.521, 0.714, 0.821, 0.957, 0.995, 0.999)


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
    of_diameter, less, of_range_sigma = _CENTRE_BEHIND
    ranges_m = (
        segments.ranges_m
        + diameters_m * (of_diameter + less * cut_off)
        + of_range_sigma * segments.range_sigmas_m
    )
    range_sigmas_m = _sigmas_m(_RANGE_SIGMA, diameters_m, segments)
    across_sigmas_m = _sigmas_m(_ACROSS_SIGMA, diameters_m, segments)
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
    """(15, k) what the score is linear in."""
    width_m = widths_m(segments) + 0.02
    log_width = np.log(width_m)
    log_extent = np.log((segments.extents_m + 0.02) / width_m)
    return np.stack(
        [
            np.ones_like(width_m),
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
            segments.range_sigmas_m / width_m,
            np.log(segments.counts),
        ]
    )


def widths_m(segments: RockSegments) -> FloatArray:
    """(k,) across the line of sight."""
    return np.asarray(2.0 * segments.ranges_m * np.sin(0.5 * (segments.lefts - segments.rights)))


def _sigmas_m(
    shares: tuple[float, float, float], diameters_m: FloatArray, segments: RockSegments
) -> FloatArray:
    """(k,) of the diameter, of a pixel's range sigma, and the rest; more at the image's edge."""
    of_diameter, of_range_sigma, rest = shares
    shape_m = np.hypot(of_diameter, _CUT_SIGMA * segments.cut) * diameters_m
    noise_m = of_range_sigma * segments.range_sigmas_m
    return np.asarray(np.sqrt(shape_m**2 + noise_m**2 + rest**2))
