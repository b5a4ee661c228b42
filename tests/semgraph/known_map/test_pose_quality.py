"""What speaks against a place: in full when it is confirmed, then hardly again."""

import numpy as np
import pytest

from semgraph.geometry import Pose2
from semgraph.known_map.pose_quality import Elsewhere, PerceivedLately

STEP = Pose2(0.2, 0.0, 0.3)
THINGS = np.array([[4.0, 1.0], [-2.0, 6.0], [8.0, -3.0]])


def test_a_thing_is_confirmed_when_it_is_seen_again_and_once_only() -> None:
    perceived, map_T_base = PerceivedLately(), Pose2()
    shares = [perceived.share_confirmed(THINGS, Pose2())]
    for _ in range(4):
        map_T_base = map_T_base @ STEP
        base_t = map_T_base.inverse().transform(THINGS)
        shares.append(perceived.share_confirmed(base_t, STEP))
    assert shares == [0.0, 1.0, 0.0, 0.0, 0.0]


def test_what_is_never_seen_again_is_not_confirmed() -> None:
    rng, perceived = np.random.default_rng(1), PerceivedLately()
    shares = [perceived.share_confirmed(rng.uniform(-50.0, 50.0, (2, 2)), STEP) for _ in range(50)]
    assert np.mean(shares) < 0.02


def test_who_was_carried_off_sees_others_confirmed() -> None:
    perceived = PerceivedLately()
    for _ in range(3):
        perceived.share_confirmed(THINGS, Pose2())
    assert perceived.share_confirmed(THINGS + 20.0, Pose2()) == 0.0
    assert perceived.share_confirmed(THINGS + 20.0, Pose2()) == 1.0
    assert perceived.share_confirmed(THINGS[:0], Pose2()) == 0.0


def test_what_is_confirmed_speaks_in_full() -> None:
    odds = []
    for share_confirmed in (0.0, 0.5, 1.0):
        doubt = Elsewhere(0.01, driven_m=0.0)
        doubt.weigh(-2.0, share_confirmed)
        odds.append(doubt.probability / (1.0 - doubt.probability))
    expected = 0.01 / 0.99 * np.exp([0.2, 0.1 + 1.0, 2.0])
    assert odds == pytest.approx(expected, rel=1e-6)
