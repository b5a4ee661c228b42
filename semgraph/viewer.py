"""A run for Rerun: written as a recording, opened in its viewer."""

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.errors import SemgraphError
from semgraph.estimates import Trajectory
from semgraph.landmarks import Kind, Landmark
from semgraph.results import RunResult

if TYPE_CHECKING:
    import rerun as rr

_COLORS: Final = {
    Kind.TREE: (46, 125, 50),
    Kind.ROCK: (121, 85, 72),
    Kind.MARKER: (21, 101, 192),
}
_FAST_COLOR: Final = (230, 159, 0)
_SMOOTHED_COLOR: Final = (0, 114, 178)
_ELLIPSE_POINTS: Final = 33
_CHI2_2DOF_95: Final = 5.991
_TRUNK_HEIGHT_M: Final = 2.0


def write_recording(result: RunResult, path: Path) -> None:
    """Writes a finished run as a Rerun recording.

    Raises:
        SemgraphError: the file cannot be written.
    """
    import rerun as rr

    recording = rr.RecordingStream("semgraph", recording_id=result.name)
    try:
        recording.save(str(path), default_blueprint=_blueprint())
        _log_path(recording, "map/smoothed", result.smoothed, _SMOOTHED_COLOR)
        _log_path(recording, "map/fast", result.fast, _FAST_COLOR)
        _log_landmarks(recording, result.landmarks)
        for event in result.events:
            recording.log("events", rr.TextLog(event), static=False)
        recording.flush()
        recording.disconnect()
    except (OSError, RuntimeError, ValueError) as error:
        raise SemgraphError(f"{path}: the Rerun recording cannot be written: {error}") from error


def open_viewer(path: Path) -> None:
    """Opens a recording in the Rerun viewer and waits until it is closed.

    Raises:
        SemgraphError: there is no such file, or no viewer could be opened.
    """
    if not path.is_file():
        raise SemgraphError(f"{path}: expected the recording of a run; make one with semgraph run")
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(path)]
    finished = subprocess.run(command, check=False)  # noqa: S603  our own interpreter, a file name
    if finished.returncode != 0:
        raise SemgraphError(
            f"{path}: the Rerun viewer did not open; without a display, try "
            f"rerun --serve-web --bind 127.0.0.1 {path}"
        )


def _blueprint() -> "rr.blueprint.Blueprint":
    from rerun import blueprint

    return blueprint.Blueprint(
        blueprint.Vertical(
            blueprint.Spatial3DView(origin="map", name="map"),
            blueprint.TextLogView(origin="events", name="decisions"),
            row_shares=[4, 1],
        )
    )


def _log_path(
    recording: "rr.RecordingStream",
    entity: str,
    trajectory: Trajectory,
    color: tuple[int, int, int],
) -> None:
    """The whole path as a line, and the robot moving along it in time."""
    import rerun as rr

    if not len(trajectory):
        return
    x_y_0 = np.column_stack([trajectory.map_T_bases[:, :2], np.zeros(len(trajectory))])
    recording.log(f"{entity}/path", rr.LineStrips3D([x_y_0], colors=[color]), static=True)
    half = 0.5 * trajectory.map_T_bases[:, 2]
    nothing = np.zeros(len(half))
    quaternions = np.column_stack([nothing, nothing, np.sin(half), np.cos(half)])
    recording.log(f"{entity}/robot", rr.TransformAxes3D(1.0), static=True)
    recording.send_columns(
        f"{entity}/robot",
        indexes=[rr.TimeColumn("time", duration=1e-9 * trajectory.stamps_ns)],
        columns=rr.Transform3D.columns(translation=x_y_0, quaternion=quaternions),
    )


def _log_landmarks(recording: "rr.RecordingStream", landmarks: tuple[Landmark, ...]) -> None:
    import rerun as rr

    for kind in Kind:
        group = [landmark for landmark in landmarks if landmark.semantics.kind is kind]
        if not group:
            continue
        entity = f"map/{kind.label}s"
        centres = np.array([[*landmark.map_t_landmark, 0.0] for landmark in group])
        labels = [f"{landmark.id}: {landmark.num_sightings} sightings" for landmark in group]
        color = _COLORS[kind]
        recording.log(
            f"{entity}/centres",
            rr.Points3D(centres, colors=[color], labels=labels, show_labels=False, radii=0.1),
            static=True,
        )
        recording.log(
            f"{entity}/ellipses",
            rr.LineStrips3D([_ellipse(landmark) for landmark in group], colors=[color]),
            static=True,
        )
        _log_trunks(recording, f"{entity}/trunks", group, color)


def _log_trunks(
    recording: "rr.RecordingStream",
    entity: str,
    group: list[Landmark],
    color: tuple[int, int, int],
) -> None:
    """Those with a known diameter, as cylinders."""
    import rerun as rr

    known = [(each, each.semantics.diameter) for each in group]
    trunks = [(each, diameter) for each, diameter in known if diameter is not None]
    if trunks:
        recording.log(
            entity,
            rr.Cylinders3D(
                lengths=[_TRUNK_HEIGHT_M] * len(trunks),
                radii=[0.5 * diameter.mean_m for _, diameter in trunks],
                centers=[[*each.map_t_landmark, 0.5 * _TRUNK_HEIGHT_M] for each, _ in trunks],
                colors=[color],
            ),
            static=True,
        )


def _ellipse(landmark: Landmark) -> FloatArray:
    """(k, 3) outline of the 95 % region."""
    angles = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_POINTS)
    values, vectors = np.linalg.eigh(landmark.covariance)
    axes = vectors * np.sqrt(_CHI2_2DOF_95 * np.maximum(values, 0.0))
    outline = np.column_stack([np.cos(angles), np.sin(angles)]) @ axes.T + landmark.map_t_landmark
    return np.column_stack([outline, np.zeros(len(angles))])
