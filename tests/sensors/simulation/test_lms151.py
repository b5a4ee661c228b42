"""The simulated LMS151 against a slow reference, and what its light must and must not do."""

import math

import numpy as np
import pytest

from semgraph.arrays import IntArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.filters.limits import InvalidSettings, read_codes
from sensors.measurements import Tilt
from sensors.simulation.lms151 import GROUND, NOTHING, Lms151, Motion, Resolution
from sensors.simulation.ray_casting import chord_ranges
from sensors.simulation.world import StandSettings, Thing, World, stand_of_trees

SMALL_STAND = StandSettings(radius_m=14.0, stems_per_ha=900.0, clumps_per_stem=0.2)


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def _posts(*posts: tuple[float, float, float], thing: Thing = Thing.STEM) -> World:
    """(x, y, diameter) each."""
    columns = np.array(posts).reshape(-1, 3)
    return World.of(thing, columns[:, :2], columns[:, 2], _rng())


def _slow_echo(device: Lms151, world: World, angle: float) -> tuple[float, int]:
    """One beam as 1501 rays, each against every circle; then the first echo, in words."""
    distances_m = np.hypot(*world.world_t_things.T)
    bearings = np.arctan2(world.world_t_things[:, 1], world.world_t_things[:, 0])
    halves = device.half_widths(distances_m - world.radii_m)
    rays = angle + np.linspace(-1.0, 1.0, 1501) * halves.max()
    offsets = rays[:, None] - bearings
    hit = np.abs(offsets) < np.arcsin(world.radii_m / distances_m)
    ranges_m = np.where(hit, chord_ranges(distances_m, world.radii_m, offsets), np.inf)
    nearest = np.where(hit.any(axis=1), ranges_m.argmin(axis=1), -1)
    surfaces = []
    for k in np.unique(nearest[nearest >= 0]):
        lit = (nearest == k) & (np.abs(rays - angle) <= halves[k])
        share = lit.sum() * (rays[1] - rays[0]) / (2 * halves[k])
        if share > 0:
            surfaces.append((ranges_m[lit, k].mean(), share * world.reflectivities[k], int(k)))
    return _first_strong(device, sorted(surfaces))


def _first_strong(device: Lms151, surfaces: list[tuple[float, float, int]]) -> tuple[float, int]:
    while surfaces:
        group = [s for s in surfaces if s[0] <= surfaces[0][0] + device.echo_separation_m]
        signal = sum(s[1] for s in group)
        range_m = sum(s[0] * s[1] for s in group) / signal
        needed = max(device.min_signal, 0.1 * (range_m / device.range_at_ten_percent_m) ** 2)
        if signal >= needed:
            return range_m, group[0][2]
        surfaces = surfaces[len(group) :]
    return math.inf, NOTHING


@pytest.mark.parametrize("seed", range(2))
def test_it_agrees_with_the_slow_reference(seed: int) -> None:
    device = Lms151(Resolution.HALF_DEGREE)
    world = stand_of_trees(_rng(seed), SMALL_STAND)
    echoes = device.echoes(world, Pose2(), _rng())
    slow = [_slow_echo(device, world, angle) for angle in device.beam_angles()[::3]]
    ranges_m = np.array([range_m for range_m, _ in slow])
    sources: IntArray = np.array([source for _, source in slow])
    same = sources == echoes.sources[::3]
    # A beam whose signal is just at the threshold may fall either way.
    assert same.mean() > 0.985
    both = same & np.isfinite(ranges_m)
    assert both.sum() > 40
    errors_m = np.abs(echoes.ranges_m[::3][both] - ranges_m[both])
    assert np.percentile(errors_m, 98) < 2e-3


@pytest.mark.parametrize(
    ("resolution", "beams", "hertz"),
    [(Resolution.QUARTER_DEGREE, 1081, 25.0), (Resolution.HALF_DEGREE, 541, 50.0)],
)
def test_field_and_rate(resolution: Resolution, beams: int, hertz: float) -> None:
    device = Lms151(resolution)
    scan = device.scan(_posts((0.0, 5.0, 0.3)), Pose2(), _rng(), stamp_ns=77)
    assert len(scan.ranges_m) == beams
    assert scan.stamp_ns == 77
    assert resolution.frequency_hz == hertz
    angles = device.beam_angles()
    np.testing.assert_allclose(np.degrees(angles[[0, -1]]), [-135.0, 135.0])
    np.testing.assert_allclose(np.diff(angles), device.geometry.angle_increment)
    seen = angles[np.isfinite(scan.ranges_m)]
    assert np.degrees(seen).mean() == pytest.approx(90.0, abs=0.5)


