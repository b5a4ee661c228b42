"""Instants in Rerun, read back: what was perceived stands in the map where the truth has it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from semgraph.estimates import Trajectory
from semgraph.geometry import Pose2, rotation
from semgraph.results import RunResult
from semgraph.trace import Instant, Picture, Shot
from semgraph.viewer import write_recording
from tests.semgraph.rerun_files import Columns, array, read_back
from tests.semgraph.test_trace import seen

START_NS = 5_000_000_000
STAMPS_NS = START_NS + 100_000_000 * np.arange(5)
SMOOTHED = Trajectory(
    STAMPS_NS, np.column_stack([np.arange(5.0), np.full(5, 2.0), np.linspace(0.0, 1.0, 5)])
)
NOTHING = Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)))
MAP_T_THINGS = np.array([[9.0, 3.0], [7.0, -2.0]])
BASE = "/map/odom/base"


def instant(k: int, *shots: Shot, odom_T_base: Pose2 | None = None) -> Instant:
    """Two trees, the first taken for landmark 7, which lay 0.1 m ahead of it."""
    base_t_things = SMOOTHED.pose(k).inverse().transform(MAP_T_THINGS)
    matched = np.array([base_t_things[0] + (0.1, 0.0), [np.nan, np.nan]])
    perceptions = seen(int(STAMPS_NS[k]), base_t_things)
    return Instant(int(STAMPS_NS[k]), odom_T_base, perceptions, np.array([7, -1]), matched, shots)


def shot(sensor: str, picture: Picture | None = None) -> Shot:
    points = np.array([[1.0, 2.0, 0.5]], dtype=np.float32)
    return Shot(sensor, np.eye(3), np.array([0.3, 0.0, 1.0]), points, picture)


def written(folder: Path, *instants: Instant, smoothed: Trajectory = SMOOTHED) -> Columns:
    covariances = np.full((len(smoothed), 3, 3), np.nan)
    result = RunResult("run", smoothed, covariances, SMOOTHED, (), np.empty(0), 0.0, 5)
    write_recording(result, folder / "run.rrd", instants)
    return read_back(folder / "run.rrd")


def pose_of(columns: dict[str, list[object]], row: int) -> Pose2:
    """Rows with a transform only: static axes are logged of the same entity."""
    both = zip(columns["translation"], columns["quaternion"], strict=True)
    moves = [(translation, turn) for translation, turn in both if translation]
    (x, y, z), (_, _, sine, cosine) = (array(each)[0] for each in moves[row])
    assert z == 0.0
    return Pose2(x, y, 2.0 * np.arctan2(sine, cosine))


def rows_of(columns: dict[str, list[object]], name: str) -> list[np.ndarray]:
    return [array(each) for each in columns[name] if each is not None]


@pytest.mark.parametrize("odom_T_base", [None, Pose2(3.0, 1.0, -0.4)])
def test_frames_lead_from_the_map_to_what_was_perceived(
    tmp_path: Path, odom_T_base: Pose2 | None
) -> None:
    entities = written(tmp_path, *(instant(k, odom_T_base=odom_T_base) for k in range(5)))
    places = rows_of(entities[f"{BASE}/perceptions"], "positions")
    assert len(places) == 5
    for k in range(5):
        map_T_odom = pose_of(entities["/map/odom"], k)
        map_T_base = map_T_odom @ pose_of(entities[BASE], k)
        np.testing.assert_allclose(map_T_base.as_array(), SMOOTHED.pose(k).as_array(), atol=1e-5)
        np.testing.assert_allclose(map_T_base.transform(places[k][:, :2]), MAP_T_THINGS, atol=1e-5)
    if odom_T_base is not None:
        np.testing.assert_allclose(
            pose_of(entities[BASE], 2).as_array(), odom_T_base.as_array(), atol=1e-6
        )
    times = [each for each in entities[BASE]["time"] if each is not None]
    assert times == [100_000_000 * k for k in range(5)]


def test_matches_are_lines_and_open_ones_have_none(tmp_path: Path) -> None:
    entities = written(tmp_path, instant(2))
    (lines,) = rows_of(entities[f"{BASE}/perceptions/matches"], "strips")
    assert lines.shape == (1, 2, 3)
    np.testing.assert_allclose(lines[0, 1] - lines[0, 0], [0.1, 0.0, 0.0], atol=1e-6)
    (labels,) = entities[f"{BASE}/perceptions"]["labels"]
    assert labels == ["tree taken for 7", "tree, open"]


def test_ellipses_are_of_95_percent_about_what_was_perceived(tmp_path: Path) -> None:
    shown = instant(1)
    (outlines,) = rows_of(written(tmp_path, shown)[f"{BASE}/perceptions/ellipses"], "strips")
    offsets = outlines[:, :, :2] - shown.perceptions.base_t_landmarks()[:, None]
    inverse = np.linalg.inv(shown.perceptions.base_covariances())
    squared = np.einsum("nki,nij,nkj->nk", offsets, inverse, offsets)
    np.testing.assert_allclose(squared, -2.0 * np.log(0.05), rtol=1e-3)


def test_an_instant_without_perceptions_clears_the_one_before(tmp_path: Path) -> None:
    none = seen(int(STAMPS_NS[3]), np.zeros((0, 2)))
    empty = replace(
        instant(3),
        perceptions=none,
        landmark_ids=np.empty(0, dtype=np.int64),
        base_t_matched=np.zeros((0, 2)),
    )
    entities = written(tmp_path, instant(2), empty)
    for name in ("", "/ellipses", "/matches"):
        columns = entities[f"{BASE}/perceptions{name}"]
        (key,) = {"positions", "strips"} & columns.keys()
        assert [len(each) for each in rows_of(columns, key)][1] == 0


def test_points_and_pictures_hang_below_their_sensor(tmp_path: Path) -> None:
    depths = Picture(np.full((24, 32), 4000, dtype=np.uint16), 25.0, (15.5, 11.5))
    grey = Picture(np.full((24, 32), 90, dtype=np.uint8), 25.0, (15.5, 11.5))
    entities = written(
        tmp_path, instant(0, shot("laser"), shot("depth_camera", depths), shot("camera", grey))
    )
    (points,) = rows_of(entities[f"{BASE}/laser_points"], "positions")
    np.testing.assert_allclose(points, [[1.0, 2.0, 0.5]])
    for name in ("laser", "depth_camera", "camera"):
        (translation,) = rows_of(entities[f"{BASE}/{name}"], "translation")
        np.testing.assert_allclose(translation[0], [0.3, 0.0, 1.0], atol=1e-6)
    (projection,) = rows_of(entities[f"{BASE}/camera"], "image_from_camera")
    np.testing.assert_allclose(
        projection.reshape(3, 3).T, [[25.0, 0.0, 15.5], [0.0, 25.0, 11.5], [0.0, 0.0, 1.0]]
    )
    assert f"{BASE}/camera_points" not in entities
    assert rows_of(entities[f"{BASE}/depth_camera/image"], "meter")[0].tolist() == [1000.0]
    (buffer,) = (each for each in entities[f"{BASE}/camera/image"]["buffer"] if each)
    assert len(array(buffer).ravel()) == 24 * 32


def test_pictures_have_views_of_their_own(tmp_path: Path) -> None:
    grey = Picture(np.zeros((24, 32), dtype=np.uint8), 25.0, (15.5, 11.5))
    written(tmp_path, instant(0, shot("camera", grey)))
    with_one = str(read_back(tmp_path / "run.rrd", blueprint=True))
    written(tmp_path, instant(0, shot("laser")))
    without = str(read_back(tmp_path / "run.rrd", blueprint=True))
    assert "map/odom/base/camera" in with_one
    assert "2D" in with_one
    assert "2D" not in without


def test_instants_outside_the_trajectory_are_left_out(tmp_path: Path) -> None:
    inner = Trajectory(STAMPS_NS[1:4], SMOOTHED.map_T_bases[1:4])
    entities = written(tmp_path, *(instant(k) for k in range(5)), smoothed=inner)
    assert len(rows_of(entities[f"{BASE}/perceptions"], "positions")) == 3
    entities = written(tmp_path, *(instant(k) for k in range(5)), smoothed=NOTHING)
    assert len(rows_of(entities[f"{BASE}/perceptions"], "positions")) == 5


def test_a_turned_sensor_is_turned(tmp_path: Path) -> None:
    R = np.eye(3)
    R[:2, :2] = rotation(0.5)
    entities = written(tmp_path, instant(0, replace(shot("laser"), base_R_sensor=R)))
    (mat,) = rows_of(entities[f"{BASE}/laser"], "mat3x3")
    np.testing.assert_allclose(mat.reshape(3, 3).T, R, atol=1e-6)
