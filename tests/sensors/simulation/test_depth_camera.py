"""The simulated depth camera: what it sees, how it errs, the same again by seed."""

import builtins
import importlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.measurements import CameraGeometry, Mounting, Tilt
from sensors.simulation import depth_camera
from sensors.simulation.depth_camera import (
    NO_ROCK,
    DepthCamera,
    DepthNoise,
    Scene,
    Stereo,
    TimeOfFlight,
    View,
)
from sensors.simulation.rock_shapes import rock_vertices
from sensors.simulation.terrain import MEDIUM, Terrain, rough_terrain

try:
    importlib.import_module("open3d")
except (ImportError, OSError) as error:
    pytest.skip(f"Open3D does not load: {error}", allow_module_level=True)

CAMERA = CameraGeometry(160, 120, 114.0, (79.5, 59.5), Mounting(height_m=1.3, pitch=0.3))
QUIET = DepthCamera(CAMERA, edge_dropout=0.0, dropout=0.0, tilt_sigma=0.0)


def _flat(rocks: Mapping[tuple[float, float], float]) -> Terrain:
    """Flat ground with rocks of these diameters at these places."""
    places, diameters_m = np.array(list(rocks)).reshape(-1, 2), np.array(list(rocks.values()))
    meshes = rock_vertices(diameters_m, np.random.default_rng(0))
    meshes[:, :, :2] += places[:, None]
    return Terrain(0.1, np.zeros((301, 301)), places, diameters_m, meshes)


def test_flat_ground_is_seen_where_it_is() -> None:
    view = Scene(_flat({(-9.0, -9.0): 0.3})).view(CAMERA, Pose2(0.3, 0.2, 0.8))
    up = (CAMERA.centre_px[1] - np.arange(CAMERA.height)) / CAMERA.focal_px
    down = np.sin(0.3) - up * np.cos(0.3)
    seen = down > 0.15
    expected = np.broadcast_to((1.3 / down[seen])[:, None], (int(seen.sum()), CAMERA.width))
    np.testing.assert_allclose(view.depths_m[seen], expected, rtol=1e-4)
    assert np.isnan(view.depths_m[down < 0.0]).all()
    assert (view.rocks == NO_ROCK).all()
    assert (view.tilt.roll, view.tilt.pitch) == (0.0, 0.0)


@pytest.mark.parametrize("theta", [0.0, 1.0, -2.0])
def test_a_rock_is_seen_where_it_is(theta: float) -> None:
    pose = Pose2(1.0, -2.0, theta)
    ((x, y),) = pose.transform(np.array([[4.0, 0.5]]))
    view = Scene(_flat({(x, y): 0.6})).view(CAMERA, pose)
    rows, columns = np.nonzero(view.rocks == 0)
    left = (CAMERA.centre_px[0] - columns.mean()) / CAMERA.focal_px
    depth_m = np.median(view.depths_m[rows, columns])
    assert left * depth_m == pytest.approx(0.5, abs=0.05)
    assert 3.5 < depth_m < 4.3


def test_a_hidden_rock_has_bare_pixels_only() -> None:
    scene = Scene(_flat({(3.0, 0.0): 1.2, (4.2, 0.0): 0.2, (3.0, 9.0): 0.5}))
    view = scene.view(CAMERA, Pose2())
    bare = scene.bare_pixels(CAMERA, Pose2())
    seen = np.bincount(view.rocks[view.rocks >= 0], minlength=3)
    assert seen[0] == bare[0] > 500
    assert seen[1] == 0 < bare[1]
    assert seen[2] == bare[2] == 0


def test_the_same_seed_gives_the_same_image() -> None:
    scene = Scene(rough_terrain(replace(MEDIUM, size_m=12.0), np.random.default_rng(1)))
    device = DepthCamera(CAMERA)
    first, again, other = (
        device.look(scene, Pose2(), 7, np.random.default_rng(k)) for k in (2, 2, 3)
    )
    assert first.stamp_ns == 7
    assert first.tilt == again.tilt != other.tilt
    np.testing.assert_array_equal(first.depths_m, again.depths_m)
    assert not np.array_equal(first.depths_m, other.depths_m, equal_nan=True)


@pytest.mark.parametrize(
    ("noise", "expected_m"),
    [
        (Stereo(0.24, 0.2), 25.0 * 0.2 / (114.0 * 0.24)),
        (Stereo(0.12, 0.1), 25.0 * 0.1 / (114.0 * 0.12)),
        (TimeOfFlight(0.01, 0.002), 0.02),
    ],
)
@pytest.mark.parametrize("correlation_px", [0.0, 1.5])
def test_depths_err_as_the_model_says(
    noise: DepthNoise, expected_m: float, correlation_px: float
) -> None:
    device = replace(QUIET, noise=noise, correlation_px=correlation_px)
    image = device.measure(_wall(5.0), 0, np.random.default_rng(4))
    errors_m = image.depths_m - 5.0
    assert errors_m.std() == pytest.approx(expected_m, rel=0.05)
    beside = np.corrcoef(errors_m[:, 1:].ravel(), errors_m[:, :-1].ravel())[0, 1]
    assert beside == pytest.approx(0.0 if correlation_px == 0.0 else 0.9, abs=0.05)


@pytest.mark.parametrize("depth_m", [0.2, 25.0])
def test_nothing_is_told_out_of_range(depth_m: float) -> None:
    device = replace(QUIET, noise=TimeOfFlight())
    image = device.measure(_wall(depth_m), 0, np.random.default_rng(5))
    assert np.isnan(image.depths_m).all()


def test_pixels_are_lost_at_edges_rather_than_elsewhere() -> None:
    wall = _wall(3.0)
    depths_m = wall.depths_m.copy()
    depths_m[:, 80:] = 6.0
    device = replace(QUIET, edge_dropout=0.8, dropout=0.05)
    image = device.measure(View(depths_m, wall.rocks, wall.tilt), 0, np.random.default_rng(6))
    lost = np.isnan(image.depths_m)
    assert lost[:, 79:81].mean() == pytest.approx(0.8, abs=0.1)
    assert lost[:, 5:75].mean() == pytest.approx(0.05, abs=0.02)


@pytest.mark.parametrize(
    "wrong",
    [
        {"depth_min_m": 5.0, "depth_max_m": 2.0},
        {"dropout": 1.5},
        {"edge_dropout": float("nan")},
        {"correlation_px": -1.0},
        {"edge_step": 0.0},
    ],
)
def test_impossible_devices_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="depth camera: expected"):
        replace(QUIET, **wrong)


def test_impossible_noise_is_refused() -> None:
    with pytest.raises(InputError, match="stereo: expected"):
        Stereo(baseline_m=0.0)
    with pytest.raises(InputError, match="time of flight: expected"):
        TimeOfFlight(sigma_m=float("nan"))


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: object) -> object:
        if name == "open3d":
            raise OSError("libusb-1.0.so.0: cannot open shared object file")
        return real(name, *rest)  # type: ignore[arg-type]  # passed on as they came

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(InputError, match=r"apt-get install libusb-1\.0-0") as caught:
        depth_camera.Scene(_flat({(3.0, 0.0): 0.5}))
    assert "\n" not in str(caught.value)


def _wall(depth_m: float) -> View:
    depths_m = np.full((CAMERA.height, CAMERA.width), depth_m)

    return View(depths_m, np.full(depths_m.shape, NO_ROCK), Tilt())
