"""Figures of trees, whatever scanner saw them: rates, errors by range, consistency."""

import numpy as np

from evaluation.benches.bench_statistics import mean, rms
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.detector_trials import Outcomes


def rates(
    name: str, outcomes: Outcomes, within_m: float, min_beams: int, targets: tuple[float, float]
) -> list[Row]:
    """Recall of what answers `min_beams` or more and is not hidden, and precision."""
    there = (
        (outcomes.thing_beams >= min_beams)
        & (outcomes.thing_shares >= 0.6)
        & (outcomes.thing_distances_m < within_m)
    )
    near = outcomes.ranges_m < within_m
    found, right = mean(outcomes.found[there]), mean(outcomes.matched[near] >= 0)
    recall, precision = targets
    return [
        Row(f"{name} recall to {within_m:g} m", found, "", Better.HIGHER, recall),
        Row(f"{name} precision to {within_m:g} m", right, "", Better.HIGHER, precision),
    ]


def errors_between(
    name: str, outcomes: Outcomes, between_m: tuple[float, float], targets_mm: tuple[float, float]
) -> list[Row]:
    """RMSE of centre and diameter of what is visible at these ranges."""
    low, high = between_m
    inside = outcomes.visible & (outcomes.ranges_m >= low) & (outcomes.ranges_m < high)
    errors = outcomes.errors[inside]
    centre_mm = 1e3 * rms(np.hypot(errors[:, 0], errors[:, 1] * outcomes.ranges_m[inside]))
    where = f"{name} {low:g}-{high:g} m"
    centre, diameter = targets_mm
    return [
        Row(f"{where} centre RMSE", centre_mm, "mm", Better.LOWER, centre),
        Row(f"{where} diameter RMSE", 1e3 * rms(errors[:, 2]), "mm", Better.LOWER, diameter),
    ]


def nees_within(
    name: str, outcomes: Outcomes, within_m: float, band: tuple[float, float]
) -> list[Row]:
    """NEES of range, bearing and diameter, a row for each side of the band."""
    nees = mean(outcomes.nees[outcomes.visible & (outcomes.ranges_m < within_m)])
    title = f"{name} NEES of 3"
    low, high = band
    return [
        Row(title, nees, "", Better.HIGHER, low),
        Row(title, nees, "", Better.LOWER, high),
    ]
