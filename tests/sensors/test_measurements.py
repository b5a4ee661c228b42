import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.measurements import (
    CameraGeometry,
    CameraImage,
    DepthImage,
    Mounting,
    PointCloud,
    Tilt,
)

CAMERA = CameraGeometry(4, 3, 5.0, (1.5, 1.0), Mounting(0.5, 0.2, 1.3, pitch=0.3, yaw=0.1))
ANGLES = st.floats(-1.5, 1.5)


@given(ANGLES, ANGLES, ANGLES)
def test_angles_turn_as_yaw_then_pitch_then_roll(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(
        Mounting(roll=roll, pitch=pitch, yaw=yaw).base_R_sensor(), expected, atol=1e-12
    )


def test_nose_down_is_positive() -> None:
    ahead = Tilt(pitch=0.1).level_R_base() @ [1.0, 0.0, 0.0]
    assert ahead[2] < 0.0


def test_what_is_seen_is_seen_from_where_the_camera_sits() -> None:
    image = DepthImage(0, CAMERA, np.full((3, 4), np.nan))
    assert image.base_T_sensor == Pose2(0.5, 0.2, 0.1)


@pytest.mark.parametrize(
    "make",
    [
        lambda: CameraGeometry(0, 3, 5.0, (1.5, 1.0)),
        lambda: CameraGeometry(4, 3, -5.0, (1.5, 1.0)),
        lambda: DepthImage(0, CAMERA, np.zeros((4, 3))),
        lambda: CameraImage(0, CAMERA, np.zeros((3, 4))),  # type: ignore[arg-type]  # floats
        lambda: CameraImage(0, CAMERA, np.zeros((4, 3), dtype=np.uint8)),
        lambda: PointCloud(0, Mounting(), np.zeros((2, 2)), np.zeros(2, dtype=np.int64)),
        lambda: PointCloud(0, Mounting(), np.full((2, 3), np.nan), np.zeros(2, dtype=np.int64)),
        lambda: PointCloud(0, Mounting(), np.zeros((2, 3)), np.zeros(3, dtype=np.int64)),
    ],
)
def test_what_no_device_gives_is_refused(make: type) -> None:
    with pytest.raises(InputError):
        make()


def test_an_image_stays_as_it_was_taken() -> None:
    grey = np.zeros((3, 4), dtype=np.uint8)
    image = CameraImage(0, CAMERA, grey)
    grey[:] = 9
    assert image.grey.max() == 0
    assert not image.grey.flags.writeable
