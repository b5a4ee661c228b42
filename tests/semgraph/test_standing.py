"""What stands, what walks by, and what is felled between two laps, from laser scans."""

import numpy as np
import pytest

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, wrap_angle
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.results import RunResult
from semgraph.settings import load_settings
from sensors.measurements import LaserScan, Measurement, OdometryNoise, Recording
from sensors.simulation.lms151 import Lms151, Resolution
from sensors.simulation.wheels import simulate_wheels
from sensors.simulation.world import Thing, World

RADIUS_M, SPEED, RATE_HZ = 5.0, 1.5, 5.0
LAP_S = 2.0 * np.pi * RADIUS_M / SPEED
DEVICE = Lms151(Resolution.HALF_DEGREE)


def stand(seed: int) -> World:
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(-9.0, 10.0, 3.6), np.arange(-9.0, 10.0, 3.6))
    trees = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.6, 0.6, (x.size, 2))
    trees = trees[np.abs(np.hypot(*trees.T) - RADIUS_M) > 0.9]
    return World.of(Thing.STEM, trees, rng.uniform(0.2, 0.4, len(trees)), rng)


def two_laps(seed: int, felled: int | None = None, walker: FloatArray | None = None) -> RunResult:
    """`felled`: a row of the stand that is missing in the second lap; `walker` (2,) m/s
    passes the middle after a lap."""
    rng = np.random.default_rng([seed, 1])
    trees = stand(seed)
    seconds = np.arange(0.0, 2.0 * LAP_S, 1.0 / RATE_HZ)
    angles = SPEED / RADIUS_M * seconds
    poses = np.column_stack(
        [RADIUS_M * np.cos(angles), RADIUS_M * np.sin(angles), wrap_angle(angles + np.pi / 2.0)]
    )
    stamps_ns = np.round(seconds * 1e9).astype(np.int64)
    scans: list[LaserScan] = []
    for k, pose in enumerate(poses):
        world = trees
        if felled is not None and seconds[k] > LAP_S:
            world = trees.select(np.delete(np.arange(len(trees)), felled))
        if walker is not None:
            place = np.array([[0.3, 0.2]]) + walker * (seconds[k] - LAP_S)
            world = World.union([world, World.of(Thing.PERSON, place, np.array([0.4]), rng)])
        scans.append(DEVICE.scan(world, Pose2.from_array(pose), rng, stamp_ns=int(stamps_ns[k])))
    wheels = simulate_wheels(stamps_ns, poses, OdometryNoise(), rng)
    measurements: list[Measurement] = [
        each for pair in zip(wheels, scans, strict=True) for each in pair
    ]
    recording = Recording(
        "two laps",
        measurements,
        len(scans),
        OdometryNoise(),
        {"trees-2d": {}},
        map_T_start=Pose2.from_array(poses[0]),
    )
    settings = load_settings(None, [])
    return run(recording, settings, Perceiver(recording, settings), Silence(), {})


def distances(result: RunResult, place: FloatArray) -> FloatArray:
    places = np.array([each.map_t_landmark for each in result.landmarks])
    nearest: FloatArray = np.linalg.norm(places - place, axis=1)
    return nearest


@pytest.mark.parametrize("seed", [1, 2])
def test_where_nothing_changes_nothing_goes(seed: int) -> None:
    result = two_laps(seed)
    assert result.gone == ()
    trees = stand(seed).world_t_things
    assert sum(distances(result, tree).min() < 0.2 for tree in trees) >= 0.9 * len(trees)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_tree_felled_between_the_laps_is_gone_within_five_looks_in_vain(seed: int) -> None:
    trees = stand(seed).world_t_things
    felled = int(np.abs(np.hypot(*trees.T) - RADIUS_M - 2.0).argmin())
    result = two_laps(seed, felled)
    assert distances(result, trees[felled]).min() > 0.5
    (gone,) = result.gone
    np.testing.assert_allclose(gone.landmark.map_t_landmark, trees[felled], atol=0.2)
    assert gone.num_misses <= 5
    assert any(event.startswith("gone at scan") for event in result.events)


@pytest.mark.parametrize("velocity", [(1.2, 0.0), (0.9, 0.8)])
def test_who_walks_through_is_never_a_landmark(velocity: tuple[float, float]) -> None:
    alone, result = two_laps(3), two_laps(3, walker=np.array(velocity))
    for landmark in result.landmarks:
        assert distances(alone, landmark.map_t_landmark).min() < 0.3
    assert len(result.landmarks) >= 0.9 * len(alone.landmarks)
