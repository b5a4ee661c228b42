"""Several sensors, one world model: it does not matter which of them saw a thing."""

import numpy as np
import pytest

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.results import RunResult
from semgraph.settings import load_settings
from sensors.measurements import LaserScan, OdometryNoise, Recording
from sensors.simulation.lms151 import Lms151, Resolution
from sensors.simulation.wheels import simulate_wheels
from sensors.simulation.world import Thing, World

SPEED = 2.0
AHEAD = Pose2(1.5, 0.2, 0.1)
ASTERN = Pose2(-0.5, -0.3, 3.0)


def world(rng: np.random.Generator) -> World:
    """Trunks and a few reflecting posts on a jittered grid beside the way."""
    x, y = np.meshgrid(np.arange(-10.0, 31.0, 5.0), [-8.0, -4.0, 4.0, 8.0])
    places = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.8, 0.8, (x.size, 2))
    is_post = np.arange(len(places)) % 6 == 0
    trees, posts = places[~is_post], places[is_post]
    return World.union(
        [
            World.of(Thing.STEM, trees, rng.uniform(0.2, 0.45, len(trees)), rng),
            World.of(Thing.REFLECTOR, posts, np.full(len(posts), 0.06), rng),
        ]
    )


def drive(seconds: float, rate_hz: float, offset_s: float) -> tuple[IntArray, FloatArray]:
    times = np.arange(offset_s, seconds, 1.0 / rate_hz)
    poses = np.column_stack(
        [SPEED * times, 0.8 * np.sin(0.3 * times), 0.8 * 0.3 / SPEED * np.cos(0.3 * times)]
    )
    return np.round(times * 1e9).astype(np.int64), poses


def scans(place: Pose2, rate_hz: float, offset_s: float, seed: int) -> list[LaserScan]:
    """Of one laser at its own rate and mounting."""
    rng = np.random.default_rng(seed)
    device = Lms151(Resolution.HALF_DEGREE, base_T_laser=place)
    things = world(np.random.default_rng(5))
    return [
        device.scan(things, Pose2.from_array(pose) @ place, rng, stamp_ns=int(stamp_ns))
        for stamp_ns, pose in zip(*drive(8.0, rate_hz, offset_s), strict=True)
    ]


def other_sensor(rate_hz: float, seed: int) -> list[Perceptions]:
    """What sees the posts itself, coarsely and now and then, say from a camera."""
    rng = np.random.default_rng(seed)
    things = world(np.random.default_rng(5))
    posts = things.world_t_things[things.things == Thing.REFLECTOR]
    seen = []
    for stamp_ns, pose in zip(*drive(8.0, rate_hz, 0.03), strict=True):
        base_t_posts = Pose2.from_array(pose).inverse().transform(posts)
        base_t_posts = base_t_posts[np.hypot(*base_t_posts.T) < 10.0]
        n = len(base_t_posts)
        seen.append(
            Perceptions.from_arrays(
                int(stamp_ns),
                Kind.MARKER,
                np.hypot(*base_t_posts.T) + rng.normal(0.0, 0.05, n),
                np.arctan2(base_t_posts[:, 1], base_t_posts[:, 0]) + rng.normal(0.0, 0.01, n),
                polar_covariances(np.full(n, 0.05), np.full(n, 0.01)),
                reliabilities=np.full(n, 0.9),
            )
        )
    return seen


def followed(*parts: list[LaserScan] | list[Perceptions]) -> RunResult:
    measurements = sorted((m for part in parts for m in part), key=lambda m: m.stamp_ns)
    stamps = np.union1d(drive(8.0, 100.0, 0.0)[0], [m.stamp_ns for m in measurements])
    stamps = stamps.astype(np.int64)
    times = stamps * 1e-9
    poses = np.column_stack(
        [SPEED * times, 0.8 * np.sin(0.3 * times), 0.8 * 0.3 / SPEED * np.cos(0.3 * times)]
    )
    wheels = simulate_wheels(stamps, poses, OdometryNoise(), np.random.default_rng(1))
    recording = Recording(
        "two lasers",
        sorted([*wheels, *measurements], key=lambda m: m.stamp_ns),
        len(measurements),
        OdometryNoise(),
        {"trees-2d": {}, "reflectors": {"post_width_m": 0.06}},
        map_T_start=Pose2.from_array(poses[0]),
    )
    settings = load_settings(None, [])
    return run(recording, settings, Perceiver(recording, settings), Silence(), {})


def test_one_thing_seen_by_several_sensors_is_one_landmark() -> None:
    result = followed(
        scans(AHEAD, 12.5, 0.0, 2), scans(ASTERN, 5.0, 0.013, 3), other_sensor(4.0, 4)
    )
    things = world(np.random.default_rng(5))
    trees = things.world_t_things[things.things == Thing.STEM]
    posts = things.world_t_things[things.things == Thing.REFLECTOR]
    # A thin post is also a small trunk to the detector of trees.
    for kind, places, at_least in (
        (Kind.TREE, np.vstack([trees, posts]), len(trees)),
        (Kind.MARKER, posts, len(posts)),
    ):
        mapped = np.array(
            [each.map_t_landmark for each in result.landmarks if each.semantics.kind is kind]
        )
        distances = np.linalg.norm(mapped[:, None] - places[None], axis=2)
        nearest = distances.argmin(axis=1)
        assert len(set(nearest.tolist())) == len(mapped), f"{kind.label} twice"
        assert distances.min(axis=1).max() < 0.15
        assert len(mapped) >= 0.8 * at_least


@pytest.mark.parametrize("kind", [Kind.TREE, Kind.MARKER])
def test_a_second_sensor_makes_the_map_surer(kind: Kind) -> None:
    alone = followed(scans(AHEAD, 12.5, 0.0, 2))
    both = followed(scans(AHEAD, 12.5, 0.0, 2), scans(ASTERN, 5.0, 0.013, 3))
    pairs = [
        (one, other)
        for one in alone.landmarks
        for other in both.landmarks
        if one.semantics.kind is other.semantics.kind is kind
        and np.linalg.norm(one.map_t_landmark - other.map_t_landmark) < 0.2
    ]
    surer = [np.trace(other.covariance) < np.trace(one.covariance) for one, other in pairs]
    assert np.mean(surer) > 0.9
    assert kind in {each.semantics.kind for each in both.landmarks}


def test_two_sensors_at_the_same_time_are_one_moment() -> None:
    once, twice = scans(AHEAD, 12.5, 0.0, 2), scans(ASTERN, 12.5, 0.0, 3)
    result = followed(once, twice)
    assert result.num_scans == len(once)
    assert len(result.landmarks) >= len(followed(once).landmarks)
