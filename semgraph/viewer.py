"""A run for Rerun: written as a recording, opened in its viewer."""

import importlib.util
import os
import re
import shlex
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError, SemgraphError
from semgraph.landmarks import Kind, Landmark
from semgraph.results import RunResult
from semgraph.trace import Instant
from semgraph.viewer_instants import (
    COLORS,
    LINE_WIDTH,
    ellipse_outlines,
    log_instants,
    picture_entities,
)

if TYPE_CHECKING:
    import rerun as rr

_PATH_COLORS: Final = {"smoothed": (0, 114, 178), "fast": (230, 159, 0)}
_TRUNK_HEIGHT_M: Final = 2.0
_POINT_RADIUS: Final = -3.0
_ESCAPING: Final = ("utf-8", "backslashreplace")
_AT_SCAN: Final = re.compile(r"\bat scan (\d{1,12})\b")


def write_recording(result: RunResult, path: Path, instants: Sequence[Instant] = ()) -> None:
    """Writes a finished run as a Rerun recording: no server, no connection.

    Its timeline `time` counts from the run's first pose. `instants` are shown along the smoothed
    trajectory, or the fast one where there is none.

    Raises:
        SemgraphError: the file cannot be written, or Rerun cannot take a value.
    """
    import rerun as rr

    with _refusals(path):
        center, size_m = _extent(result)
        blueprint = _blueprint(center, size_m, picture_entities(instants))
        path.write_bytes(b"")  # a stream without its file would print warnings of its own
        recording = rr.RecordingStream("semgraph")
        recording.save(path, default_blueprint=blueprint)
        recording.send_recording_name(result.name.encode(*_ESCAPING).decode())
        recording.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name in ("smoothed", "fast"):
            _log_trajectory(recording, name, result, axes_m=0.03 * size_m)
        for kind in Kind:
            _log_landmarks(recording, kind, result)
        _log_events(recording, result)
        trajectory = result.smoothed if len(result.smoothed) else result.fast
        log_instants(recording, instants, trajectory, _start_ns(result))
        recording.flush()
        recording.disconnect()


def open_viewer(path: Path) -> None:
    """Opens a recording in a new Rerun viewer, on loopback only, and waits until it is closed.

    Raises:
        InputError: there is no such file.
        SemgraphError: no viewer is installed, or it cannot open; says how to look at it instead.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected the recording of a run; make one with semgraph run")
    if importlib.util.find_spec("rerun") is None:
        raise SemgraphError(f"{path}: expected the Rerun viewer; pip install rerun-sdk")
    whole = path.resolve()
    instead = f"in a browser: rerun --serve-web --bind 127.0.0.1 {shlex.quote(str(whole))}"
    if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        raise SemgraphError(f"{path}: expected a display, there is none; view it {instead}")
    listening = ["--bind", "127.0.0.1", "--port", "auto"]
    command = [sys.executable, "-m", "rerun", *listening, str(whole)]
    finished = subprocess.run(command, capture_output=True, check=False)  # noqa: S603  ours
    if finished.returncode != 0:
        reason = finished.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise SemgraphError(f"{path}: the Rerun viewer failed: {reason}; view it {instead}")


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Makes one error of whatever Rerun refuses; of itself it only warns of wrong shapes."""
    from rerun.error_utils import RerunWarning

    try:
        with warnings.catch_warnings(), np.errstate(over="raise"):
            warnings.simplefilter("error", RerunWarning)
            yield
    except (OSError, RuntimeError, ValueError, FloatingPointError, RerunWarning) as error:
        reason = " ".join(str(error).split())
        raise SemgraphError(f"{path}: the Rerun recording cannot be written: {reason}") from error


def _extent(result: RunResult) -> tuple[FloatArray, float]:
    """Centre (2,) and longer side in m, at least 1, of both paths."""
    points = np.concatenate([result.smoothed.map_T_bases, result.fast.map_T_bases])[:, :2]
    if not len(points):
        return np.zeros(2), 1.0
    return 0.5 * (points.min(axis=0) + points.max(axis=0)), max(1.0, np.ptp(points, axis=0).max())


def _blueprint(
    center: FloatArray, size_m: float, pictures: Sequence[str]
) -> "rr.blueprint.Blueprint":
    """The map from above, y up, the images beside it, and the events below."""
    import rerun.blueprint as rrb

    eye = rrb.EyeControls3D(
        position=(*center, 1.2 * size_m), look_target=(*center, 0.0), eye_up=(0.0, 1.0, 0.0)
    )
    view = rrb.Spatial3DView(origin="map", name="map", eye_controls=eye)
    events = rrb.TextLogView(origin="events", name="events")
    images = [rrb.Spatial2DView(origin=each, name=each.rpartition("/")[2]) for each in pictures]
    above = rrb.Horizontal(view, rrb.Vertical(*images), column_shares=[2, 1]) if images else view
    layout = rrb.Vertical(above, events, row_shares=[4, 1])
    return rrb.Blueprint(layout, rrb.TimePanel(timeline="time"))


