"""What a refinement came to, drawn: the map, the sessions' paths, what became of a prior map."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.figures.style import (
    BLUE,
    GREY,
    INK,
    KIND_COLOURS,
    ORANGE,
    TOP,
    broken_at_gaps,
    draw_ellipses,
    ellipses_label,
    plain,
    save,
    title,
)
from semgraph.arrays import FloatArray
from semgraph.landmarks import Kind
from semgraph.offline.map_changes import Change, Fate
from semgraph.offline.refining import Refinement

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PATHS: Final = (BLUE, ORANGE, GREY)
_FATES: Final = {
    Fate.MOVED: ("D", "#CC79A7"),
    Fate.GONE: ("x", "#D55E00"),
    Fate.UNSURE: ("s", "#E69F00"),
    Fate.NOT_VISITED: ("o", "#9A9A9A"),
    Fate.ADDED: ("P", "#0072B2"),
}
_SIZE: Final = (11.0, 8.5)


def draw_refinement(refinement: Refinement, path: Path) -> None:
    """Writes a picture: landmarks with 95 % ellipses, paths, and marks for what has changed.

    Raises:
        SemgraphError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE)
    axes = figure.subplots()
    figure.subplots_adjust(left=0.07, right=0.78, bottom=0.08, top=1.0 - TOP / _SIZE[1])
    for number, (name, trajectory) in enumerate(
        zip(refinement.names, refinement.trajectories, strict=True)
    ):
        points = broken_at_gaps(trajectory.stamps_ns, trajectory.map_T_bases[:, :2])
        axes.plot(*points.T, color=_PATHS[number % len(_PATHS)], linewidth=1.3, label=name)
    _draw_landmarks(axes, refinement)
    for fate, (marker, colour) in _FATES.items():
        _mark(axes, _places(refinement.changes or (), fate), fate, marker, colour)
    plain(axes)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x in map [m]", color=INK)
    axes.set_ylabel("y in map [m]", color=INK)
    rounds = len(refinement.refined.changes)
    notes = [f"{len(refinement.refined.landmarks)} landmarks, {rounds} rounds"]
    title(figure, f"{', '.join(refinement.names)} — refined", notes)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=9)
    save(figure, path)


def _draw_landmarks(axes: "Axes", refinement: Refinement) -> None:
    landmarks = refinement.refined.landmarks
    for kind in Kind:
        of_kind = [each for each in landmarks if each.semantics.kind is kind]
        if of_kind:
            points = np.array([each.map_t_landmark for each in of_kind])
            covariances = np.array([each.covariance for each in of_kind])
            left_out = draw_ellipses(axes, points, covariances, KIND_COLOURS[kind])
            label = ellipses_label(kind.label, len(of_kind), left_out)
            axes.plot(*points.T, ".", color=KIND_COLOURS[kind], markersize=3.0, label=label)


def _places(changes: Sequence[Change], fate: Fate) -> FloatArray:
    places = [change.map_t_landmark for change in changes if change.fate is fate]
    return np.array(places).reshape(-1, 2)


def _mark(axes: "Axes", points: FloatArray, fate: Fate, marker: str, colour: str) -> None:
    if len(points):
        axes.plot(
            *points.T,
            marker,
            color=colour,
            markerfacecolor="none",
            markersize=9,
            markeredgewidth=1.4,
            label=f"{fate.value} ({len(points)})",
            zorder=4.5,
        )