def test_nothing_there_is_no_return() -> None:
    for world in (_posts(), _posts((-5.0, 0.0, 0.3)), _posts((70.0, 0.0, 0.5))):
        scan = Lms151().scan(world, Pose2(), _rng())
        assert np.isposinf(scan.ranges_m).all()
        assert scan.intensities is not None
        assert (scan.intensities == 0.0).all()


def test_noise_is_that_of_the_manual() -> None:
    device = Lms151(dropout=0.0)
    world = _posts((5.0, 0.0, 0.6))
    middle = device.resolution.num_beams // 2
    rng = _rng()
    ranges_m = [device.scan(world, Pose2(), rng).ranges_m[middle] for _ in range(800)]
    assert np.std(ranges_m) == pytest.approx(0.012, rel=0.1)
    assert np.mean(ranges_m) == pytest.approx(4.7, abs=0.01)


def test_a_stem_looks_as_much_wider_as_the_beam_is() -> None:
    device = Lms151(Resolution.QUARTER_DEGREE)
    echoes = device.echoes(_posts((10.0, 0.0, 0.3)), Pose2(), _rng())
    width = np.isfinite(echoes.ranges_m).sum() * device.geometry.angle_increment
    stem = 2 * math.asin(0.015)
    beam = 2 * float(device.half_widths(np.array([9.85]))[0])
    assert stem + 0.5 * beam < width < stem + beam + device.geometry.angle_increment


def test_dark_and_small_things_far_away_are_not_seen() -> None:
    device = Lms151()
    assert not np.isfinite(device.echoes(_posts((25.0, 0.0, 0.03)), Pose2(), _rng()).ranges_m).any()
    assert np.isfinite(device.echoes(_posts((25.0, 0.0, 0.4)), Pose2(), _rng()).ranges_m).any()


def test_the_first_echo_hides_what_is_far_behind_and_mixes_what_is_close() -> None:
    device = Lms151(Resolution.QUARTER_DEGREE)
    front, behind = (5.0, 0.0, 0.1), (8.0, 0.0, 1.0)
    far_apart = device.echoes(_posts(front, behind), Pose2(), _rng())
    seen = far_apart.ranges_m[np.isfinite(far_apart.ranges_m)]
    assert not ((seen > 5.1) & (seen < 7.4)).any()
    close = device.echoes(_posts(front, (5.65, 0.0, 1.0)), Pose2(), _rng())
    edges = close.ranges_m[close.sources == 0]
    assert ((edges > 5.0) & (edges < 5.12)).any()


def test_only_reflectors_are_brighter_than_white_bark() -> None:
    device = Lms151()
    for thing in (Thing.STEM, Thing.REFLECTOR):
        scan = device.scan(_posts((4.0, 1.0, 0.1), thing=thing), Pose2(), _rng())
        assert scan.intensities is not None
        brightest = scan.intensities.max()
        assert (brightest > 200.0) == (thing is Thing.REFLECTOR)
        assert 0.0 < brightest <= 254.0


@pytest.mark.parametrize(
    "motion", [Motion(forward=3.0), Motion(left=2.0), Motion(yaw_rate=0.8), Motion(2.0, -1.0, -0.5)]
)
def test_each_beam_sees_the_world_from_where_it_is_then(motion: Motion) -> None:
    device = Lms151(Resolution.QUARTER_DEGREE)
    world = stand_of_trees(_rng(3), SMALL_STAND)
    moving = device.echoes(world, Pose2(), _rng(), motion=motion)
    angles = device.beam_angles()
    assert (moving.ranges_m != device.echoes(world, Pose2(), _rng()).ranges_m).any()
    same, errors_m = 0, []
    beams = np.flatnonzero(np.isfinite(moving.ranges_m))[::6]
    for beam in beams:
        seconds = angles[beam] / (2 * math.pi * 25.0)
        pose = Pose2(motion.forward * seconds, motion.left * seconds, motion.yaw_rate * seconds)
        then = device.echoes(world, pose, _rng())
        same += then.sources[beam] == moving.sources[beam]
        errors_m.append(abs(then.ranges_m[beam] - moving.ranges_m[beam]))
    assert same / len(beams) > 0.95
    assert np.median(errors_m) < 2e-3


