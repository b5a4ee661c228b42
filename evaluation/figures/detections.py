"""What detectors found, drawn: scans and clouds from above, images as the camera has them."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.figures.style import (
    ELLIPSE_SIGMAS,
    INK,
    KIND_COLOURS,
    TOP,
    draw_ellipses,
    plain,
    save,
    title,
)
from semgraph.arrays import FloatArray
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import CameraImage, DepthImage, LaserScan, PointCloud, Raw
from sensors.points import base_t_points, pixels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS: Final = 3
_PANEL: Final = (4.7, 4.4)
_MAX_POINTS: Final = 20_000
_HALF_SIDE_M: Final = 3.0
_POINT_COLOUR: Final = "#9A9A9A"
# Told from every depth in the image.
_CIRCLE_COLOUR: Final = "#D55E00"
_NOTE: Final = "95 % ellipses, black circles of the diameters; in images circles of the diameters"
_TITLES: Final = {
    LaserScan: "scan",
    PointCloud: "cloud",
    DepthImage: "depth image",
    CameraImage: "camera image",
}


def draw_detections(name: str, seen: Sequence[tuple[Raw, Perceptions]], path: Path) -> None:
    """Writes a picture of some measurements with what was found in them, relative to base.

    From above: points, perceptions with 95 % ellipses, circles of their diameters. In images:
    circles of the diameters, standing on the ground; lines at the bearing, with its 95 % band,
    where there is no diameter, since nothing says how high a thing is.

    Raises:
        SemgraphError: the file cannot be written.
    """
    figure, panels = _panels(max(len(seen), 1))
    start_ns = seen[0][0].stamp_ns if seen else 0
    for axes, (measurement, perceptions) in zip(panels, seen, strict=False):
        if isinstance(measurement, DepthImage | CameraImage):
            _draw_image(axes, measurement, perceptions)
        else:
            _draw_plan(axes, measurement, perceptions)
        seconds = 1e-9 * (measurement.stamp_ns - start_ns)
        what = f"{_TITLES[type(measurement)]}, {seconds:.2f} s: {len(perceptions)}"
        axes.set_title(what, fontsize=10, color=INK)
    for axes in panels[len(seen) :]:
        axes.set_visible(False)
    found = sorted({Kind(kind) for _, each in seen for kind in each.kinds.tolist()})
    title(figure, f"{name} — what was detected", [_NOTE if found else "nothing was perceived"])
    _legend(figure, found)
    save(figure, path)


def _panels(count: int) -> tuple["Figure", list["Axes"]]:
    from matplotlib.figure import Figure

    columns = min(count, _COLUMNS)
    rows = math.ceil(count / columns)
    width, height = max(_PANEL[0] * columns, 7.0), _PANEL[1] * rows + TOP
    figure = Figure(figsize=(width, height))
    grid = figure.subplots(rows, columns, squeeze=False)
    figure.subplots_adjust(
        left=0.6 / width,
        right=1.0 - 0.15 / width,
        bottom=0.5 / height,
        top=1.0 - (TOP + 0.2) / height,
        hspace=0.28,
        wspace=0.2,
    )
    return figure, list(grid.flat)


def _legend(figure: "Figure", kinds: Sequence[Kind]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=KIND_COLOURS[kind], marker="o", linestyle="none", label=kind.label)
        for kind in kinds
    ]
    if handles:
        figure.legend(handles=handles, loc="upper right", ncols=3, frameon=False, fontsize=9)


def _draw_plan(axes: "Axes", measurement: Raw, perceptions: Perceptions) -> None:
    from matplotlib.collections import EllipseCollection

    points = base_t_points(measurement)
    points = points[:: max(1, math.ceil(len(points) / _MAX_POINTS))]
    axes.plot(*points[:, :2].T, ".", color=_POINT_COLOUR, markersize=1.3, zorder=1)
    axes.plot(0.0, 0.0, marker=(3, 0, -90), color=INK, markersize=9, zorder=2)
    places, covariances = perceptions.base_t_landmarks(), perceptions.base_covariances()
    for kind in Kind:
        rows = np.flatnonzero(perceptions.kinds == kind)
        if not len(rows):
            continue
        colour = KIND_COLOURS[kind]
        draw_ellipses(axes, places[rows], covariances[rows], colour)
        axes.plot(*places[rows].T, "+", color=colour, markersize=4, zorder=4)
        wide = rows[np.isfinite(perceptions.diameters_m[rows])]
        diameters_m = perceptions.diameters_m[wide]
        circles = EllipseCollection(
            diameters_m,
            diameters_m,
            np.zeros(len(wide)),
            units="xy",
            offsets=places[wide],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=INK,
            linewidths=0.8,
            zorder=5,
        )
        axes.add_collection(circles)
    plain(axes)
    _frame(axes, places, points[:, :2])


def _frame(axes: "Axes", places: FloatArray, points: FloatArray) -> None:
    """The vehicle and what is perceived, else all points; a metre is as long in x as in y."""
    shown = np.vstack([places if len(places) else points, np.zeros((1, 2))])
    low, high = shown.min(axis=0), shown.max(axis=0)
    half = max(0.58 * float((high - low).max()), _HALF_SIDE_M)
    middle = 0.5 * (low + high)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
    axes.set_xlabel("x ahead [m]", color=INK, fontsize=9)
    axes.set_ylabel("y to the left [m]", color=INK, fontsize=9)


def _draw_image(axes: "Axes", image: DepthImage | CameraImage, perceptions: Perceptions) -> None:
    from matplotlib.collections import EllipseCollection

    if isinstance(image, DepthImage):
        near, far = _depth_limits(image.depths_m)
        axes.imshow(np.log(image.depths_m), cmap="viridis_r", vmin=near, vmax=far)
    else:
        axes.imshow(image.grey, cmap="gray", vmin=0, vmax=255)
    axes.set_axis_off()
    places, diameters_m = perceptions.base_t_landmarks(), perceptions.diameters_m
    has = np.isfinite(diameters_m)
    heights_m = np.where(has, 0.0, image.camera.mounting.height_m)
    at_px, depths_m = pixels(image.camera, image.tilt, np.column_stack([places, heights_m]))
    wide = has & np.isfinite(depths_m)
    widths_px = image.camera.focal_px * diameters_m[wide] / depths_m[wide]
    circles = EllipseCollection(
        widths_px,
        widths_px,
        np.zeros(len(widths_px)),
        units="xy",
        offsets=at_px[wide],
        offset_transform=axes.transData,
        facecolors="none",
        edgecolors=_CIRCLE_COLOUR,
        linewidths=1.2,
    )
    axes.add_collection(circles)
    for k in np.flatnonzero(~has & np.isfinite(depths_m)):
        _draw_bearing(axes, image, perceptions, int(k), float(at_px[k, 0]))
    axes.set_xlim(-0.5, image.camera.width - 0.5)
    axes.set_ylim(image.camera.height - 0.5, -0.5)


def _depth_limits(depths_m: FloatArray) -> tuple[float, float]:
    """Logarithms of the nearest and of the 95th percentile; some for an image without depths."""
    known = depths_m[np.isfinite(depths_m)]
    if not len(known):
        return 0.0, 1.0
    near, far = np.log([known.min(), np.percentile(known, 95.0)]).tolist()
    return near, far + 0.01


def _draw_bearing(
    axes: "Axes", image: DepthImage | CameraImage, perceptions: Perceptions, k: int, column: float
) -> None:
    colour = KIND_COLOURS[Kind(int(perceptions.kinds[k]))]
    sigma = float(np.sqrt(perceptions.covariances[k, 1, 1]))
    half_px = ELLIPSE_SIGMAS * sigma * image.camera.focal_px
    axes.axvspan(column - half_px, column + half_px, color=colour, alpha=0.3, linewidth=0.0)
    axes.axvline(column, color=colour, linewidth=1.0)
    label = f" {perceptions.identities[k]} {perceptions.ranges_m[k]:.2f} m"
    axes.text(
        column,
        12.0,
        label,
        color=INK,
        fontsize=8,
        va="top",
        parse_math=False,
        bbox={"facecolor": "white", "edgecolor": colour, "pad": 1.5},
    )
