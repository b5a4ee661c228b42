"""The instants of a run in Rerun: frames, points, images, perceptions and what they matched.

Everything hangs below `map/odom/base`, as the frames do, so that points lie in the map by the
smoothed pose.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind
from semgraph.trace import Instant, Shot

if TYPE_CHECKING:
    import rerun as rr

COLORS: Final = {Kind.TREE: (46, 125, 50), Kind.ROCK: (121, 85, 72), Kind.MARKER: (21, 101, 192)}
BASE: Final = "map/odom/base"
# Radii below zero are points on the screen (Rerun, component Radius).
LINE_WIDTH: Final = -1.0
_POINT_RADIUS: Final = -1.5
_PERCEPTION_RADIUS: Final = -4.0
_POINT_COLOR: Final = (150, 150, 150)
_MATCH_COLOR: Final = (213, 94, 0)
_CHI2_2DOF_95: Final = 5.991
_UNIT_CIRCLE: Final = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 33)).view(float).reshape(-1, 2)
_AXES_M: Final = 1.0
_MM: Final = 1e3


def log_instants(
    recording: "rr.RecordingStream",
    instants: Sequence[Instant],
    trajectory: Trajectory,
    start_ns: int,
) -> None:
    """Logs each instant that lies within the trajectory, at its time since `start_ns`.

    Without wheels odom is map.
    """
    import rerun as rr

    shown = [each for each in instants if _is_within(trajectory, each.stamp_ns)]
    if not shown:
        return
    poses = trajectory.interpolate(np.array([each.stamp_ns for each in shown]))
    for name in ("map/odom", BASE, *_sensors(shown)):
        recording.log(name, rr.TransformAxes3D(_AXES_M), static=True)
    for instant, pose in zip(shown, poses, strict=True):
        since_start = np.timedelta64(instant.stamp_ns - start_ns, "ns")
        recording.set_time("time", duration=since_start)
        _log_frames(recording, instant, Pose2.from_array(pose))
        _log_perceptions(recording, instant)
        for shot in instant.shots:
            _log_shot(recording, shot)
    recording.reset_time()


def picture_entities(instants: Sequence[Instant]) -> list[str]:
    """The cameras' entities, of depths and of grey images."""
    return sorted(
        {f"{BASE}/{shot.sensor}" for each in instants for shot in each.shots if shot.picture}
    )


def ellipse_outlines(positions: FloatArray, covariances: FloatArray) -> FloatArray:
    """(n, 33, 3) the 95 % outlines of points (n, 2) with covariances (n, 2, 2), on the ground."""
    values, vectors = np.linalg.eigh(covariances.reshape(-1, 2, 2))
    roots = vectors * np.sqrt(_CHI2_2DOF_95 * np.maximum(values, 0.0))[:, None, :]
    outlines = _UNIT_CIRCLE @ roots.transpose(0, 2, 1) + positions[:, None]
    return np.pad(outlines, ((0, 0), (0, 0), (0, 1)))


def _is_within(trajectory: Trajectory, stamp_ns: int) -> bool:
    stamps_ns = trajectory.stamps_ns
    return bool(len(stamps_ns) and stamps_ns[0] <= stamp_ns <= stamps_ns[-1])


def _sensors(instants: Sequence[Instant]) -> list[str]:
    return sorted({f"{BASE}/{shot.sensor}" for each in instants for shot in each.shots})


def _log_frames(recording: "rr.RecordingStream", instant: Instant, map_T_base: Pose2) -> None:
    odom_T_base = instant.odom_T_base if instant.odom_T_base is not None else map_T_base
    recording.log("map/odom", _transform(map_T_base @ odom_T_base.inverse()))
    recording.log(BASE, _transform(odom_T_base))


def _transform(pose: Pose2) -> "rr.Transform3D":
    import rerun as rr

    half = 0.5 * pose.theta
    quaternion = [0.0, 0.0, float(np.sin(half)), float(np.cos(half))]
    return rr.Transform3D(translation=[pose.x, pose.y, 0.0], quaternion=quaternion)


def _log_perceptions(recording: "rr.RecordingStream", instant: Instant) -> None:
    """Where things were perceived, 95 % ellipses, and lines to the landmarks they were taken for.

    Lines are as the fast estimator saw them, from its own pose.
    """
    import rerun as rr

    seen, ids = instant.perceptions, instant.landmark_ids
    places = seen.base_t_landmarks()
    colors = np.array([COLORS[Kind(kind)] for kind in seen.kinds.tolist()], dtype=np.uint8)
    points = rr.Points3D(
        np.pad(places, ((0, 0), (0, 1))),
        colors=colors.reshape(-1, 3),
        radii=_PERCEPTION_RADIUS,
        labels=_labels(seen.kinds, ids),
        show_labels=False,
    )
    recording.log(f"{BASE}/perceptions", points)
    outlines = ellipse_outlines(places, seen.base_covariances())
    ellipses = rr.LineStrips3D(outlines, colors=colors.reshape(-1, 3), radii=LINE_WIDTH)
    recording.log(f"{BASE}/perceptions/ellipses", ellipses)
    matched = ids >= 0
    lines = np.stack([places[matched], instant.base_t_matched[matched]], axis=1)
    strips = np.pad(lines, ((0, 0), (0, 0), (0, 1)))
    recording.log(
        f"{BASE}/perceptions/matches",
        rr.LineStrips3D(strips, colors=[_MATCH_COLOR], radii=2.0 * LINE_WIDTH),
    )


def _labels(kinds: IntArray, landmark_ids: IntArray) -> list[str]:
    return [
        f"{Kind(kind).label} taken for {landmark}" if landmark >= 0 else f"{Kind(kind).label}, open"
        for kind, landmark in zip(kinds.tolist(), landmark_ids.tolist(), strict=True)
    ]


def _log_shot(recording: "rr.RecordingStream", shot: Shot) -> None:
    import rerun as rr

    entity = f"{BASE}/{shot.sensor}"
    recording.log(entity, rr.Transform3D(translation=shot.base_t_sensor, mat3x3=shot.base_R_sensor))
    if shot.picture is None:
        points = rr.Points3D(shot.base_t_points, colors=[_POINT_COLOR], radii=_POINT_RADIUS)
        recording.log(f"{BASE}/{shot.sensor}_points", points)
        return
    picture = shot.picture
    height, width = picture.pixels.shape
    pinhole = rr.Pinhole(
        focal_length=picture.focal_px,
        principal_point=picture.centre_px,
        width=width,
        height=height,
        camera_xyz=rr.ViewCoordinates.FLU,
    )
    recording.log(entity, pinhole)
    image = (
        rr.DepthImage(picture.pixels, meter=_MM)
        if picture.pixels.dtype == np.uint16
        else rr.Image(picture.pixels)
    )
    recording.log(f"{entity}/image", image)
