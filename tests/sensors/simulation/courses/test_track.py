"""Closed curves, and drives along them."""

import numpy as np
import pytest

from semgraph.geometry import wrap_angle
from sensors.simulation.courses.track import Track, beside, drive

WAVES = np.array([[0.0, 0.0], [0.15, 0.5], [0.05, 1.0]])


def test_a_circle_is_a_circle() -> None:
    track = Track.around(20.0)
    assert track.length_m == pytest.approx(40.0 * np.pi, rel=1e-4)
    along_m = np.linspace(0.0, 2.0 * track.length_m, 1000)
    poses = track.poses(along_m)
    np.testing.assert_allclose(np.hypot(*poses[:, :2].T), 20.0, atol=1e-5)
    np.testing.assert_allclose(track.curvatures(along_m), 0.05, atol=1e-5)
    assert poses[0] == pytest.approx([20.0, 0.0, 0.5 * np.pi], abs=1e-6)


def test_a_lap_ends_where_it_begins() -> None:
    track = Track.around(10.0, WAVES)
    first, last = track.poses(np.array([0.0, track.length_m]))
    np.testing.assert_allclose(first, last, atol=1e-6)


def test_speeds_and_yaw_rates_are_those_of_the_poses() -> None:
    way = drive(Track.around(10.0, WAVES), 2.0, 30.0, 50.0, rng=np.random.default_rng(0))
    steps = np.diff(way.poses, axis=0)
    np.testing.assert_allclose(np.hypot(*steps[:, :2].T) * 50.0, 2.0, rtol=1e-3)
    means = 0.5 * (way.yaw_rates[1:] + way.yaw_rates[:-1])
    np.testing.assert_allclose(wrap_angle(steps[:, 2]) * 50.0, means, atol=2e-3)
    ahead = np.arctan2(steps[:, 1], steps[:, 0])
    np.testing.assert_allclose(wrap_angle(ahead - way.poses[:-1, 2]), 0.0, atol=0.02)
    assert len(way.stamps_ns) == 1501
    assert not way.tilts.any()


def test_tilts_wander_by_their_sigma() -> None:
    way = drive(Track.around(10.0), 1.0, 600.0, 20.0, tilt_sigma=0.02, rng=np.random.default_rng(0))
    np.testing.assert_allclose(way.tilts.std(axis=0), 0.02, rtol=0.1)
    assert way.tilt(7).roll == way.tilts[7, 0]


def test_places_beside_a_track_keep_their_distance_and_side() -> None:
    track = Track.around(10.0)
    places, poses = beside(track, 50, (1.0, 2.0), np.random.default_rng(0), sides=(-1.0,))
    radii_m = np.hypot(*places.T)
    assert ((radii_m > 10.99) & (radii_m < 12.01)).all()
    np.testing.assert_allclose(np.hypot(*poses[:, :2].T), 10.0, atol=1e-4)
    both, _ = beside(track, 50, (1.0, 2.0), np.random.default_rng(0))
    assert 0 < (np.hypot(*both.T) < 10.0).sum() < 50
    assert len(beside(track, 0, (1.0, 2.0), np.random.default_rng(0))[0]) == 0
