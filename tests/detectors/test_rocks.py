"""Rocks: half balls are found where they stand, nothing else is, whatever the image."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detectors.catalog import create_detector
from detectors.rock_settings import RockSettings
from detectors.rocks import ROCKS, RockDetector
from semgraph.arrays import FloatArray
from semgraph.errors import SettingsError
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import CameraGeometry, DepthImage, Mounting, PointCloud, Tilt
from tests.detectors.hemispheres import (
    CAMERA,
    MAST,
    STAMP_NS,
    Hemisphere,
    cloud_of,
    depth_image,
    mounted,
)

RELIABLE = 0.7
FIELD: tuple[Hemisphere, ...] = ((3.0, 0.8, 0.4), (4.5, -1.2, 0.5), (6.0, 1.5, 0.6))
MOUNTINGS = (
    MAST,
    Mounting(x_m=0.5, y_m=-0.2, height_m=1.1, pitch=0.25),
    Mounting(x_m=0.1, y_m=0.3, height_m=1.5, pitch=0.35, roll=0.05, yaw=0.9),
    Mounting(x_m=-0.4, height_m=1.3, pitch=0.3, yaw=np.pi),
)
SMALL = CameraGeometry(40, 30, 29.0, (19.5, 14.5), MAST)


def _detect(image: DepthImage | PointCloud, **chosen: float) -> Perceptions:
    found = RockDetector(RockSettings.model_validate(chosen)).detect(image)
    return found.select(found.reliabilities >= RELIABLE)


def _in_base(found: Perceptions, mounting: Mounting) -> FloatArray:
    seen = found.seen_from(mounting.base_T_sensor())
    return seen.base_t_landmarks()


def _same(a: Perceptions, b: Perceptions) -> None:
    for field in Perceptions.__slots__:
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


def _seen_from(mounting: Mounting) -> list[Hemisphere]:
    """The field, before that camera."""
    balls = np.array(FIELD)
    positions = mounting.base_T_sensor().transform(balls[:, :2])
    return [(x, y, d) for (x, y), d in zip(positions.tolist(), balls[:, 2].tolist(), strict=True)]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    ("distance_m", "diameter_m"), [(2.5, 0.3), (4.0, 0.4), (6.0, 0.5), (9.0, 0.6)]
)
def test_a_half_ball_is_found_within_its_sigmas(
    distance_m: float, diameter_m: float, seed: int
) -> None:
    bearing = np.random.default_rng(seed).uniform(-0.4, 0.4)
    ball = (distance_m * np.cos(bearing), distance_m * np.sin(bearing), diameter_m)
    found = _detect(depth_image([ball], seed=seed))
    assert len(found) == 1
    assert found.kinds.tolist() == [Kind.ROCK]
    assert found.stamp_ns == STAMP_NS
    error = np.array([found.ranges_m[0] - distance_m, found.bearings[0] - bearing])
    assert error @ np.linalg.solve(found.covariances[0], error) < 11.8
    assert abs(found.diameters_m[0] - diameter_m) < 3.0 * found.diameter_sigmas_m[0]


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("tilt", [Tilt(), Tilt(0.08, -0.05), Tilt(-0.1, 0.1)])
def test_rocks_stay_where_they_are_however_the_camera_is_mounted(
    mounting: Mounting, tilt: Tilt
) -> None:
    balls = _seen_from(mounting)
    found = _detect(depth_image(balls, mounted(mounting), tilt, seed=1))
    base_t_rocks = _in_base(found, mounting)
    assert len(found) == len(balls)
    for x, y, _ in balls:
        assert np.linalg.norm(base_t_rocks - (x, y), axis=1).min() < 0.12


def test_turning_the_camera_and_all_it_sees_changes_nothing() -> None:
    turned = replace(MAST, yaw=1.1)
    here = _detect(depth_image(_seen_from(MAST)))
    there = _detect(depth_image(_seen_from(turned), mounted(turned)))
    assert len(here) == len(FIELD)
    np.testing.assert_allclose(there.ranges_m, here.ranges_m, atol=1e-6)
    np.testing.assert_allclose(there.bearings, here.bearings, atol=1e-6)
    np.testing.assert_allclose(there.reliabilities, here.reliabilities, atol=1e-6)


def test_a_mirrored_image_gives_mirrored_perceptions() -> None:
    """But for the cells of the ground, which begin at the other side."""
    detector = RockDetector(RockSettings(stride_px=1))
    image = depth_image(FIELD, seed=2)
    here = detector.detect(image)
    there = detector.detect(replace(image, depths_m=image.depths_m[:, ::-1]))
    here_order, there_order = np.argsort(here.ranges_m), np.argsort(there.ranges_m)
    assert len(here) >= len(FIELD)
    np.testing.assert_allclose(there.bearings[there_order], -here.bearings[here_order], atol=5e-3)
    np.testing.assert_allclose(there.ranges_m[there_order], here.ranges_m[here_order], atol=5e-3)


def test_a_cloud_of_the_same_points_gives_the_same_rocks() -> None:
    image = depth_image(FIELD, seed=3)
    from_image, from_cloud = _detect(image), _detect(cloud_of(image))
    assert len(from_cloud) == len(from_image) == len(FIELD)
    assert from_cloud.stamp_ns == STAMP_NS
    np.testing.assert_allclose(
        np.sort(from_cloud.ranges_m), np.sort(from_image.ranges_m), atol=0.08
    )


@pytest.mark.parametrize("seed", range(5))
def test_flat_ground_has_no_rock(seed: int) -> None:
    assert len(_detect(depth_image([], seed=seed))) == 0


@pytest.mark.parametrize("depth_m", [0.5, 1.0, 3.0, 8.0, 15.0])
@pytest.mark.parametrize("camera", [CAMERA, mounted(Mounting(height_m=0.5)), SMALL])
def test_a_wall_is_no_rock(depth_m: float, camera: CameraGeometry) -> None:
    wall = np.full((camera.height, camera.width), depth_m)
    assert len(_detect(DepthImage(STAMP_NS, camera, wall))) == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, -2.0, 1e308])
def test_no_depth_is_no_perception(value: float) -> None:
    image = DepthImage(STAMP_NS, SMALL, np.full((30, 40), value))
    found = RockDetector(RockSettings(min_reliability=0.0)).detect(image)
    assert len(found) == 0
    assert found.stamp_ns == STAMP_NS


def test_an_empty_cloud_is_no_perception() -> None:
    nothing = PointCloud(STAMP_NS, MAST, np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
    assert len(_detect(nothing)) == 0


@given(data=st.data())
@settings(max_examples=120, deadline=None, derandomize=True)
def test_hostile_images_give_valid_perceptions_again_and_again(data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    odd = data.draw(st.lists(st.floats(allow_nan=True), min_size=1, max_size=8))
    depths_m = rng.uniform(0.3, 14.0, (30, 40))
    chosen = rng.uniform(size=depths_m.shape) < data.draw(st.sampled_from([0.0, 0.1, 0.9]))
    depths_m[chosen] = rng.choice(odd, int(chosen.sum()))
    tilt = Tilt(*data.draw(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))))
    height_m = data.draw(st.sampled_from([0.0, 0.3, 1.3, -1.0]))
    camera = replace(SMALL, mounting=replace(MAST, height_m=height_m))
    image = DepthImage(STAMP_NS, camera, depths_m, tilt)
    detector = RockDetector(
        RockSettings(stride_px=data.draw(st.integers(1, 8)), min_pixels=2, min_reliability=0.0)
    )
    found = detector.detect(image)
    _same(found, detector.detect(image))
    assert (found.ranges_m < 12.0).all()
    assert (np.abs(found.bearings) <= np.pi).all()


@given(data=st.data())
@settings(max_examples=60, deadline=None, derandomize=True)
def test_hostile_clouds_give_valid_perceptions(data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    num, scale = data.draw(st.integers(0, 400)), data.draw(st.sampled_from([0.0, 1.0, 9.0, 1e200]))
    points = rng.uniform(-1.0, 1.0, (num, 3)) * scale
    cloud = PointCloud(STAMP_NS, MAST, points, np.full(num, -1))
    found = RockDetector(RockSettings(min_pixels=2, min_reliability=0.0)).detect(cloud)
    assert found.stamp_ns == STAMP_NS


def test_a_point_right_below_the_sensor_is_no_trouble() -> None:
    cloud = PointCloud(
        STAMP_NS, Mounting(height_m=1.0), np.array([[0.0, 0.0, -1.0]]), np.zeros(1, int)
    )
    assert len(_detect(cloud)) == 0


def test_the_image_is_left_as_it_was() -> None:
    image = depth_image(FIELD, seed=4)
    before = image.depths_m.copy()
    RockDetector(RockSettings()).detect(image)
    np.testing.assert_array_equal(image.depths_m, before)


def test_no_two_perceptions_are_of_one_rock() -> None:
    found = RockDetector(RockSettings(min_reliability=0.0)).detect(depth_image(FIELD, seed=5))
    places = found.base_t_landmarks()
    apart_m = np.linalg.norm(places[:, None] - places[None], axis=2) + 9.0 * np.eye(len(found))
    assert apart_m.min() > 0.05


def test_the_catalog_knows_it() -> None:
    assert ROCKS.looks_at is DepthImage
    found = create_detector("rocks", {"range_max_m": 5.5}).detect(depth_image(FIELD, seed=6))
    assert (found.ranges_m < 5.5).all()
    assert len(found) >= 2


@pytest.mark.parametrize(
    ("low", "high", "value"),
    [("diameter_min_m", "diameter_max_m", 3.0), ("range_min_m", "range_max_m", 20.0)],
)
def test_limits_out_of_order_are_refused(low: str, high: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"expected {low} below {high}"):
        create_detector("rocks", {low: value})
