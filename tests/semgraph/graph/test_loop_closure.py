"""What is known of a landmark beside its position, and which landmarks of a graph are one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.association import associate
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.graph.graph_landmark import GraphLandmark
from semgraph.graph.loop_closure import Closure, duplicates, find_closures
from semgraph.landmarks import Kind, Perceptions, Tree, polar_covariances
from semgraph.measurement_model import predict

START = UncertainPose2(Pose2(), np.diag([1e-3, 1e-3, 1e-4]) ** 2)
NOISE = np.diag([0.03, 0.005]) ** 2
TREES = np.array([[2.0, 4.0], [5.0, -3.0], [7.5, 3.5], [9.0, -5.0]])
LEAST = float(np.log(100.0))


def seen(diameters_m: list[float], sigma_m: float, reliability: float = 1.0) -> Perceptions:
    n = len(diameters_m)
    return Perceptions.from_arrays(
        0,
        Kind.TREE,
        np.full(n, 5.0),
        np.linspace(0.0, 1.0, n),
        polar_covariances(np.full(n, 0.03), np.full(n, 0.005)),
        diameters_m=np.array(diameters_m),
        diameter_sigmas_m=np.full(n, sigma_m),
        reliabilities=np.full(n, reliability),
    )


def landmark(
    *scans: int, diameter_m: float | None = None, kind: Kind = Kind.TREE, identity: str = ""
) -> GraphLandmark:
    known = GraphLandmark(kind, identity)
    for scan in scans:
        known.sight(scan, seen([np.nan if diameter_m is None else diameter_m], 0.02), 0)
    return known


def passed_twice(
    drift: Pose2, motion_sigmas: tuple[float, float, float] = (0.5, 0.5, 0.05)
) -> tuple[FactorGraph, dict[int, GraphLandmark]]:
    """All trees seen from two poses, as 0 to 3 and then as 4 to 7; odometry erred by `drift`."""
    graph = FactorGraph(START)
    steps = [(UncertainPose2(Pose2(1.0, 0.0, 0.0), 1e-6 * np.eye(3)), Pose2(1.0, 0.0, 0.0))]
    steps.append(
        (UncertainPose2(Pose2(1.0, 0.0, 0.0) @ drift, np.diag(motion_sigmas) ** 2), Pose2(2.0))
    )
    known: dict[int, GraphLandmark] = {}
    believed = Pose2()
    for scan, (motion, true) in enumerate(steps):
        believed = believed @ motion.pose
        pose = graph.add_pose(motion, believed)
        for row, (range_m, bearing) in enumerate(predict(true, TREES)):
            name = row + len(TREES) * scan
            base_t_tree = range_m * np.array([[np.cos(bearing), np.sin(bearing)]])
            graph.add_landmark(name, believed.transform(base_t_tree)[0])
            graph.add_sighting(Sighting(pose, name, float(range_m), float(bearing), NOISE))
            known[name] = landmark(scan * 200)
        graph.update()
    return graph, known


def pairs_of(closures: list[Closure]) -> set[tuple[int, int]]:
    return {(closure.recent, closure.old) for closure in closures}


def test_diameters_are_averaged_by_their_information() -> None:
    known = GraphLandmark(Kind.TREE, "")
    known.sight(0, seen([0.30], 0.02), 0)
    known.sight(1, seen([0.40], 0.04), 0)
    known.sight(2, seen([np.nan], np.nan), 0)
    assert known.num_sightings == 3
    assert known.diameter_m == pytest.approx((0.30 * 4.0 + 0.40) / 5.0)
    semantics = known.semantics()
    assert isinstance(semantics, Tree)
    assert semantics.diameter is not None
    single_m = ((0.02**-2 + 0.04**-2) / 2.0) ** -0.5
    assert semantics.diameter.sigma_m == pytest.approx(single_m)
    assert known.outline_sigma_m() == pytest.approx(single_m)


def test_only_views_from_several_tracks_make_a_diameter_surer() -> None:
    known = landmark(0, 1, 2, diameter_m=0.3)
    assert known.diameter() == pytest.approx((0.3, 0.02))
    known.absorb(landmark(200, 201, diameter_m=0.3))
    known.absorb(landmark(300))
    assert known.diameter() == pytest.approx((0.3, 0.02 / np.sqrt(2.0)))
    assert known.outline_sigma_m() == pytest.approx(0.02)


def test_reliability_grows_with_independent_sightings() -> None:
    known = GraphLandmark(Kind.TREE, "")
    for scan in range(3):
        known.sight(scan, seen([0.3], 0.02, reliability=0.5), 0)
    assert known.evidence.num_looks == 3
    assert known.evidence.reliability(usual=0.9) < 0.5 < known.evidence.reliability(usual=0.4)


def test_absorbing_is_having_seen_everything_oneself() -> None:
    halves = [GraphLandmark(Kind.TREE, "") for _ in range(2)]
    whole = GraphLandmark(Kind.TREE, "")
    for scan, diameter_m in enumerate([0.2, 0.25, np.nan, 0.3, 0.27]):
        for each in (halves[scan % 2], whole):
            each.sight(scan, seen([diameter_m], 0.03, reliability=0.6), 0)
    halves[0].absorb(halves[1])
    assert list(halves[0].scans) == list(whole.scans)
    assert halves[0].diameter_m == pytest.approx(whole.diameter_m)
    assert halves[0].diameter_weight == pytest.approx(whole.diameter_weight)
    assert halves[0].evidence.reliability(0.7) == pytest.approx(whole.evidence.reliability(0.7))
    nothing = landmark(7)
    halves[0].absorb(nothing)
    assert halves[0].diameter_m == pytest.approx(whole.diameter_m)


@pytest.mark.parametrize(
    ("other", "may_be"),
    [
        (landmark(5, diameter_m=0.30), True),
        (landmark(5), True),
        (landmark(5, diameter_m=0.60), False),
        (landmark(1, diameter_m=0.30), False),
        (landmark(5, diameter_m=0.30, kind=Kind.ROCK), False),
        (landmark(5, diameter_m=0.30, identity="7"), False),
    ],
)
def test_what_speaks_against_one_object(other: GraphLandmark, *, may_be: bool) -> None:
    one = landmark(0, 1, 2, diameter_m=0.31)
    assert one.may_be(other) == may_be
    assert other.may_be(one) == may_be


@pytest.mark.parametrize("drift", [Pose2(), Pose2(0.6, 0.4, 0.0), Pose2(-0.4, 0.7, 0.06)])
def test_what_is_seen_again_is_recognised_through_the_drift(drift: Pose2) -> None:
    graph, known = passed_twice(drift)
    closures = find_closures(graph, known, [4, 5, 6, 7], LEAST)
    assert pairs_of(closures) == {(4, 0), (5, 1), (6, 2), (7, 3)}
    assert min(closure.log_odds for closure in closures) >= LEAST


def test_how_sure_is_the_callers_choice() -> None:
    graph, known = passed_twice(Pose2(0.3, 0.2, 0.0))
    odds = sorted(each.log_odds for each in find_closures(graph, known, [4, 5, 6, 7], LEAST))
    between = 0.5 * (odds[0] + odds[-1])
    fewer = find_closures(graph, known, [4, 5, 6, 7], between)
    assert 0 < len(fewer) < 4
    assert find_closures(graph, known, [4, 5, 6, 7], odds[-1] + 1.0) == []


def test_what_was_seen_at_one_time_is_never_one_object() -> None:
    graph, known = passed_twice(Pose2())
    for row in range(4):
        known[row + 4].sight(0, seen([0.3], 0.02), 0)
    assert find_closures(graph, known, [4, 5, 6, 7], LEAST) == []
    assert duplicates(graph, known, set(known), LEAST) == []


def test_only_the_pair_that_attributes_permit_is_found() -> None:
    graph, known = passed_twice(Pose2())
    for row in (0, 1, 2):
        known[row] = landmark(0, diameter_m=0.2)
        known[row + 4] = landmark(200, diameter_m=0.5)
    assert pairs_of(find_closures(graph, known, [4, 5, 6, 7], 0.0)) == {(7, 3)}


def test_nothing_recent_and_nothing_old_close_nothing() -> None:
    graph, known = passed_twice(Pose2())
    assert find_closures(graph, known, [], LEAST) == []
    assert find_closures(graph, known, list(known), LEAST) == []


def test_duplicates_are_found_each_landmark_once() -> None:
    graph, known = passed_twice(Pose2(), motion_sigmas=(0.02, 0.02, 0.002))
    closures = duplicates(graph, known, set(known), LEAST)
    assert pairs_of(closures) == {(4, 0), (5, 1), (6, 2), (7, 3)}
    assert [c.log_odds for c in closures] == sorted((c.log_odds for c in closures), reverse=True)


def test_only_changed_landmarks_are_looked_at_again() -> None:
    graph, known = passed_twice(Pose2(), motion_sigmas=(0.02, 0.02, 0.002))
    assert pairs_of(duplicates(graph, known, {4, 1}, LEAST)) == {(4, 0), (5, 1)}
    assert duplicates(graph, known, set(), LEAST) == []


def test_three_of_one_object_are_made_one_in_turn() -> None:
    """A landmark that two others claim is given to one of them, and then to the other."""
    graph, known = passed_twice(Pose2(), motion_sigmas=(0.02, 0.02, 0.002))
    pose = graph.add_pose(UncertainPose2(Pose2(0.5), np.diag([0.02, 0.02, 0.002]) ** 2), Pose2(2.5))
    range_m, bearing = predict(Pose2(2.5), TREES[:1])[0]
    graph.add_landmark(8, TREES[0])
    graph.add_sighting(Sighting(pose, 8, float(range_m), float(bearing), NOISE))
    known[8] = landmark(400)
    graph.update()
    taken = [
        each
        for closure in duplicates(graph, known, set(known), LEAST)
        for each in (closure.recent, closure.old)
    ]
    assert len(taken) == len(set(taken))
    while closures := duplicates(graph, known, set(known), LEAST):
        for closure in closures:
            graph.merge(closure.recent, closure.old)
            known[closure.old].absorb(known.pop(closure.recent))
        graph.update(relinearize=True)
    assert set(known) == {0, 1, 2, 3}


def test_an_empty_graph_has_no_duplicates() -> None:
    graph = FactorGraph(START)
    graph.update()
    assert duplicates(graph, {}, set(), LEAST) == []


@dataclass(frozen=True)
class Gaussians:
    """Landmarks by their joint Gaussian alone."""

    map_t_landmarks: dict[int, FloatArray]
    joint: FloatArray

    def estimate(self) -> "Gaussians":
        return self

    def landmark_covariance(self, landmarks: Sequence[int]) -> FloatArray:
        rows = np.column_stack([2 * np.array(landmarks), 2 * np.array(landmarks) + 1]).ravel()
        joint: FloatArray = self.joint[np.ix_(rows, rows)]
        return joint


@pytest.mark.parametrize("seed", range(20))
def test_a_duplicate_is_what_joint_compatibility_with_its_rivals_makes_it(seed: int) -> None:
    rng, count = np.random.default_rng(seed), 12
    places = rng.uniform(0.0, 1.5, (count, 2))
    half = 0.1 * rng.standard_normal((2 * count, 2 * count))
    graph = Gaussians(dict(enumerate(places)), half @ half.T + 1e-3 * np.eye(2 * count))
    known = {k: landmark(*rng.integers(0, 8, 2).tolist()) for k in range(count)}
    surest: dict[int, tuple[float, int]] = {}
    for recent in range(count):
        old = [k for k in range(recent) if known[recent].may_be(known[k])]
        for one in old:
            group = [one, *(k for k in old if k != one and not known[one].may_be(known[k]))]
            pairs = associate(
                places[[recent]][:, None] - places[group],
                graph.landmark_covariance([recent, *group]),
                np.ones((1, len(group)), dtype=np.bool_),
                0.1 * (1 + count) / (np.pi * 20.0**2),
                np.full((1, len(group)), 2 * 0.014**2),
            )
            if pairs and pairs[0].old == 0 and pairs[0].log_odds >= 1.0:
                surest[recent] = max(surest.get(recent, (0.0, -1)), (pairs[0].log_odds, one))
    found = duplicates(graph, known, set(known), 1.0)
    assert found
    best = found[0]
    odds, one = max(surest.values())
    assert best.old == one
    assert best.log_odds == pytest.approx(odds)
    assert all(
        each.log_odds <= surest[each.recent][0] + 1e-9 and each.recent in surest for each in found
    )
