"""What every detector of clouds in the catalog must keep, whatever the cloud."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detectors.catalog import create_detector, detector_names, detector_type
from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, rotation, wrap_angle
from semgraph.landmarks import Perceptions
from sensors.measurements import Mounting, PointCloud, Tilt
from sensors.simulation.lidar_3d import Lidar3d
from sensors.simulation.world import Thing, World
from sensors.simulation.world_3d import UnderstoreySettings, World3d, raise_up

STAMP_NS = 1_234_567_890_123_456_789
DEVICE = Lidar3d(num_rings=32, num_columns=1024, range_sigma_m=0.0, dropout=0.0)
every_detector = pytest.mark.parametrize(
    "name", [name for name in detector_names() if detector_type(name).looks_at is PointCloud]
)
COORDINATES = st.sampled_from([0.0, -0.0, 1e-300, 1.0, 5.0, 1e6]) | st.floats(-40.0, 40.0)


def _cloud(points: FloatArray, rings: list[int] | None = None) -> PointCloud:
    numbers = np.zeros(len(points), np.int64) if rings is None else np.array(rings, np.int64)
    return PointCloud(STAMP_NS, Mounting(height_m=1.2), points.reshape(-1, 3), numbers)


def _trunks(seed: int) -> tuple[PointCloud, World3d]:
    """Upright trunks well apart, from 3 to 9 m, on level ground."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(-2.9, 2.9, 9) + rng.uniform(-0.1, 0.1, 9)
    places = rng.uniform(3.0, 9.0, (9, 1)) * np.column_stack([np.cos(angles), np.sin(angles)])
    flat = World.of(Thing.STEM, places, rng.uniform(0.2, 0.5, 9), rng)
    world = raise_up(flat, rng, UnderstoreySettings(lean_sigma=0.0))
    return DEVICE.scan(world, Pose2(), rng, stamp_ns=STAMP_NS), world


def _same(a: Perceptions, b: Perceptions) -> None:
    for field in Perceptions.__slots__:
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


@every_detector
@pytest.mark.parametrize("num_points", [0, 1, 2, 50])
def test_a_cloud_of_next_to_nothing_is_no_perception(name: str, num_points: int) -> None:
    points = np.tile([[5.0, 0.0, 0.0]], (num_points, 1))
    perceptions = create_detector(name, {}).detect(_cloud(points))
    assert len(perceptions) == 0
    assert perceptions.stamp_ns == STAMP_NS


@every_detector
def test_bare_ground_is_no_perception(name: str) -> None:
    nothing = _trunks(0)[1].select(np.zeros(9, dtype=bool))
    ground = DEVICE.scan(nothing, Pose2(), np.random.default_rng(0), tilt=Tilt(0.05, -0.04))
    assert len(ground.rings) > 1000
    assert len(create_detector(name, {}).detect(ground)) == 0


@every_detector
@given(data=st.data())
@settings(max_examples=150, deadline=None)
def test_odd_clouds_give_valid_perceptions_again_and_again(name: str, data: st.DataObject) -> None:
    points = data.draw(st.lists(st.tuples(COORDINATES, COORDINATES, COORDINATES), max_size=60))
    rings = st.lists(st.integers(-1, 5), min_size=len(points), max_size=len(points))
    cloud = _cloud(np.array(points, dtype=np.float64), data.draw(rings))
    detector = create_detector(name, {})
    first = detector.detect(cloud)
    assert first.stamp_ns == STAMP_NS
    _same(first, detector.detect(cloud))


@every_detector
@pytest.mark.parametrize("seed", range(5))
def test_clutter_does_not_break_it(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-15.0, 15.0, (20_000, 3)) * (1.0, 1.0, 0.1)
    cloud = _cloud(points, rng.integers(-1, 32, 20_000).tolist())
    perceptions = create_detector(name, {}).detect(cloud)
    assert (perceptions.ranges_m < 40.0).all()


@every_detector
@pytest.mark.parametrize("seed", range(4))
def test_trunks_are_found_once_each_where_they_stand(name: str, seed: int) -> None:
    cloud, world = _trunks(seed)
    perceptions = create_detector(name, {}).detect(cloud)
    assert len(perceptions) == len(world)
    apart_m = np.linalg.norm(perceptions.base_t_landmarks()[:, None] - world.world_t_feet, axis=2)
    assert np.unique(apart_m.argmin(axis=1)).tolist() == list(range(9))
    assert apart_m.min(axis=1).max() < 0.03
    diameters_m = 2.0 * world.radii_m[apart_m.argmin(axis=1)]
    np.testing.assert_allclose(perceptions.diameters_m, diameters_m, atol=0.04)


@every_detector
def test_the_order_of_the_points_does_not_matter(name: str) -> None:
    cloud, _ = _trunks(1)
    order = np.random.default_rng(0).permutation(len(cloud.rings))
    shuffled = replace(
        cloud, sensor_t_points=cloud.sensor_t_points[order], rings=cloud.rings[order]
    )
    detector = create_detector(name, {})
    one, other = detector.detect(cloud), detector.detect(shuffled)
    assert len(one) > 0
    a, b = np.argsort(one.bearings), np.argsort(other.bearings)
    np.testing.assert_allclose(one.bearings[a], other.bearings[b], atol=1e-6)
    np.testing.assert_allclose(one.ranges_m[a], other.ranges_m[b], atol=1e-6)


@every_detector
@pytest.mark.parametrize("turn", [0.3, -1.2, np.pi])
def test_turning_the_cloud_turns_the_bearings(name: str, turn: float) -> None:
    """What stood at the seam of a turn stands elsewhere afterwards."""
    cloud, _ = _trunks(2)
    points = cloud.sensor_t_points.copy()
    points[:, :2] = points[:, :2] @ rotation(turn).T
    detector = create_detector(name, {})
    there, here = detector.detect(cloud), detector.detect(replace(cloud, sensor_t_points=points))
    assert len(there) == len(here) == 9
    a = np.argsort(wrap_angle(there.bearings + turn))
    b = np.argsort(here.bearings)
    np.testing.assert_allclose(
        wrap_angle(here.bearings[b] - there.bearings[a] - turn), 0.0, atol=2e-3
    )
    np.testing.assert_allclose(here.ranges_m[b], there.ranges_m[a], atol=0.01)


@every_detector
def test_the_cloud_is_left_as_it_was(name: str) -> None:
    cloud, _ = _trunks(3)
    before = cloud.sensor_t_points.copy()
    create_detector(name, {}).detect(cloud)
    np.testing.assert_array_equal(cloud.sensor_t_points, before)
