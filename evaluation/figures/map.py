"""The map as a picture: landmarks with 95 % ellipses, all trajectories, the truth (Fig. 4)."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from evaluation.figures.style import (
    BLUE,
    BOTTOM,
    GREY,
    INK,
    KIND_COLOURS,
    LEFT,
    ORANGE,
    TOP,
    Compared,
    broken_at_gaps,
    draw_ellipses,
    ellipses_label,
    notes_on_reference,
    plain,
    rmse_text,
    save,
    title,
)
from evaluation.landmarks import MapErrors, compare_map
from evaluation.metrics import path_alignment
from evaluation.trajectory import compare_path, rmse
from semgraph.arrays import FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2, transform_points
from semgraph.landmarks import Kind, Landmark
from semgraph.results import RunResult
from sensors.truth import TruePath, Truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_KIND_SHAPES = {Kind.TREE: "o", Kind.ROCK: "^", Kind.MARKER: "s"}
_FAULT = "#D55E00"

# Inches: the box of the map at most and at least, and the legend's room.
_MAX_BOX, _MIN_SIDE = np.array([9.5, 8.0]), 3.5
_RIGHT = 2.9

Line = tuple[FloatArray, str, str]


def draw_map(result: RunResult, truth: Truth, path: Path) -> None:
    """Writes a picture of the map: landmarks with 95 % ellipses, all trajectories, the truth.

    The truth is laid onto the map's frame by the smoothed path's rigid alignment (where there is
    no true path, by the map's own).

    Raises:
        SemgraphError: the file cannot be written.
    """
    matched = compare_map(result.landmarks, truth, path_alignment(result.smoothed, truth))
    map_T_world = _map_T_world(result, truth, matched)
    lines = _trajectories(result, truth, map_T_world)
    true_landmarks: FloatArray = np.empty((0, 2))
    if truth.landmarks is not None:
        true_landmarks = map_T_world.transform(truth.landmarks.world_t_landmarks)
    positions = _positions(result.landmarks)
    low, high = _extent([positions, true_landmarks, *(line for line, _, _ in lines)])
    figure, axes = _map_axes(low, high)
    _draw_trajectories(axes, lines)
    _draw_true_landmarks(axes, true_landmarks)
    _draw_landmarks(axes, result.landmarks)
    if matched is not None:
        _draw_faults(axes, positions, true_landmarks, matched)
    _finish_map(figure, axes, result, truth, matched)
    save(figure, path)


def _map_T_world(result: RunResult, truth: Truth, matched: MapErrors | None) -> Pose2:
    world_T_map = path_alignment(result.smoothed, truth)
    if world_T_map is None and matched is not None:
        world_T_map = matched.world_T_map
    return Pose2() if world_T_map is None else world_T_map.inverse()


def _trajectories(result: RunResult, truth: Truth, map_T_world: Pose2) -> list[Line]:
    """(points, colour, label) of each, with a row of NaN where there was no pose for 2 s."""
    lines = []
    if truth.path is not None and len(truth.path.stamps_ns):
        points = map_T_world.transform(truth.path.world_t_reference)
        kept = _without_outliers(result, truth.path)
        stamps_ns = truth.path.stamps_ns[kept]
        lines.append((broken_at_gaps(stamps_ns, points[kept]), GREY, "true path"))
    for estimate, colour, label in (
        (result.fast, ORANGE, "fast estimate"),
        (result.smoothed, BLUE, "smoothed"),
    ):
        if len(estimate):
            points = _reference_points(estimate, truth)
            lines.append((broken_at_gaps(estimate.stamps_ns, points), colour, label))
    return lines


def _reference_points(estimate: Trajectory, truth: Truth) -> FloatArray:
    """(n, 2) of the truth's reference point, so that the lines lie upon each other."""
    if truth.path is None:
        return estimate.map_T_bases[:, :2]
    return transform_points(estimate.map_T_bases, truth.path.base_t_reference)


def _without_outliers(result: RunResult, truth: TruePath) -> IntArray:
    errors = compare_path(result.smoothed, truth)
    rows = np.arange(len(truth.stamps_ns))
    return rows if errors is None else np.setdiff1d(rows, errors.rows[errors.is_outlier])


def _positions(landmarks: Sequence[Landmark]) -> FloatArray:
    return np.array([landmark.map_t_landmark for landmark in landmarks]).reshape(-1, 2)


def _extent(groups: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    points = np.vstack([*groups, np.empty((0, 2))])
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        return np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.04 * float((high - low).max()) + 0.5
    return low - margin, high + margin


def _map_axes(low: FloatArray, high: FloatArray) -> tuple["Figure", "Axes"]:
    """One axes in which a metre is as long in x as in y; what is too narrow gets more room."""
    from matplotlib.figure import Figure

    metres_per_inch = float(((high - low) / _MAX_BOX).max())
    box = np.maximum((high - low) / metres_per_inch, _MIN_SIDE)
    middle, half = 0.5 * (low + high), 0.5 * box * metres_per_inch
    size = box + np.array([LEFT + _RIGHT, BOTTOM + TOP])
    figure = Figure(figsize=(float(size[0]), float(size[1])))
    axes = figure.add_axes((LEFT / size[0], BOTTOM / size[1], *(box / size)))
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_xlabel("x in map [m]", color=INK)
    axes.set_ylabel("y in map [m]", color=INK)
    plain(axes)
    return figure, axes


def _draw_trajectories(axes: "Axes", lines: Sequence[Line]) -> None:
    widths = {"true path": 3.4, "fast estimate": 1.1, "smoothed": 1.5}
    for number, (points, colour, label) in enumerate(lines):
        axes.plot(
            *points.T,
            color=colour,
            linewidth=widths[label],
            label=label,
            # Above the landmarks, which in a forest hide all.
            zorder=4.1 + 0.1 * number,
            alpha=0.55 if label == "true path" else 1.0,
            solid_capstyle="round",
        )
    starts = [points[0] for points, _, label in lines if label == "smoothed"]
    for x, y in starts:
        axes.plot(x, y, "o", color=INK, markersize=7, zorder=5, label="start")


def _draw_true_landmarks(axes: "Axes", points: FloatArray) -> None:
    if len(points):
        axes.plot(
            *points.T,
            "+",
            color=INK,
            markersize=_marker_size(len(points)) + 5.0,
            markeredgewidth=0.9,
            label=f"true landmark ({len(points)})",
            zorder=3.5,
        )


def _draw_landmarks(axes: "Axes", landmarks: Sequence[Landmark]) -> None:
    for kind in Kind:
        of_kind = [landmark for landmark in landmarks if landmark.semantics.kind == kind]
        if not of_kind:
            continue
        points = _positions(of_kind)
        covariances = np.array([landmark.covariance for landmark in of_kind])
        left_out = draw_ellipses(axes, points, covariances, KIND_COLOURS[kind])
        axes.plot(
            *points.T,
            _KIND_SHAPES[kind],
            color=KIND_COLOURS[kind],
            markersize=_marker_size(len(landmarks)),
            label=ellipses_label(kind.label, len(of_kind), left_out),
            zorder=4,
        )


def _draw_faults(
    axes: "Axes", positions: FloatArray, true_landmarks: FloatArray, matched: MapErrors
) -> None:
    for points, marker, label in (
        (true_landmarks[matched.missed], "s", "missed"),
        (positions[matched.false], "o", "false"),
        (positions[matched.duplicates], "D", "counted twice"),
    ):
        if len(points):
            axes.plot(
                *points.T,
                marker,
                color="none",
                markeredgecolor=_FAULT,
                markersize=11,
                markeredgewidth=1.3,
                label=f"{label} ({len(points)})",
                zorder=4.5,
            )


def _marker_size(num_points: int) -> float:
    return float(np.clip(14.0 / np.sqrt(num_points + 1.0), 1.2, 2.5))


def _finish_map(
    figure: "Figure", axes: "Axes", result: RunResult, truth: Truth, matched: MapErrors | None
) -> None:
    from matplotlib.lines import Line2D

    notes = [f"{len(result.landmarks)} landmarks"]
    compared: list[Compared] = []
    if truth.path is not None:
        for label, estimate in (("smoothed", result.smoothed), ("fast", result.fast)):
            errors = compare_path(estimate, truth.path)
            if errors is not None:
                compared.append((label, "", errors))
                notes.append(f"{label} path RMSE {rmse_text(errors)}")
    if matched is not None and len(matched.map_rows) >= 2:
        notes.append(f"map RMSE {rmse(matched.errors):.3f} m")
    title(figure, result.name, notes + notes_on_reference(compared))
    legend = axes.legend(
        *axes.get_legend_handles_labels(),
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        frameon=False,
        fontsize=9,
        labelcolor=INK,
        borderaxespad=0.0,
        labelspacing=0.8,
    )
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D):
            handle.set_markersize(7.0)
