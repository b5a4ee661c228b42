"""Errors over time as a picture, in x, y and rotation (Fig. 5)."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from evaluation.alignment import Alignment
from evaluation.consistency import nearest_rows
from evaluation.figures.style import (
    BLUE,
    ORANGE,
    broken_at_gaps,
    legend_right,
    notes_on_reference,
    rmse_text,
    save,
    time_panels,
    title,
)
from evaluation.trajectory import PathErrors, compare_path
from semgraph.estimates import Trajectory
from semgraph.results import RunResult
from sensors.truth import TruePath, Truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BAND_SIGMAS = 1.96
_ALIGNMENT_NOTES = {
    Alignment.NONE: "no truth is known",
    Alignment.ORIGIN: "first pose laid onto the first",
    Alignment.RIGID: "aligned rigidly · no rotation: the truth has no headings",
}


def draw_errors(result: RunResult, truth: Truth, path: Path) -> None:
    """Writes a picture of the errors in x, y and rotation over time, fast and smoothed.

    With true headings the first pose is laid onto the first, so that the drift is seen to grow,
    and the band is what the smoothed covariances claim for 95 %. Without them each estimate is
    laid onto the truth by its own rigid alignment, and the picture says why there is no rotation.
    Without a true path it shows how far the fast estimate lies from the smoothed one.

    Raises:
        SemgraphError: the file cannot be written.
    """
    reference, what = truth.path, "errors over time"
    estimates = [("fast", result.fast, ORANGE), ("smoothed", result.smoothed, BLUE)]
    if reference is None:
        reference = _as_reference(result.smoothed)
        estimates, what = estimates[:1], "fast estimate against the smoothed one"
    alignment = Alignment.RIGID if reference.headings is None else Alignment.ORIGIN
    if truth.path is None:
        alignment = Alignment.NONE
    compared = [
        (label, colour, errors)
        for label, estimate, colour in estimates
        if (errors := compare_path(estimate, reference, alignment)) is not None
    ]
    figure, panels = _error_axes(
        "error" if truth.path else "difference", with_headings=reference.headings is not None
    )
    for label, colour, errors in compared:
        _draw_errors_of(panels, label, colour, errors, reference)
        if label == "smoothed" and alignment is Alignment.ORIGIN:
            _draw_band(panels, result, errors, reference)
    notes = [f"{label}: {_figures_of(errors)}" for label, _, errors in compared]
    notes += (
        [_ALIGNMENT_NOTES[alignment], *notes_on_reference(compared)] if compared else ["no poses"]
    )
    title(figure, f"{result.name} — {what}", notes)
    if compared:
        legend_right(figure, panels[0])
    save(figure, path)


def _as_reference(trajectory: Trajectory) -> TruePath:
    return TruePath(
        trajectory.stamps_ns, trajectory.map_T_bases[:, :2], trajectory.map_T_bases[:, 2]
    )


def _error_axes(what: str, *, with_headings: bool) -> tuple["Figure", list["Axes"]]:
    labels = [f"x {what} [m]", f"y {what} [m]"] + [f"rotation {what} [deg]"] * with_headings
    return time_panels(labels)


def _draw_errors_of(
    panels: Sequence["Axes"], label: str, colour: str, errors: PathErrors, reference: TruePath
) -> None:
    kept = ~errors.is_outlier
    stamps_ns = reference.stamps_ns[errors.rows]
    seconds = (stamps_ns - reference.stamps_ns[0])[kept] / 1e9
    columns = [errors.errors]
    if errors.heading_errors is not None:
        columns.append(np.degrees(errors.heading_errors)[:, None])
    points = broken_at_gaps(stamps_ns[kept], np.column_stack([seconds, np.hstack(columns)[kept]]))
    for axes, values in zip(panels, points[:, 1:].T, strict=True):
        axes.plot(points[:, 0], values, color=colour, linewidth=1.3, label=label)


def _draw_band(
    panels: Sequence["Axes"], result: RunResult, errors: PathErrors, reference: TruePath
) -> None:
    """What the smoothed covariances claim for 95 % of the errors, about zero."""
    stamps_ns = reference.stamps_ns[errors.rows]
    covariances = result.smoothed_covariances[nearest_rows(result.smoothed.stamps_ns, stamps_ns)]
    world_R_bases = np.zeros((len(stamps_ns), 3, 3))
    c, s = np.cos(errors.world_T_bases[:, 2]), np.sin(errors.world_T_bases[:, 2])
    world_R_bases[:, 0, 0] = world_R_bases[:, 1, 1] = c
    world_R_bases[:, 1, 0], world_R_bases[:, 0, 1] = s, -s
    world_R_bases[:, 2, 2] = 1.0
    in_world = world_R_bases @ covariances @ world_R_bases.transpose(0, 2, 1)
    bands = _BAND_SIGMAS * np.sqrt(np.diagonal(in_world, axis1=1, axis2=2))
    bands[:, 2] = np.degrees(bands[:, 2])
    if np.isnan(bands).all():
        return
    seconds = (stamps_ns - reference.stamps_ns[0]) / 1e9
    for axes, band in zip(panels, bands.T, strict=True):
        axes.fill_between(
            seconds,
            -band,
            band,
            color=BLUE,
            alpha=0.13,
            linewidth=0.0,
            zorder=1,
            label="95 % claimed (smoothed)",
        )


def _figures_of(errors: PathErrors) -> str:
    largest_m = float(errors.distances[~errors.is_outlier].max())
    return f"RMSE {rmse_text(errors)}, largest {largest_m:.3f} m"
