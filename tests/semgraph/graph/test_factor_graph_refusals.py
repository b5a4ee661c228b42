"""What the graph refuses, and how it goes on after GTSAM failed."""

from typing import Any

import gtsam
import numpy as np
import pytest

from semgraph.arrays import FloatArray
from semgraph.errors import GraphError, SemgraphError
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from tests.semgraph.drives import (
    NOISE,
    START,
    Drive,
    add_scan,
    assert_same,
    built,
    drive,
    halves,
    polished,
)


def test_what_waits_for_an_update_is_not_merged() -> None:
    graph = FactorGraph(START)
    add_scan(graph, drive(0), 1)
    with pytest.raises(GraphError, match="update the graph before"):
        graph.merge(1, 0)
    graph.update()
    graph.merge(1, 0)
    graph.update()
    assert graph.landmarks() == (0, 2, 3)


@pytest.mark.parametrize(("gone", "kept"), [(0, 0), (7, 0), (0, 7)])
def test_a_merge_that_makes_no_sense_is_refused_and_changes_nothing(gone: int, kept: int) -> None:
    graph = built(drive(7))
    with pytest.raises(GraphError, match=r"landmark [07]"):
        graph.merge(gone, kept)
    assert_same(polished(graph), polished(built(drive(7))))


BAD_SIGHTINGS: list[tuple[int, int, float, float, FloatArray]] = [
    (1, 0, np.nan, 0.0, NOISE),
    (1, 0, np.inf, 0.0, NOISE),
    (1, 0, -1.0, 0.0, NOISE),
    (1, 0, 0.0, 0.0, NOISE),
    (1, 0, 5.0, np.nan, NOISE),
    (1, 0, 5.0, np.inf, NOISE),
    (1, 0, 5.0, 0.0, np.diag([1.0, -1.0])),
    (1, 0, 5.0, 0.0, np.array([[1.0, 2.0], [2.0, 1.0]])),
    (1, 0, 5.0, 0.0, np.array([[1.0, 0.5], [0.0, 1.0]])),
    (1, 0, 5.0, 0.0, np.diag([1.0, 0.0])),
    (1, 0, 5.0, 0.0, np.zeros((2, 2))),
    (1, 0, 5.0, 0.0, np.full((2, 2), np.nan)),
    (1, 0, 5.0, 0.0, np.eye(3)),
    (9, 0, 5.0, 0.0, NOISE),
    (-1, 0, 5.0, 0.0, NOISE),
    (1, 77, 5.0, 0.0, NOISE),
]


@pytest.mark.parametrize("bad", BAD_SIGHTINGS)
def test_a_bad_sighting_is_refused_and_changes_nothing(
    bad: tuple[int, int, float, float, FloatArray],
) -> None:
    graph = built(drive(7))
    with pytest.raises(SemgraphError) as caught:
        graph.add_sighting(Sighting(*bad))
    assert "\n" not in str(caught.value)
    graph.update()
    assert graph.incidents == ()
    assert_same(polished(graph), polished(built(drive(7))))


def test_other_bad_input_is_refused_and_changes_nothing() -> None:
    graph = built(drive(7))
    singular = UncertainPose2(Pose2(1.0, 0.0, 0.0), np.diag([1.0, 0.0, 1.0]))
    with pytest.raises(GraphError, match="positive definite"):
        graph.add_pose(singular, Pose2())
    with pytest.raises(GraphError, match="already"):
        graph.add_landmark(0, np.zeros(2))
    for guess in (np.array([np.nan, 0.0]), np.zeros(3)):
        with pytest.raises(SemgraphError, match="guess of landmark 9"):
            graph.add_landmark(9, guess)
    with pytest.raises(GraphError, match="positive definite"):
        FactorGraph(singular)
    assert_same(polished(graph), polished(built(drive(7))))