@pytest.mark.parametrize(
    ("tilt", "heading"),
    [
        (Tilt(pitch=math.radians(3.0)), 0.0),
        (Tilt(roll=math.radians(3.0)), -math.pi / 2),
        (Tilt(roll=math.radians(-3.0)), math.pi / 2),
    ],
)
def test_a_tilted_device_strikes_the_ground(tilt: Tilt, heading: float) -> None:
    device = Lms151(height_m=0.5)
    struck = device.echoes(_posts(), Pose2(), _rng(), tilt=tilt)
    beam = int(np.abs(device.beam_angles() - heading).argmin())
    assert struck.sources[beam] == GROUND
    assert struck.ranges_m[beam] == pytest.approx(0.5 / math.sin(math.radians(3.0)), rel=0.1)
    ahead = np.cos(device.beam_angles() - heading)
    assert (struck.sources[ahead < 0.0] == NOTHING).all()


def test_a_stem_before_the_ground_strike_is_seen_and_one_behind_is_not() -> None:
    device, tilt = Lms151(height_m=0.5), Tilt(pitch=math.radians(3.0))
    for distance_m, source in ((5.0, 0), (15.0, GROUND)):
        echoes = device.echoes(_posts((distance_m, 0.0, 0.6)), Pose2(), _rng(), tilt=tilt)
        assert echoes.sources[270] == source


@pytest.mark.parametrize("pose", [Pose2(3.0, -2.0, 0.0), Pose2(1.0, 1.0, 2.5)])
def test_moving_world_and_laser_together_changes_nothing(pose: Pose2) -> None:
    world = stand_of_trees(_rng(4), SMALL_STAND)
    moved = World(
        pose.transform(world.world_t_things), world.radii_m, world.things, world.reflectivities
    )
    here = Lms151().scan(world, Pose2(), _rng(9)).ranges_m
    there = Lms151().scan(moved, pose, _rng(9)).ranges_m
    assert np.isclose(here, there, atol=1e-6).mean() > 0.998


def test_a_beam_without_width_is_refused() -> None:
    with pytest.raises(InputError, match="expected a beam with a width"):
        Lms151(beam_exit_m=0.0)


@pytest.mark.parametrize("bearing", [0.0, 1.0, -1.5])
def test_a_tilted_beam_meets_a_trunk_where_the_planes_of_both_say(bearing: float) -> None:
    device, tilt = Lms151(Resolution.QUARTER_DEGREE, height_m=5.0), Tilt(0.06, -0.08)
    world = _posts((9.0 * math.cos(bearing), 9.0 * math.sin(bearing), 0.6))
    echoes = device.echoes(world, Pose2(), _rng(), tilt=tilt)
    beams = np.flatnonzero(echoes.sources == 0)
    middle = device.beam_angles()[beams].mean()
    direction = tilt.level_R_base() @ (math.cos(middle), math.sin(middle), 0.0)
    assert math.atan2(direction[1], direction[0]) == pytest.approx(bearing, abs=2e-3)
    horizontal = math.hypot(direction[0], direction[1])
    nearest_m = echoes.ranges_m[beams].min()
    assert nearest_m * horizontal == pytest.approx(8.7, abs=0.005)


def test_nothing_can_be_told_by_the_code_of_the_device() -> None:
    world = stand_of_trees(_rng(3), SMALL_STAND)
    scan = Lms151().scan(world, Pose2(), _rng(1))
    raw = Lms151(no_return_m=0.0).scan(world, Pose2(), _rng(1))
    nothing = np.isposinf(scan.ranges_m)
    assert nothing.any()
    np.testing.assert_array_equal(raw.ranges_m, np.where(nothing, 0.0, scan.ranges_m))
    np.testing.assert_array_equal(read_codes(raw, InvalidSettings()).ranges_m, scan.ranges_m)
