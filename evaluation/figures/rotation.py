"""Yaw rates of the estimates and of the inertial sensor over time as a picture (Fig. 7)."""

from pathlib import Path

import numpy as np

from evaluation.figures.style import (
    BLUE,
    GREY,
    ORANGE,
    broken_at_gaps,
    legend_right,
    save,
    time_panels,
    title,
)
from evaluation.rotation import turn_rates
from semgraph.results import RunResult


def draw_rotation(result: RunResult, path: Path) -> None:
    """Writes a picture of the yaw rates, and below of their differences to the sensor's.

    The sensor's samples are averaged over the time between two poses.

    Raises:
        SemgraphError: the file cannot be written.
    """
    figure, (rates_axes, difference_axes) = time_panels(
        ("yaw rate [rad/s]", "difference to IMU [rad/s]")
    )
    notes, measured_label = [], "IMU"
    for label, estimate, colour in (
        ("fast", result.fast, ORANGE),
        ("smoothed", result.smoothed, BLUE),
    ):
        rates = turn_rates(estimate, result.imu)
        if rates is None:
            continue
        seconds = 1e-9 * (rates.stamps_ns - min(result.imu.stamps_ns[0], rates.stamps_ns[0]))
        columns = (seconds, rates.measured, rates.estimated, rates.differences)
        points = broken_at_gaps(rates.stamps_ns, np.column_stack(columns))
        if measured_label:
            rates_axes.plot(*points[:, :2].T, color=GREY, linewidth=2.6, label=measured_label)
            measured_label = ""
        rates_axes.plot(points[:, 0], points[:, 2], color=colour, linewidth=0.9, label=label)
        difference_axes.plot(points[:, 0], points[:, 3], color=colour, linewidth=0.9)
        notes.append(f"{label}: RMS of the difference {rates.rms:.4f} rad/s")
    title(figure, f"{result.name} — rotation", notes or ["no poses while the IMU measured"])
    if notes:
        legend_right(figure, rates_axes)
    save(figure, path)