def test_sightings_of_any_numbers_never_break_the_graph() -> None:
    rng = np.random.default_rng(0)
    graph = built(drive(8))
    refused = 0
    for _ in range(300):
        range_m, bearing, *entries = rng.choice([np.nan, -1.0, 0.0, 1e-9, 0.1, 3.0, 1e9], 6)
        covariance = np.array(entries).reshape(2, 2)
        pose, landmark = (int(each) for each in rng.integers(-1, 10, 2))
        try:
            graph.add_sighting(Sighting(pose, landmark, range_m, bearing, covariance))
        except SemgraphError:
            refused += 1
    assert 250 < refused < 300
    graph.polish()
    assert np.isfinite(graph.estimate().map_T_bases).all()


class Fault:
    """ISAM2.update, but the calls of these numbers fail, before or after their work."""

    def __init__(self, calls: set[int], *, after: bool = False) -> None:
        self._work = gtsam.ISAM2.update
        self._calls, self._after, self._count = calls, after, 0

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def update(isam: gtsam.ISAM2, *args: Any) -> object:
            self._count += 1
            fails = self._count in self._calls
            result = None if fails and not self._after else self._work(isam, *args)
            if fails:
                raise RuntimeError("\nIndeterminant linear system near x5\nand more")
            return result

        monkeypatch.setattr(gtsam.ISAM2, "update", update)


def driven_and_merged(made: Drive) -> FactorGraph:
    """Eight updates, a ninth that merges."""
    graph = built(made, name=halves)
    for landmark in range(4):
        graph.merge(landmark + 10, landmark)
    graph.update(relinearize=True)
    return graph


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("call", [1, 2, 5, 8, 10])
def test_a_failed_update_is_named_and_changes_no_result(
    monkeypatch: pytest.MonkeyPatch, call: int, *, after: bool
) -> None:
    made = drive(9)
    expected = polished(driven_and_merged(made))
    Fault({call}, after=after).install(monkeypatch)
    graph = driven_and_merged(made)
    assert graph.incidents == ("update failed, graph rebuilt: Indeterminant linear system near x5",)
    assert_same(polished(graph), expected)


def test_a_rebuild_that_cholesky_refuses_is_done_by_qr(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(9)
    expected = polished(driven_and_merged(made))
    Fault({4, 5}).install(monkeypatch)
    graph = driven_and_merged(made)
    assert len(graph.incidents) == 1
    assert_same(polished(graph), expected)


def test_a_failed_rebuild_is_one_line_and_the_next_update_mends_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = drive(9)
    Fault({4, 5, 6}).install(monkeypatch)  # the update, and a rebuild by Cholesky and by QR
    graph = FactorGraph(made.start)
    for pose in range(1, 9):
        add_scan(graph, made, pose)
        if pose == 4:
            with pytest.raises(GraphError, match="cannot be solved: Indeterminant") as caught:
                graph.update()
            assert "\n" not in str(caught.value)
        else:
            graph.update()
    assert_same(polished(graph), polished(built(made)))


def test_a_landmark_may_wait_for_its_first_sighting() -> None:
    graph = built(drive(7))
    graph.add_landmark(9, np.array([1.0, 1.0]))
    graph.update()
    graph.add_sighting(Sighting(8, 9, 2.0, 0.5, NOISE))
    graph.polish()
    expected = graph.pose(8).transform(2.0 * np.array([[np.cos(0.5), np.sin(0.5)]]))[0]
    np.testing.assert_allclose(graph.landmark(9), expected, atol=1e-4)


def test_after_a_covariance_that_only_qr_gives_every_factor_still_counts_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = drive(9)
    graph, work = built(made), gtsam.ISAM2.marginalCovariance
    calls = iter([True])

    def refuse(isam: gtsam.ISAM2, key: int) -> FloatArray:
        if next(calls, False):
            raise RuntimeError("Indeterminant linear system near x5")
        return np.asarray(work(isam, key))

    monkeypatch.setattr(gtsam.ISAM2, "marginalCovariance", refuse)
    graph.pose_covariance(8)
    assert graph.incidents == (
        "no covariance, QR from now on: Indeterminant linear system near x5",
    )
    assert graph.is_updated
    before = graph.cost()
    graph.update()
    assert graph.cost() == pytest.approx(before)