def _log_trajectory(
    recording: "rr.RecordingStream", name: str, result: RunResult, *, axes_m: float
) -> None:
    """The whole path as a line, and the robot moving along it in time."""
    import rerun as rr

    trajectory = {"smoothed": result.smoothed, "fast": result.fast}[name]
    if not len(trajectory):
        return
    positions = trajectory.map_T_bases * (1.0, 1.0, 0.0)
    path = rr.LineStrips3D([positions], colors=[_PATH_COLORS[name]], radii=LINE_WIDTH)
    recording.log(f"map/{name}/path", path, static=True)
    half = 0.5 * trajectory.map_T_bases[:, 2]
    quaternions = np.column_stack([np.zeros((len(half), 2)), np.sin(half), np.cos(half)])
    moving = rr.Transform3D.columns(translation=positions, quaternion=quaternions)
    times = rr.TimeColumn("time", duration=_since_start(result, trajectory.stamps_ns))
    recording.send_columns(f"map/{name}/robot", [times], moving)
    recording.log(f"map/{name}/robot", rr.TransformAxes3D(axes_m), static=True)


def _log_landmarks(recording: "rr.RecordingStream", kind: Kind, result: RunResult) -> None:
    """Positions with labels, 95 % ellipses, and cylinders where the diameter is known."""
    import rerun as rr

    landmarks = [each for each in result.landmarks if each.semantics.kind is kind]
    if not landmarks:
        return
    entity, colors = f"map/{kind.label}s", [COLORS[kind]]
    positions = np.array([[*each.map_t_landmark, 0.0] for each in landmarks])
    labels = [f"{each.id}: {each.num_sightings} sightings" for each in landmarks]
    points = rr.Points3D(positions, colors=colors, labels=labels, radii=_POINT_RADIUS)
    recording.log(f"{entity}/positions", points, static=True)
    covariances = np.array([each.covariance for each in landmarks])
    outlines = ellipse_outlines(positions[:, :2], covariances)
    ellipses = rr.LineStrips3D(outlines, colors=colors, radii=LINE_WIDTH)
    recording.log(f"{entity}/ellipses", ellipses, static=True)
    _log_bodies(recording, kind, landmarks)


def _log_bodies(recording: "rr.RecordingStream", kind: Kind, landmarks: Sequence[Landmark]) -> None:
    """Where the diameter is known: trunks as cylinders, all else as balls on the ground."""
    import rerun as rr

    known = [(e.map_t_landmark, e.semantics.diameter) for e in landmarks]
    bodies = [(*position, diameter.mean_m) for position, diameter in known if diameter]
    if not bodies:
        return
    x, y, widths = np.transpose(bodies)
    heights = np.full_like(x, _TRUNK_HEIGHT_M) if kind is Kind.TREE else widths
    centers = np.column_stack([x, y, 0.5 * heights])
    look = {"centers": centers, "colors": [COLORS[kind]], "fill_mode": "solid"}
    body = (
        rr.Cylinders3D(lengths=heights, radii=0.5 * widths, **look)
        if kind is Kind.TREE
        else rr.Ellipsoids3D(radii=0.5 * widths, **look)
    )
    recording.log(f"map/{kind.label}s/bodies", body, static=True)


def _log_events(recording: "rr.RecordingStream", result: RunResult) -> None:
    """Each at the scan that its text names; without one, at the end of the run."""
    import rerun as rr

    if not result.events:
        return
    stamps_ns = result.fast.stamps_ns if len(result.fast) else np.zeros(1, dtype=np.int64)
    last = len(stamps_ns) - 1
    named = [_AT_SCAN.search(event) for event in result.events]
    scans = [last if scan is None else min(int(scan[1]), last) for scan in named]
    times = rr.TimeColumn("time", duration=_since_start(result, stamps_ns[scans]))
    texts = rr.TextLog.columns(text=[event.encode(*_ESCAPING).decode() for event in result.events])
    recording.send_columns("events", [times], texts)


def _since_start(result: RunResult, stamps_ns: IntArray) -> NDArray[np.timedelta64]:
    return (stamps_ns - _start_ns(result)).astype("timedelta64[ns]")


def _start_ns(result: RunResult) -> int:
    firsts = [int(each.stamps_ns[0]) for each in (result.smoothed, result.fast) if len(each)]
    return min(firsts, default=0)
