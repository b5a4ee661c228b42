"""The simulated camera: where markers appear, what hides them, and that a seed says it all."""

import numpy as np
import pytest

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.measurements import CameraGeometry, Mounting, Tilt
from sensors.simulation.marker_camera import MarkerCamera, OpticalMarkers

CAMERA = CameraGeometry(320, 240, 300.0, (159.5, 119.5), Mounting(height_m=1.0))
CLEAR = MarkerCamera(CAMERA, blur_px=0.0, noise=0.0, exposures=(1.0, 1.0))
AHEAD = np.array([[2.0, 0.0, 1.0]])


def _markers(
    positions: FloatArray, yaws: FloatArray | None = None, edge_m: float = 0.4
) -> OpticalMarkers:
    n = len(positions)
    facing = np.full(n, np.pi) if yaws is None else yaws
    return OpticalMarkers(np.arange(n), positions, facing, edge_m)


def _grey(
    markers: OpticalMarkers, camera: MarkerCamera = CLEAR, seed: int = 0, tilt: Tilt | None = None
) -> FloatArray:
    image = camera.image(markers, Pose2(), np.random.default_rng(seed), stamp_ns=7, tilt=tilt)
    assert image.stamp_ns == 7
    return image.grey.astype(np.float64)


def test_a_seed_says_it_all() -> None:
    camera = MarkerCamera(CAMERA)
    first, again, other = (_grey(_markers(AHEAD), camera, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5


def test_the_black_frame_lies_between_the_projected_corners() -> None:
    grey = _grey(_markers(AHEAD))
    # 0.4 m at 2 m and 300 px: 60 px about the centre; frame and border are 7.5 px each.
    assert (grey[91:96, 131:188] == 25.0).all()
    assert (grey[91:148, 131:136] == 25.0).all()
    assert (grey[83:88, 123:196] == 205.0).all()
    assert not (grey[78:81, 123:196] == 205.0).any()


def test_a_pixel_at_an_edge_is_mixed_by_its_covered_share() -> None:
    # The frame's left edge lies at column 129.5, so between two pixels; a shift moves it.
    shifted = AHEAD - [0.0, 0.25 * 2.0 / 300.0, 0.0]
    column = _grey(_markers(shifted))[120, 128:132]
    np.testing.assert_allclose(column, [205.0, 205.0, 0.25 * 205.0 + 0.75 * 25.0, 25.0], atol=6.0)


@pytest.mark.parametrize(("yaw", "seen"), [(np.pi, True), (np.pi - 1.4, True), (0.0, False)])
def test_from_behind_there_is_nothing(yaw: float, *, seen: bool) -> None:
    nothing = _grey(_markers(np.zeros((0, 3))))
    assert (_grey(_markers(AHEAD, np.array([yaw]))) != nothing).any() == seen


def test_what_is_behind_the_camera_is_not_seen() -> None:
    nothing = _grey(_markers(np.zeros((0, 3))))
    np.testing.assert_array_equal(_grey(_markers(-AHEAD, np.zeros(1))), nothing)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_the_nearer_marker_hides_the_farther(order: list[int]) -> None:
    near, far = AHEAD[0], AHEAD[0] + [1.0, 0.0, 0.0]
    both = OpticalMarkers(
        np.array([5, 9])[order], np.array([near, far])[order], np.full(2, np.pi), 0.4
    )
    alone = OpticalMarkers(np.array([5]), near[None], np.full(1, np.pi), 0.4)
    np.testing.assert_array_equal(_grey(both)[85:154, 125:194], _grey(alone)[85:154, 125:194])


def test_projection_goes_through_pose_mounting_and_tilt() -> None:
    mounting = Mounting(0.5, -0.2, 1.0, yaw=0.3)
    camera = MarkerCamera(CameraGeometry(320, 240, 300.0, (159.5, 119.5), mounting))
    pose = Pose2(3.0, -2.0, 1.1)
    tilt = Tilt(0.04, -0.06)
    sensor_t_point = np.array([4.0, 0.4, -0.2])
    base_t_point = mounting.base_R_sensor() @ sensor_t_point + [0.5, -0.2, 1.0]
    level = tilt.level_R_base() @ base_t_point
    world = np.append(pose.transform(level[None, :2]), level[2])
    pixels, depths_m = camera.project(world[None], pose, tilt)
    np.testing.assert_allclose(depths_m, 4.0)
    np.testing.assert_allclose(pixels, [[159.5 - 30.0, 119.5 + 15.0]])


def test_nose_down_moves_the_marker_up() -> None:
    rows = [
        np.argwhere(_grey(_markers(AHEAD), tilt=tilt) < 30.0)[:, 0].mean()
        for tilt in (Tilt(), Tilt(pitch=0.05))
    ]
    assert rows[1] < rows[0] - 5.0


@pytest.mark.parametrize(
    ("ids", "edge_m", "said"),
    [([587], 0.2, "expected ids"), ([-1], 0.2, "expected ids"), ([0], 0.0, "expected an edge")],
)
def test_impossible_markers_are_refused(ids: list[int], edge_m: float, said: str) -> None:
    with pytest.raises(InputError, match=said):
        OpticalMarkers(np.array(ids), AHEAD, np.zeros(1), edge_m)
