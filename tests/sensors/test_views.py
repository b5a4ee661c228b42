"""What a scan would have shown."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2
from sensors.measurements import LaserScan, ScannerGeometry
from sensors.simulation.lms151 import Lms151, Resolution
from sensors.simulation.world import Thing, World
from sensors.views import View

GEOMETRY = ScannerGeometry(-2.0, 0.01, 0.1, 50.0, Pose2(1.0, 0.5, 0.3))


def view_of(ranges_m: FloatArray, geometry: ScannerGeometry = GEOMETRY) -> View:
    return View.of_scan(LaserScan(0, geometry, ranges_m))


def seen(view: View, *places: tuple[float, float], diameter_m: float = 0.3) -> list[bool]:
    """Places relative to the laser."""
    map_T_base = Pose2(3.0, -2.0, 1.0)
    there = (map_T_base @ GEOMETRY.base_T_laser).transform(np.array(places))
    return [bool(each) for each in view.sees(map_T_base, there, np.full(len(places), diameter_m))]


def test_in_an_empty_field_everything_within_it_shows() -> None:
    view = view_of(np.full(401, np.inf))
    assert seen(view, (5.0, 0.0), (0.0, 5.0), (-5.0, 0.0), (5.0, 5.0)) == [True, True, False, True]


def test_too_far_for_three_beams_says_nothing() -> None:
    view = view_of(np.full(401, np.inf))
    assert seen(view, (8.0, 0.0), (20.0, 0.0)) == [True, False]
    assert seen(view, (20.0, 0.0), diameter_m=0.8) == [True]


def test_behind_another_thing_nothing_shows_and_in_its_own_place_it_does() -> None:
    ranges_m = np.full(401, np.inf)
    ranges_m[200] = 4.0
    view = view_of(ranges_m)
    assert seen(view, (6.0, 0.0), (4.1, 0.0), (3.0, 0.0)) == [False, True, True]


def through(view: View, place: tuple[float, float], diameter_m: float = 0.3) -> bool:
    map_T_base = Pose2(3.0, -2.0, 1.0)
    there = (map_T_base @ GEOMETRY.base_T_laser).transform(np.array([place]))
    return bool(view.passes(map_T_base, there, np.array([diameter_m]))[0])


def test_beams_pass_where_they_meet_nothing_until_behind() -> None:
    for range_m, expected in ((4.0, False), (5.2, False), (6.5, True), (np.inf, True)):
        ranges_m = np.full(401, np.inf)
        ranges_m[200] = range_m
        assert through(view_of(ranges_m), (5.0, 0.0)) == expected
    assert not through(view_of(np.full(401, np.nan)), (5.0, 0.0))
    assert not through(view_of(np.full(401, np.inf)), (20.0, 0.0))


@pytest.mark.parametrize("code", [np.nan, -np.inf])
def test_beams_that_are_not_valid_say_nothing(code: float) -> None:
    assert seen(view_of(np.full(401, code)), (5.0, 0.0)) == [False]


def test_a_clockwise_scan_shows_the_same() -> None:
    ranges_m = np.random.default_rng(0).uniform(1.0, 12.0, 401)
    turned = ScannerGeometry(2.0, -0.01, 0.1, 50.0, GEOMETRY.base_T_laser)
    places = [
        (r * np.cos(a), r * np.sin(a)) for r in (3.0, 6.0) for a in np.linspace(-1.9, 1.9, 40)
    ]
    assert seen(view_of(ranges_m), *places) == seen(view_of(ranges_m[::-1], turned), *places)


@given(st.integers(0, 2**32 - 1))
def test_what_says_it_should_show_is_hit_in_a_simulated_scan(seed: int) -> None:
    """A trunk that a scan without it would show answers beams in the scan with it."""
    rng = np.random.default_rng(seed)
    device = Lms151(Resolution.QUARTER_DEGREE)
    places = rng.uniform(-12.0, 12.0, (15, 2))
    places = places[np.hypot(*places.T) > 1.0]
    n = len(places)
    world = World(places, np.full(n, 0.15), np.full(n, Thing.STEM), np.full(n, 0.5))
    without = World(places[1:], world.radii_m[1:], world.things[1:], world.reflectivities[1:])
    pose = Pose2(0.0, 0.0, float(rng.uniform(-3.0, 3.0)))
    view = View.of_scan(device.scan(without, pose, rng))
    base_T_laser = device.geometry.base_T_laser
    map_T_base = pose @ base_T_laser.inverse()
    whole = View.of_scan(device.scan(world, pose, rng))
    assert not whole.passes(map_T_base, places[:1], np.array([0.3]))[0]
    if view.sees(map_T_base, places[:1], np.array([0.3]))[0]:
        assert (device.echoes(world, pose, rng).sources == 0).any()
