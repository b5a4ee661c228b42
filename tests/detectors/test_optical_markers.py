"""Optical markers: what every detector keeps, equivariance, hostile images, honest covariance."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detectors.catalog import create_detector
from detectors.optical_markers import OpticalMarkerDetector, OpticalMarkerSettings, shrinkage_px
from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, wrap_angle
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import CameraGeometry, CameraImage, Mounting, Tilt
from sensors.simulation.marker_camera import MarkerCamera, OpticalMarkers

STAMP_NS = 1_234_567_890_123_456_789
EDGE_M = 0.2
POSE = Pose2(4.0, -3.0, 2.5)


def _camera(mounting: Mounting | None = None) -> CameraGeometry:
    return CameraGeometry(480, 360, 400.0, (239.5, 179.5), mounting or Mounting(height_m=1.0))


def _detector(**values: float) -> OpticalMarkerDetector:
    return OpticalMarkerDetector(OpticalMarkerSettings(edge_m=EDGE_M, **values))


def _markers(polar: FloatArray, turns: FloatArray, pose: Pose2 = POSE) -> OpticalMarkers:
    """Markers at (n, 2) range and bearing from `pose`, turned away by (n,) from facing it."""
    ranges_m, bearings = polar.T
    base = np.column_stack([ranges_m * np.cos(bearings), ranges_m * np.sin(bearings)])
    heights_m = 1.0 + 0.1 * np.arange(len(polar))
    return OpticalMarkers(
        11 * np.arange(len(polar)),
        np.column_stack([pose.transform(base), heights_m]),
        pose.theta + bearings + np.pi + turns,
        EDGE_M,
    )


def _image(
    markers: OpticalMarkers,
    seed: int = 0,
    *,
    mounting: Mounting | None = None,
    tilt: Tilt | None = None,
    pose: Pose2 = POSE,
) -> CameraImage:
    rng = np.random.default_rng(seed)
    device = MarkerCamera(_camera(mounting))
    return device.image(markers, pose, rng, stamp_ns=STAMP_NS, tilt=tilt)


def _plain(grey: FloatArray) -> CameraImage:
    height, width = grey.shape
    camera = CameraGeometry(width, height, 400.0, (width / 2, height / 2))
    return CameraImage(STAMP_NS, camera, grey.astype(np.uint8))


THREE = np.array([[1.5, 0.3], [1.8, -0.02], [2.2, -0.35]])
TURNS = np.array([0.3, -0.2, 0.5])


def _sorted(perceptions: Perceptions) -> Perceptions:
    return perceptions.select(np.argsort(perceptions.identities.astype(np.int64)))


@pytest.mark.parametrize("seed", range(5))
def test_markers_are_found_by_their_ids_where_they_are(seed: int) -> None:
    found = _sorted(_detector().detect(_image(_markers(THREE, TURNS), seed)))
    assert found.stamp_ns == STAMP_NS
    assert found.identities.tolist() == ["0", "11", "22"]
    assert found.kinds.tolist() == [Kind.MARKER] * 3
    np.testing.assert_allclose(found.ranges_m, THREE[:, 0], rtol=3e-3)
    np.testing.assert_allclose(found.bearings, THREE[:, 1], atol=3e-4)


@pytest.mark.parametrize("yaw", [-2.8, -0.7, 0.4, 3.1])
def test_turning_the_camera_and_moving_it_changes_nothing(yaw: float) -> None:
    """The world turns and moves with the camera; only rounding may differ."""
    pose = Pose2(-20.0, 7.0, yaw)
    here = _sorted(_detector().detect(_image(_markers(THREE, TURNS))))
    there = _sorted(_detector().detect(_image(_markers(THREE, TURNS, pose), pose=pose)))
    assert here.identities.tolist() == there.identities.tolist()
    np.testing.assert_allclose(there.ranges_m, here.ranges_m, rtol=1e-3)
    np.testing.assert_allclose(there.bearings, here.bearings, atol=1e-4)


@pytest.mark.parametrize("turn", [-0.25, 0.1, 0.25])
def test_turning_base_turns_the_bearings(turn: float) -> None:
    turned = Pose2(POSE.x, POSE.y, POSE.theta + turn)
    polar = THREE[1:2]
    found = _detector().detect(_image(_markers(polar, TURNS[:1]), pose=turned))
    np.testing.assert_allclose(wrap_angle(found.bearings - polar[:, 1] + turn), 0.0, atol=3e-4)
    np.testing.assert_allclose(found.ranges_m, polar[:, 0], rtol=3e-3)


@pytest.mark.parametrize(
    ("mounting", "tilt"),
    [
        (Mounting(0.4, -0.3, 1.1, yaw=0.3), Tilt()),
        (Mounting(0.0, 0.0, 0.9, roll=0.1, pitch=-0.1), Tilt()),
        (Mounting(height_m=1.0), Tilt(0.06, -0.05)),
        (Mounting(0.4, -0.3, 1.1, roll=0.1, pitch=0.08, yaw=-0.2), Tilt(-0.05, 0.06)),
    ],
    ids=["yawed", "leaning camera", "leaning base", "all"],
)
def test_mounting_and_tilt_are_taken_out(mounting: Mounting, tilt: Tilt) -> None:
    polar = np.array([[1.9, 0.05]])
    image = _image(_markers(polar, TURNS[:1]), mounting=mounting, tilt=tilt)
    from_base = _detector().detect(image).seen_from(image.base_T_sensor)
    np.testing.assert_allclose(from_base.ranges_m, polar[:, 0], rtol=3e-3)
    np.testing.assert_allclose(from_base.bearings, polar[:, 1], atol=1e-3)


@pytest.mark.parametrize("level", [0.0, 127.0, 255.0])
@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (7, 7), (240, 320)])
def test_an_even_image_gives_nothing(level: float, shape: tuple[int, int]) -> None:
    found = _detector().detect(_plain(np.full(shape, level)))
    assert len(found) == 0
    assert found.stamp_ns == STAMP_NS


@pytest.mark.parametrize("cell_px", [1, 4, 8])
@pytest.mark.parametrize("seed", range(8))
def test_noise_gives_nothing(seed: int, cell_px: int) -> None:
    """Black and white squares, too: they decode to codes, but to none of the family."""
    rng = np.random.default_rng([seed, cell_px])
    cells = rng.integers(0, 2, (240 // cell_px, 320 // cell_px)) * 255.0
    noise = np.kron(cells, np.ones((cell_px, cell_px))) if cell_px > 1 else cells
    assert len(_detector().detect(_plain(noise))) == 0


@given(data=st.data())
@settings(max_examples=60, deadline=None, derandomize=True)
def test_spoilt_images_give_valid_perceptions_again_and_again(data: st.DataObject) -> None:
    """Blocks of a real image are overwritten; whatever is left of a marker stays in its place."""
    image = _SPOILT
    grey = image.grey.copy()
    for _ in range(data.draw(st.integers(1, 12))):
        row, column = data.draw(st.integers(0, 359)), data.draw(st.integers(0, 479))
        size = data.draw(st.integers(1, 60))
        grey[row : row + size, column : column + size] = data.draw(st.sampled_from([0, 128, 255]))
    spoilt = CameraImage(STAMP_NS, image.camera, grey)
    detector = _detector()
    first, again = detector.detect(spoilt), detector.detect(spoilt)
    for field in Perceptions.__slots__:
        np.testing.assert_array_equal(getattr(first, field), getattr(again, field))
    rows = first.identities.astype(np.int64) // 11
    assert set(first.identities.tolist()) <= {"0", "11", "22"}
    np.testing.assert_allclose(first.ranges_m, THREE[rows, 0], rtol=0.1)
    np.testing.assert_allclose(first.bearings, THREE[rows, 1], atol=0.02)


_SPOILT = _image(_markers(THREE, TURNS))


def test_two_markers_of_one_id_are_left_out() -> None:
    markers = _markers(THREE, TURNS)
    doubled = OpticalMarkers(
        np.array([5, 5, 7]), markers.world_t_markers, markers.yaws, markers.edge_m
    )
    assert _detector().detect(_image(doubled)).identities.tolist() == ["7"]


def test_small_squares_are_left_out() -> None:
    image = _image(_markers(THREE, np.zeros(3)))
    found = _detector(min_edge_px=42.0).detect(image)
    assert sorted(found.identities.tolist()) == ["0", "11"]


def test_the_image_is_left_as_it_was() -> None:
    image = _image(_markers(THREE, TURNS))
    before = image.grey.copy()
    _detector().detect(image)
    np.testing.assert_array_equal(image.grey, before)


@pytest.mark.parametrize(
    ("distance_m", "turn"), [(1.2, 0.0), (1.2, 1.1), (2.5, 0.0), (2.5, 0.8), (3.5, 0.2)]
)
def test_covariance_is_honest(distance_m: float, turn: float) -> None:
    """NEES of range and bearing: far and near, facing and steep, small ones down to 23 px."""
    nees = []
    for seed in range(40):
        bearing = 0.25 * np.sin(seed)
        polar = np.array([[distance_m + 0.003 * seed, bearing]])
        found = _detector().detect(_image(_markers(polar, np.array([turn])), seed))
        if len(found):
            error = np.array([found.ranges_m[0] - polar[0, 0], found.bearings[0] - bearing])
            nees.append(error @ np.linalg.solve(found.covariances[0], error))
    assert len(nees) >= 38
    assert 0.4 < np.mean(nees) < 4.5


def test_an_overexposed_image_is_known_less_well_and_honestly() -> None:
    camera = MarkerCamera(_camera(), exposures=(1.25, 1.4))
    nees = []
    for seed in range(30):
        markers = _markers(np.array([[1.5 + 0.02 * seed, 0.1]]), np.array([0.3]))
        image = camera.image(markers, POSE, np.random.default_rng(seed))
        found = _detector().detect(image)
        error = np.array([found.ranges_m[0] - 1.5 - 0.02 * seed, found.bearings[0] - 0.1])
        nees.append(error @ np.linalg.solve(found.covariances[0], error))
    assert 0.4 < np.mean(nees) < 4.5


def test_a_steep_marker_is_known_less_well() -> None:
    sigmas = []
    for turn in (0.3, 1.15):
        found = _detector().detect(_image(_markers(THREE[1:2], np.array([turn]))))
        sigmas.append(np.sqrt(found.covariances[0, 0, 0]))
    assert sigmas[1] > 1.3 * sigmas[0]


@pytest.mark.parametrize("shrunk_px", [-1.0, 0.6])
def test_shrinkage_can_be_estimated_and_is_taken_out(shrunk_px: float) -> None:
    """Squares printed a little larger or smaller than said, at the distances given."""
    ranges_m = np.array([1.2, 1.6, 2.0])
    focal_px = 400.0
    printed_m = EDGE_M - shrunk_px * ranges_m / focal_px
    images = []
    for k, range_m in enumerate(ranges_m):
        marker = _markers(np.array([[range_m, 0.0]]), np.zeros(1))
        small = OpticalMarkers(marker.ids, marker.world_t_markers, marker.yaws, float(printed_m[k]))
        images.append(_image(small))
    raw_m = np.array([_detector().detect(image).ranges_m[0] for image in images])
    estimated_px = shrinkage_px(raw_m, ranges_m, focal_px, EDGE_M)
    assert estimated_px == pytest.approx(shrunk_px, abs=0.06)
    mended_m = [_detector(shrinkage_px=estimated_px).detect(image).ranges_m[0] for image in images]
    np.testing.assert_allclose(mended_m, ranges_m, rtol=2e-3)


def test_it_is_in_the_catalog_and_the_catalog_does_not_load_it() -> None:
    assert isinstance(create_detector("optical-markers", {}), OpticalMarkerDetector)
    program = (
        "import sys, detectors.catalog as c; c.detector_names(); sys.exit('cv2' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
