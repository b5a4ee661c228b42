"""How probably a fitted circle is a trunk."""

import numpy as np

from detectors.scan_segments import Segments
from detectors.trunk_fit import Circles
from semgraph.arrays import BoolArray, FloatArray

# Logistic regression on simulated stands (forest, parkland, and much clutter; both resolutions),
# then made a frequency by a monotone fit. Stems and saplings count as trunks.
_WEIGHTS = np.array([-12.806, -2.595, -0.517, 0.936, 35.308, -6.525, 2.795, 1.847])
_SCORES = (-1.84, -0.9, 0.02, 0.63, 1.16, 1.56, 1.9, 2.29, 2.66, 3.11, 3.7, 4.59, 7.41)
_FREQUENCIES = (
    *(0.217, 0.318, 0.445, 0.651, 0.72, 0.785, 0.852),
    *(0.882, 0.93, 0.959, 0.979, 0.992, 0.999),
)


def trunk_reliabilities(
    segments: Segments, free: BoolArray, circles: Circles, increment: float
) -> FloatArray:
    """(k,) in [0, 1], calibrated on simulated stands.

    It speaks of misfit, beams, the smaller step beyond a free edge, range, and apparent width.
    """
    steps_m = np.minimum(np.where(free, segments.steps_m, np.inf).min(axis=0), 0.5)
    log_misfits = np.log(circles.misfits + 0.1)
    tens_of_m = circles.distances_m / 10.0
    score = _WEIGHTS @ np.stack(
        [
            np.ones_like(tens_of_m),
            log_misfits,
            log_misfits**2,
            np.log(segments.counts),
            steps_m,
            tens_of_m,
            tens_of_m**2,
            np.log(segments.counts * increment * circles.distances_m),
        ]
    )
    reliabilities: FloatArray = np.interp(score, _SCORES, _FREQUENCIES)
    return reliabilities
