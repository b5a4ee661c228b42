"""The fast estimator against global localization over a run, and how sure it was (Fig. 6)."""

from pathlib import Path
from typing import TYPE_CHECKING, Final

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
    broken_at_gaps,
    legend_right,
    plain,
    save,
    title,
)
from semgraph.arrays import FloatArray
from semgraph.estimates import Trajectory
from semgraph.geometry import wrap_angle
from semgraph.landmarks import Kind

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from semgraph.localization import LocalizationResult

_SURE: Final = 0.95
_WIDTH, _HEIGHT = 13.0, 6.5


def draw_localization(result: "LocalizationResult", path: Path) -> None:
    """Writes a picture: both paths in the map; position, heading and quality over time.

    Global localization, the particle filter alone, is drawn where its quality is 0.95 or more; the
    fast estimator alone from where it was started.

    Raises:
        SemgraphError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, _HEIGHT))
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.1))
    chart, over_time = (
        figure.add_subplot(grid[:, 0]),
        [figure.add_subplot(grid[row, 1]) for row in range(3)],
    )
    figure.subplots_adjust(
        left=LEFT / _WIDTH, right=0.985, bottom=BOTTOM / _HEIGHT, top=1.0 - TOP / _HEIGHT
    )
    sure = result.particles.map_T_bases.copy()
    sure[result.particle_qualities < _SURE] = np.nan
    _draw_map(chart, result, sure)
    _draw_differences(over_time[:2], result)
    _draw_quality(over_time[2], result)
    for axes in (chart, *over_time):
        plain(axes)
    title(figure, f"{result.run.name} — fast estimator against global localization", _notes(result))
    legend_right(figure, chart)
    save(figure, path)


def _draw_map(axes: "Axes", result: "LocalizationResult", sure: FloatArray) -> None:
    for kind, colour in KIND_COLOURS.items():
        places = [
            each.map_t_landmark for each in result.run.landmarks if each.semantics.kind is kind
        ]
        if places:
            x, y = np.array(places).T
            axes.scatter(x, y, s=9, color=colour, label=f"{Kind(kind).label} of the map")
    stamps_ns = result.particles.stamps_ns
    points = broken_at_gaps(stamps_ns, sure[:, :2])
    axes.plot(*points.T, color=BLUE, linewidth=2.2, label="global localization")
    fast = broken_at_gaps(result.run.fast.stamps_ns, result.run.fast.map_T_bases[:, :2])
    axes.plot(*fast.T, color=ORANGE, linewidth=1.1, label="fast estimator")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x in map [m]", color=INK)
    axes.set_ylabel("y in map [m]", color=INK)


def _draw_differences(panels: list["Axes"], result: "LocalizationResult") -> None:
    """How far the fast estimate lies from the global one, where that is sure."""
    position, heading = panels
    seconds, metres, degrees = _differences(result.run.fast, result)
    position.plot(seconds, metres, color=ORANGE, linewidth=1.1)
    heading.plot(seconds, degrees, color=ORANGE, linewidth=1.1)
    position.set_ylabel("apart [m]", color=INK)
    heading.set_ylabel("turned [deg]", color=INK)
    for axes in panels:
        axes.tick_params(labelbottom=False)


def _differences(
    fast: Trajectory, result: "LocalizationResult"
) -> tuple[FloatArray, FloatArray, FloatArray]:
    _, rows, others = np.intersect1d(
        fast.stamps_ns, result.particles.stamps_ns, return_indices=True
    )
    kept = result.particle_qualities[others] >= _SURE
    rows, others = rows[kept], others[kept]
    apart = fast.map_T_bases[rows] - result.particles.map_T_bases[others]
    seconds = (fast.stamps_ns[rows] - result.particles.stamps_ns[0]) * 1e-9
    return seconds, np.hypot(apart[:, 0], apart[:, 1]), np.degrees(wrap_angle(apart[:, 2]))


def _draw_quality(axes: "Axes", result: "LocalizationResult") -> None:
    stamps_ns = np.array([each.stamp_ns for each in result.localized])
    seconds = (stamps_ns - stamps_ns[0]) * 1e-9
    axes.plot(seconds, [each.quality for each in result.localized], color=INK, linewidth=1.1)
    by_particles = [each.num_particles > 0 for each in result.localized]
    axes.fill_between(seconds, 0.0, 1.0, where=by_particles, step="mid", color=GREY, alpha=0.25)
    axes.set_ylim(-0.02, 1.02)
    axes.set_ylabel("quality", color=INK)
    axes.set_xlabel("time since the start [s]; grey: the particle filter at work", color=INK)


def _notes(result: "LocalizationResult") -> list[str]:
    _, metres, degrees = _differences(result.run.fast, result)
    num_switches = sum("takes over" in event for event in result.run.events)
    notes = [f"{num_switches} changes of the estimator"]
    if len(metres):
        rms = float(np.sqrt(np.mean(metres**2)))
        turned = float(np.sqrt(np.mean(degrees**2)))
        notes.append(f"apart: RMS {rms:.3f} m, {turned:.2f} deg; largest {metres.max():.3f} m")
    return notes
