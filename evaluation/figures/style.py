"""What the pictures share: colours, measures, title, and how they are written."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.trajectory import MAX_GAP_NS, PathErrors, rmse
from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import SemgraphError
from semgraph.landmarks import Kind

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 170

# Okabe and Ito 2008: told apart with every kind of colour vision.
BLUE, ORANGE, GREY, INK = "#0072B2", "#E69F00", "#8A8A8A", "#262626"
KIND_COLOURS = {Kind.TREE: "#009E73", Kind.ROCK: "#56B4E9", Kind.MARKER: "#CC79A7"}

# sqrt of the 95 % point of chi-square with 2 degrees of freedom.
ELLIPSE_SIGMAS = float(np.sqrt(-2.0 * np.log(0.05)))

# Ellipses up to this width are drawn, however near to each other the points are.
_LEAST_SPAN_M = 20.0
# Inches at the top right, and how many letters of a name are always there.
_LEGEND_WIDTH = 3.0
_LEAST_LETTERS = 20

# Inches around the axes.
LEFT, BOTTOM, TOP = 0.8, 0.65, 0.95

# An estimate's name, its colour, and its errors.
Compared = tuple[str, str, PathErrors]


def plain(axes: "Axes") -> None:
    """Gives axes a light grid and no frame."""
    axes.grid(color="#E6E6E6", linewidth=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#B0B0B0")
    axes.tick_params(colors=INK, labelsize=9)


def draw_ellipses(axes: "Axes", points: FloatArray, covariances: FloatArray, colour: str) -> int:
    """Draws the 95 % ellipses of points (n, 2) with covariances (n, 2, 2).

    Those wider than all that the points span would hide everything and are left out.

    Returns:
        how many are left out.
    """
    from matplotlib.collections import EllipseCollection

    values, vectors = np.linalg.eigh(covariances)
    axes_m = 2.0 * ELLIPSE_SIGMAS * np.sqrt(np.maximum(values, 0.0))
    angles = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    fits = axes_m[:, 1] <= float(np.ptp(points, axis=0).max()) + _LEAST_SPAN_M
    ellipses = EllipseCollection(
        axes_m[fits, 1],
        axes_m[fits, 0],
        angles[fits],
        units="xy",
        offsets=points[fits],
        offset_transform=axes.transData,
        facecolors=colour + "2E",
        edgecolors=colour,
        linewidths=0.9,
        zorder=3,
    )
    axes.add_collection(ellipses)
    return int(np.count_nonzero(~fits))


def ellipses_label(what: str, num_points: int, num_left_out: int) -> str:
    """For a legend, with what `draw_ellipses` returned."""
    if num_left_out:
        return f"{what} ({num_points}),\n{num_left_out} with too wide an ellipse"
    return f"{what} with 95 % ellipse ({num_points})"


def time_panels(labels: Sequence[str]) -> tuple["Figure", list["Axes"]]:
    """A figure with axes one above the other, one a label, that share the time since the start."""
    from matplotlib.figure import Figure

    height = 2.2 * len(labels) + BOTTOM + TOP
    figure = Figure(figsize=(11.0, height))
    panels = list(figure.subplots(len(labels), 1, sharex=True))
    figure.subplots_adjust(
        left=LEFT / 11.0, right=0.985, bottom=BOTTOM / height, top=1.0 - TOP / height, hspace=0.1
    )
    figure.align_ylabels(panels)
    for axes, label in zip(panels, labels, strict=True):
        axes.set_ylabel(label, color=INK)
        axes.axhline(0.0, color="#B0B0B0", linewidth=1.0, zorder=1)
        plain(axes)
    panels[-1].set_xlabel("time since the start [s]", color=INK)
    return figure, panels


def legend_right(figure: "Figure", axes: "Axes") -> None:
    """Puts the legend of some axes at the top right of the figure."""
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="upper right",
        ncols=3,
        frameon=False,
        fontsize=9,
        labelcolor=INK,
        bbox_to_anchor=(0.995, 1.0 - 0.06 / figure.get_figheight()),
    )


def rmse_text(errors: PathErrors) -> str:
    """The RMSE in metres, jumping fixes left out."""
    return f"{rmse(errors.errors[~errors.is_outlier]):.3f} m"


def notes_on_reference(compared: Sequence[Compared]) -> list[str]:
    """What a reader has to know about the reference."""
    num_outliers = max((int(errors.is_outlier.sum()) for *_, errors in compared), default=0)
    return [f"jumping reference fixes left out: {num_outliers}"] * (num_outliers > 0)


def title(figure: "Figure", name: str, notes: Sequence[str]) -> None:
    """The name in bold, below it the notes, broken to the figure's width.

    Args:
        figure: to write on.
        name: cut where it would not fit beside a legend.
        notes: of one line each.
    """
    height, width = figure.get_figheight(), figure.get_figwidth()
    left, from_top = 0.15 / width, 1.0 - 0.12 / height
    heading, most = (
        drawable(name or "run"),
        max(int(7.5 * (width - _LEGEND_WIDTH)), _LEAST_LETTERS),
    )
    heading = heading if len(heading) <= most else f"{heading[: most - 1]}…"
    style: dict[str, Any] = {"ha": "left", "va": "top", "color": INK, "parse_math": False}
    figure.text(left, from_top, heading, fontsize=14, fontweight="bold", **style)
    broken = textwrap.fill(drawable(" · ".join(notes)), int(12.5 * width))
    figure.text(left, 1.0 - 0.42 / height, broken, fontsize=9.5, linespacing=1.35, **style)


def drawable(text: str) -> str:
    """The text with a question mark for what the font cannot draw."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    font = get_font(findfont(FontProperties()))
    return "".join(letter if font.get_char_index(ord(letter)) else "?" for letter in text)


def broken_at_gaps(stamps_ns: IntArray, points: FloatArray) -> FloatArray:
    """Points (n, d) with a row of NaN wherever more than 2 s passed: a line breaks there.

    Where points are always that far apart, it breaks where thrice the usual time passed.
    """
    steps_ns = np.diff(stamps_ns)
    longest_ns = max(MAX_GAP_NS, 3.0 * float(np.median(steps_ns))) if len(steps_ns) else MAX_GAP_NS
    gaps = np.flatnonzero(steps_ns > longest_ns) + 1
    return np.insert(points, gaps, np.nan, axis=0)


def save(figure: "Figure", path: Path) -> None:
    """Writes a figure as PNG.

    Raises:
        SemgraphError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    try:
        figure.savefig(path, dpi=DPI, facecolor="white")
    except OSError as error:
        raise SemgraphError(f"{path}: cannot be written: {error.strerror}") from error
