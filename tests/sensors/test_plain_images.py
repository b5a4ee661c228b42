"""Depth images and camera images in a plain folder: damaged ones, and where they stand in time."""

from pathlib import Path

import numpy as np
import pytest

from semgraph.errors import InputError
from sensors.measurements import CameraImage, DepthImage, ImuSample
from sensors.plain_folder import PlainOptions, read
from tests.sensors.sources import check_recording, write_text
from tests.sensors.test_plain_folder import HEADER, npz

CAMERA = """[camera]
width = 3
height = 2
focal_px = 4.0
centre_px = [1.0, 0.5]

[camera.mounting]
height_m = 1.3
pitch = 0.3
"""
DEPTHS = np.array([[[0, 1, 2], [3, 4, 65535]]], dtype=np.uint16)
GREY = np.arange(6, dtype=np.uint8).reshape(1, 2, 3)
ONE_LEVEL = np.zeros((1, 2))


def folder(path: Path, header: str = HEADER + CAMERA, **files: bytes) -> Path:
    write_text(path, "recording.toml", header)
    for name, content in files.items():
        (path / f"{name}.npz").write_bytes(content)
    return path


def test_images_come_in_the_order_of_time_with_depths_in_metres(tmp_path: Path) -> None:
    depth = npz(stamp_s=[1.0], depths_mm=DEPTHS, tilt=[[0.1, -0.2]])
    folder(tmp_path, depth=depth, images=npz(stamp_s=[0.5, 1.0], grey=np.repeat(GREY, 2, axis=0)))
    write_text(tmp_path, "imu.csv", "stamp_s,yaw_rate_rad_s,roll_rad,pitch_rad\n0.9,0,0,0\n1,0,,\n")
    recording = read(tmp_path, PlainOptions()).recording
    check_recording(recording)
    kinds = [type(m) for m in recording.measurements]
    assert kinds == [CameraImage, ImuSample, ImuSample, DepthImage, CameraImage]
    assert [m.tilt is None for m in recording.measurements if isinstance(m, ImuSample)] == [
        False,
        True,
    ]
    image = next(m for m in recording.measurements if isinstance(m, DepthImage))
    expected = [[np.nan, 0.001, 0.002], [0.003, 0.004, 65.535]]
    np.testing.assert_allclose(image.depths_m, expected)
    assert (image.tilt.roll, image.tilt.pitch) == (0.1, -0.2)
    assert (image.camera.mounting.height_m, image.camera.mounting.pitch) == (1.3, 0.3)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "damaged or no .npz"),
        (npz(stamp_s=[1.0]), "expected an array depths_mm"),
        (npz(stamp_s=[1.0], depths_mm=DEPTHS.astype(np.int64)), "uint16"),
        (npz(stamp_s=[1.0], depths_mm=DEPTHS[0]), "uint16"),
        (npz(stamp_s=[1.0], depths_mm=DEPTHS[:, :1]), "uint16"),
        (npz(stamp_s=[[1.0]], depths_mm=DEPTHS), "uint16"),
        (npz(stamp_s=[np.nan], depths_mm=DEPTHS), "expected times"),
        (npz(stamp_s=[1.0], depths_mm=DEPTHS, tilt=[[0.0]]), "expected tilt"),
        (npz(stamp_s=[1.0], depths_mm=DEPTHS, tilt=[[0.0, np.nan]]), "expected tilt"),
        (npz(stamp_s=[1.0], depths_mm=DEPTHS, tilt=[[0.0, 9.0]]), "expected tilt"),
        (npz(stamp_s=[1.0, 1.0], depths_mm=np.repeat(DEPTHS, 2, axis=0)), "times to increase"),
        (npz(stamp_s=[1.0], depths_mm=DEPTHS, depth=[1]), "unknown array 'depth'"),
    ],
)
def test_damaged_depth_images_are_refused(tmp_path: Path, content: bytes, expected: str) -> None:
    with pytest.raises(InputError, match=f"depth.npz: .*{expected}") as refusal:
        read(folder(tmp_path, depth=content), PlainOptions())
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("seed", range(100))
def test_no_bytes_do_more_than_be_refused(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    content = np.frombuffer(npz(stamp_s=[1.0], grey=GREY, tilt=ONE_LEVEL), dtype=np.uint8).copy()
    places = rng.integers(0, len(content), 1 + seed % 8)
    content[places] = rng.integers(0, 256, len(places))
    folder(tmp_path, images=content.tobytes()[: len(content) - seed % 3])
    message = ""
    try:
        check_recording(read(tmp_path, PlainOptions()).recording)
    except InputError as refusal:
        message = str(refusal)
    assert "\n" not in message


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (HEADER, r"expected \[camera\], since there is images.npz"),
        (HEADER + CAMERA.replace("width = 3", "width = 0"), "1 to 16384 pixels"),
        (HEADER + CAMERA.replace("width = 3", "width = 99999999"), "1 to 16384 pixels"),
        (HEADER + CAMERA.replace("pitch", "pitsch"), "did you mean 'pitch'"),
        (HEADER + CAMERA.replace("focal_px = 4.0", ""), "camera.focal_px: Field required"),
        (HEADER + CAMERA.replace("width = 3", "width = 4"), "uint8"),
        ('filters = [{name = "deskw"}]\n' + HEADER + CAMERA, "did you mean 'deskew'"),
        ('filters = [{name = "deskew", sweep_s = -1.0}]\n' + HEADER + CAMERA, "sweep_s"),
        ("filters = [{}]\n" + HEADER + CAMERA, "unknown filter ''"),
        ("filters = 1\n" + HEADER + CAMERA, "filters: Input should be a valid list"),
    ],
)
def test_a_bad_header_is_refused(tmp_path: Path, header: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected) as refusal:
        read(folder(tmp_path, header, images=npz(stamp_s=[1.0], grey=GREY)), PlainOptions())
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("imu", "expected"),
    [
        ("stamp_s,yaw_rate_rad_s,roll_rad\n1,0,0.1\n", "roll and pitch, or neither"),
        ("stamp_s,yaw_rate_rad_s,roll_rad,pitch_rad\n1,0,0.1,\n", "roll and pitch, or neither"),
        ("stamp_s,yaw_rate_rad_s,roll_rad,pitch_rad\n1,0,a,b\n", "roll_rad"),
    ],
)
def test_half_a_tilt_is_refused(tmp_path: Path, imu: str, expected: str) -> None:
    folder(tmp_path, images=npz(stamp_s=[1.0], grey=GREY))
    write_text(tmp_path, "imu.csv", imu)
    with pytest.raises(InputError, match=expected):
        read(tmp_path, PlainOptions())
