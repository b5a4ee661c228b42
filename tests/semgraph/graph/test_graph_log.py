"""What was added to a graph, kept as numbers."""

import numpy as np
import pytest

from semgraph.graph.factors import Sighting
from semgraph.graph.graph_log import NOWHERE, GraphLog
from semgraph.graph.growing import Growing, Ragged
from tests.semgraph.drives import NOISE, START, drive


def filled() -> GraphLog:
    """Three poses with four sightings each, of tracks 0 to 3."""
    log, made = GraphLog(START), drive(0, num_poses=3)
    for landmark in range(4):
        log.add_landmark(landmark)
    for pose in range(1, 4):
        assert log.add_motion(made.motions[pose - 1]) == pose
        for _, landmark, range_m, bearing in made.of_pose(pose):
            log.add_sighting(Sighting(pose, landmark, range_m, bearing, NOISE, landmark))
    return log


def test_sightings_come_back_as_they_were() -> None:
    log, made = filled(), drive(0, num_poses=3)
    for row, (pose, landmark, range_m, bearing) in enumerate(made.seen):
        sighting = log.sighting(row)
        assert (sighting.pose, sighting.landmark, sighting.track) == (pose, landmark, landmark)
        assert (sighting.range_m, sighting.bearing) == pytest.approx((range_m, bearing), 1e-6)
        np.testing.assert_allclose(sighting.covariance, NOISE, 1e-6)
    np.testing.assert_allclose(log.covariances(np.array([5])), [NOISE], 1e-6)


@pytest.mark.parametrize(
    ("perceived", "kept"),
    [
        ((0.3123, 0.0214), (0.3123, 0.0214)),
        ((np.nan, np.nan), (np.nan, np.nan)),
        ((1e-9, 1e-30), (1e-4, 1e-4)),
        ((1e9, 1e30), (6e4, 6e4)),
    ],
)
def test_diameters_come_back_to_half_a_thousandth(
    perceived: tuple[float, float], kept: tuple[float, float]
) -> None:
    log = filled()
    row = log.add_sighting(Sighting(1, 0, 5.0, 0.1, NOISE, 0, 0.0, *perceived))
    np.testing.assert_allclose(log.diameters(np.array([row])), [kept], 5e-4)
    assert (log.sighting(row).diameter_m, log.sighting(row).diameter_sigma_m) == pytest.approx(
        kept, 5e-4, nan_ok=True
    )
    assert np.isnan(log.diameters(np.array([0]))).all()


def test_what_is_handed_over_or_forgotten_is_of_another_landmark_or_none() -> None:
    log = filled()
    log.hand_over(log.rows(2), 0)
    assert len(log.rows(0)) == 6
    assert len(log.rows(2)) == 0
    assert {log.sighting(row).landmark for row in log.rows(0).tolist()} == {0}
    log.forget(0)
    assert log.names() == (1, 2, 3)
    assert (log.landmarks == NOWHERE).sum() == 6
    assert len(log.rows_of_poses(2, 3)) == 4


@pytest.mark.parametrize(("first", "last", "count"), [(1, 1, 4), (2, 3, 8), (0, 3, 12)])
def test_sightings_are_found_by_their_poses(first: int, last: int, count: int) -> None:
    log = filled()
    rows = log.rows_of_poses(first, last)
    assert len(rows) == count
    assert ((log.poses[rows] >= first) & (log.poses[rows] <= last)).all()


def test_rows_grow_and_stay() -> None:
    growing = Growing((2,))
    for k in range(1000):
        assert growing.append((k, -k)) == k
    np.testing.assert_array_equal(growing.rows[:, 0], np.arange(1000))
    assert len(growing) == 1000


def test_ragged_rows_come_back() -> None:
    rows = [np.array([3, -1]), np.zeros(0, dtype=np.int64), np.array([7])]
    ragged = Ragged()
    for row in rows:
        ragged.append(row)
    assert len(ragged) == 3
    for found, row in zip(ragged, rows, strict=True):
        np.testing.assert_array_equal(found, row)
