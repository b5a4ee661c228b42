"""What moves is told from what stands."""

import numpy as np
import pytest

from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.graph.tracks import Track
from semgraph.landmarks import Kind


def followed(speed: float, rate_hz: float, seconds: float, sigma_m: float, seed: int) -> Track:
    rng = np.random.default_rng(seed)
    track = Track(0, 0, GraphLandmark(Kind.TREE, ""), 0)
    for k in range(int(seconds * rate_hz)):
        t = k / rate_hz
        place = np.array([5.0 + speed * t, 2.0]) + sigma_m * rng.standard_normal(2)
        is_away = track.look(round(t * 1e9), place, sigma_m**2 * np.eye(2))
        track.note(is_away=is_away)
    return track


@pytest.mark.parametrize("rate_hz", [5.0, 25.0, 50.0])
def test_a_person_at_walking_speed_moves(rate_hz: float) -> None:
    assert all(followed(1.2, rate_hz, 1.5, 0.03, seed).is_moving for seed in range(20))


@pytest.mark.parametrize("rate_hz", [5.0, 50.0])
def test_what_stands_is_not_taken_for_moving(rate_hz: float) -> None:
    moving = [followed(0.0, rate_hz, 20.0, 0.03, seed).is_moving for seed in range(50)]
    assert not any(moving)


def test_the_slow_drift_of_the_pose_is_no_motion() -> None:
    assert not followed(0.02, 10.0, 60.0, 0.03, 1).is_moving
