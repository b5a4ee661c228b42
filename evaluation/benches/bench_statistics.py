"""What a bench makes one figure of many outcomes with; NaN where there are none."""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from semgraph.arrays import BoolArray, FloatArray


def mean(values: FloatArray | BoolArray) -> float:
    """NaN for none."""
    return float(np.mean(values)) if values.size else math.nan


def rms(values: FloatArray) -> float:
    """NaN for none."""
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def worst_bin(reliabilities: FloatArray, right: BoolArray, min_count: int) -> float:
    """Largest difference of predicted and observed, in bins of a tenth that hold `min_count`."""
    bins = np.minimum((10.0 * reliabilities).astype(int), 9)
    differences = [
        abs(mean(reliabilities[bins == k]) - mean(right[bins == k]))
        for k in range(10)
        if (bins == k).sum() >= min_count
    ]
    return max(differences, default=math.nan)


def median_ms(calls: Sequence[Callable[[], object]]) -> float:
    """Median CPU time of the calls, after one round to warm up."""
    times = []
    for round_ in range(2):
        for call in calls:
            started = time.process_time_ns()
            call()
            if round_:
                times.append(time.process_time_ns() - started)
    return float(np.median(times)) / 1e6
