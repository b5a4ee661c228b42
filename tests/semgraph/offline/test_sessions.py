"""Sessions laid onto each other, each in a frame of its own."""

from dataclasses import replace

import numpy as np

from semgraph.geometry import Pose2
from semgraph.landmarks import Landmark, Tree
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.map_update import moved_landmark
from semgraph.offline.refinement import Refined
from semgraph.offline.sessions import join
from tests.semgraph.offline.test_map_following import log_of_drive

OWN_T_MAP = Pose2(0.3, -0.2, 0.1)
# Unsure along x of the map, sure across.
OBLONG = np.diag([0.04, 4e-6])


def refined(landmarks: list[Landmark]) -> Refined:
    log, _ = log_of_drive()
    places = {each.id: each.map_t_landmark for each in landmarks}
    nothing = np.full(len(log.scans), -1)
    return Refined(
        Batch.of(log),
        Belief(log.trajectory.map_T_bases, nothing, places),
        {},
        tuple(landmarks),
        (),
        np.zeros((0, 3, 3)),
        (),
        0.0,
    )


def test_what_a_later_session_adds_is_as_unsure_in_the_map_as_it_is() -> None:
    rng = np.random.default_rng(0)
    trees = [
        Landmark(k, Tree(), place, 0.0025 * np.eye(2), 5, 1.0)
        for k, place in enumerate(rng.uniform(-8.0, 8.0, (15, 2)))
    ]
    added = replace(trees[14], covariance=OBLONG)
    second = [moved_landmark(each, OWN_T_MAP) for each in (*trees[:14], added)]
    joined = join([refined(trees[:14]), refined(second)])
    assert len(joined.landmarks) == 15
    np.testing.assert_allclose(joined.landmarks[-1].map_t_landmark, added.map_t_landmark, atol=1e-6)
    np.testing.assert_allclose(joined.landmarks[-1].covariance, OBLONG, atol=1e-6)
