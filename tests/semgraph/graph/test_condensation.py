"""Condensed stretches of a graph against the graph itself."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from semgraph.arrays import FloatArray
from semgraph.errors import GraphError
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting, condensed_factor
from semgraph.graph.graph_log import GraphLog
from semgraph.graph.pieces import Piece, covariance_by
from semgraph.graph.windows import NONE, Windows
from tests.semgraph.drives import LANDMARKS, NOISE, START, Drive, add_scan, drive, halves, polished


def driven(made: Drive, window_poses: int, name: object = None) -> FactorGraph:
    """Updated after each pose, and linearized anew until nothing moves."""
    graph = FactorGraph(made.start, window_poses)
    for pose in range(1, len(made.motions) + 1):
        add_scan(graph, made, pose, halves if name is halves else lambda _, k: k)
        graph.update()
    return graph


def num_condensed(graph: FactorGraph) -> int:
    return sum(graph._solver.windows.of_pose(pose) != NONE for pose in range(graph.num_poses))


def optimum(graph: FactorGraph) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses, landmarks and the joint covariance of these, with everything linearized again."""
    graph.settle()
    estimate = graph.estimate()
    order = sorted(graph.landmarks())
    places = np.array([estimate.map_t_landmarks[k] for k in order])
    return estimate.map_T_bases, places, graph.landmark_covariance(order)


def assert_close(
    found: tuple[FloatArray, FloatArray, FloatArray],
    whole: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """But for where each stretch was linearized: half a sigma, and a tenth of the variance."""
    sigmas = np.sqrt(np.diag(whole[2])).reshape(-1, 2)
    assert (np.abs(found[1] - whole[1]) < 0.5 * sigmas).all()
    np.testing.assert_allclose(np.diag(found[2]), np.diag(whole[2]), rtol=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_a_condensed_graph_has_the_optimum_and_the_covariances_of_the_whole(seed: int) -> None:
    made = drive(seed, num_poses=30)
    whole, condensed = (optimum(driven(made, length)) for length in (0, 6))
    assert_close(condensed, whole)


def test_most_poses_are_given_up_and_followed() -> None:
    graph = driven(drive(1, num_poses=30), 6)
    assert num_condensed(graph) == 15
    estimate = graph.estimate()
    for pose in range(graph.num_poses):
        np.testing.assert_allclose(
            graph.pose(pose).as_array(), estimate.map_T_bases[pose], atol=1e-5
        )
    assert graph.incidents == ()


def test_the_optimum_of_the_condensed_graph_leaves_it_condensed() -> None:
    made = drive(2, num_poses=30)
    graph = driven(made, 6)
    count = num_condensed(graph)
    graph.optimize()
    assert num_condensed(graph) == count > 10
    assert_close(optimum(graph), optimum(driven(made, 0)))


def test_polishing_is_of_the_whole_graph() -> None:
    made = drive(2, num_poses=30)
    whole, condensed = (polished(driven(made, length)) for length in (0, 6))
    assert num_condensed(condensed) == 0
    np.testing.assert_allclose(
        condensed.estimate().map_T_bases, whole.estimate().map_T_bases, atol=1e-5
    )


def test_asking_for_the_covariance_of_a_pose_given_up_brings_it_back() -> None:
    made = drive(3, num_poses=30)
    whole, condensed = (driven(made, length) for length in (0, 6))
    for graph in (whole, condensed):
        graph.settle()
    np.testing.assert_allclose(
        np.diag(condensed.pose_covariance(3)), np.diag(whole.pose_covariance(3)), rtol=0.1
    )
    assert condensed.chain_covariances()[0].shape == (31, 3, 3)


def test_condensed_sightings_are_merged_and_split_like_others() -> None:
    made = drive(4, num_poses=30)
    whole, condensed = (driven(made, length, halves) for length in (0, 6))
    for graph in (whole, condensed):
        for landmark in range(4):
            graph.merge(landmark + 10, landmark)
        graph.update(relinearize=True)
        graph.split(2, {12}, 12)
    assert num_condensed(condensed) > 0
    assert_close(optimum(condensed), optimum(whole))
    assert [len(condensed.sightings(k)) for k in (0, 2, 12)] == [30, 4, 26]
    assert condensed.incidents == ()


def test_what_is_taken_out_leaves_the_condensed_stretches_too() -> None:
    made = drive(5, num_poses=30)
    whole, condensed = (driven(made, length) for length in (0, 6))
    for graph in (whole, condensed):
        graph.remove(1)
        graph.update()
    assert_close(optimum(condensed), optimum(whole))


def test_a_sighting_from_a_pose_given_up_is_refused() -> None:
    graph = driven(drive(1, num_poses=30), 6)
    with pytest.raises(GraphError, match="condensed"):
        graph.add_sighting(Sighting(3, 0, 2.0, 0.5, NOISE))


def test_a_rebuilt_graph_keeps_its_condensed_stretches() -> None:
    graph = driven(drive(6, num_poses=30), 6)
    before = graph.estimate()
    graph.go_back(graph.checkpoint())
    assert num_condensed(graph) > 0
    np.testing.assert_allclose(graph.estimate().map_T_bases, before.map_T_bases, atol=0.1)


@pytest.mark.parametrize("window_poses", [0, 6])
def test_after_a_wrong_merge_a_graph_goes_back_to_where_it_was(window_poses: int) -> None:
    graph = driven(drive(8, num_poses=30), window_poses, halves)
    graph.settle()
    places = [graph.landmark(k) for k in sorted(graph.landmarks())]
    before = graph.checkpoint()
    graph.merge(13, 1)
    graph.update(relinearize=True)
    graph.settle()
    assert graph.cost() > before.cost + 10.0
    graph.split(1, {13}, 13)
    graph.go_back(before)
    assert graph.cost() == pytest.approx(before.cost, rel=1e-9)
    names = sorted(graph.landmarks())
    np.testing.assert_array_equal([graph.landmark(k) for k in names], places)
    graph.merge(10, 0)
    graph.update(relinearize=True)
    assert graph.cost() < before.cost + 20.0
    assert graph.incidents == ()


def test_what_is_beside_windows_was_driven_or_sighted_next_to_them() -> None:
    """Landmarks 0 to 3 are sighted in the first one, 10 to 13 in all."""
    graph = driven(drive(1, num_poses=40), 6, halves)
    windows = graph._solver.windows
    graph.remove(10)
    assert windows.of_any([0]) == windows.of_any([0, 10, 99]) == {0}
    assert windows.of_any([]) == set()
    everything = set(range(len(windows)))
    assert windows.of_any([0, 11]) == windows.beside({0}) == windows.beside({4}) == everything
    for landmark in (11, 12, 13):
        graph.update()
        graph.remove(landmark)
    assert windows.beside({0}) == {0, 1}
    assert windows.beside({2}) == {1, 3}


def test_motions_nothing_is_sure_of_are_never_condensed() -> None:
    made = drive(7, num_poses=30)
    made.motions[9] = type(made.motions[9])(made.motions[9].pose, np.diag([5.0, 5.0, 1.0]))
    graph = driven(made, 6)
    assert graph._solver.windows.of_motion(10) == NONE
    assert num_condensed(graph) > 10


@pytest.mark.parametrize("names", [[0, 1, 2, 3], [0, 1, 1, 3], [5, 1, 7, 3]])
def test_the_jacobians_of_a_condensed_factor_are_its_derivatives(names: list[int]) -> None:
    made = drive(8, num_poses=6)
    log = GraphLog(START)
    poses = np.array([START.pose.as_array(), *(guess.as_array() for guess in made.guesses)])
    graph = driven(made, 0)
    for pose in range(1, 7):
        log.add_motion(made.motions[pose - 1])
    for landmark in range(4):
        log.add_landmark(landmark)
        for sighting in graph.sightings(landmark):
            log.add_sighting(sighting)
    places = dict(enumerate(LANDMARKS))
    _, condensed = Windows(log, 6).condensed(0, np.arange(24), poses, places)
    factor = condensed_factor(condensed, 0, 6, np.array(names))
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose2(0.3, -0.2, 0.4))
    values.insert(X(6), gtsam.Pose2(5.0, 3.0, 1.2))
    for name in set(names):
        values.insert(j=L(name), point2=LANDMARKS[names.index(name)] + (0.3, -0.1))
    A, b = factor.linearize(values).jacobian()
    widths = [3, 3, *[2] * len(set(names))]
    numeric = np.zeros_like(A)
    keys = [X(0), X(6), *(L(name) for name in sorted(set(names)))]
    column = 0
    for key, width in zip(keys, widths, strict=True):
        for k in range(width):
            step = np.zeros(width)
            step[k] = 1e-5
            sides = []
            for sign in (1.0, -1.0):
                delta = gtsam.VectorValues()
                for each, size in zip(keys, widths, strict=True):
                    delta.insert(each, sign * step if each == key else np.zeros(size))
                moved = values.retract(delta)
                sides.append(-factor.linearize(moved).jacobian()[1])
            numeric[:, column] = (sides[0] - sides[1]) / 2e-5
            column += 1
    np.testing.assert_allclose(A, numeric, atol=1e-3 * np.abs(A).max())
    assert np.isfinite(b).all()


def test_covariances_by_the_pieces_around_are_those_of_the_whole_but_for_what_is_far() -> None:
    """Of differences: as if the last pose were known they do not change where landmarks meet."""
    graph = driven(drive(1, num_poses=40), 6, halves)
    names = [0, 10, 3, 13]
    whole, around = graph.landmark_covariance(names), graph.covariance_around(names, names)
    assert graph.incidents == ()
    for first in (0, 2):
        apart = np.kron(np.eye(4)[first] - np.eye(4)[first + 1], np.eye(2))
        expected, found = (np.trace(apart @ each @ apart.T) for each in (whole, around))
        assert 0.99 * expected < found < 1.5 * expected


def test_what_was_sighted_once_changes_no_covariance_around() -> None:
    """It is left out where it is not asked about: with nothing else to say where it is."""
    names, clutter = [0, 10, 3, 13], [*range(100, 110)]
    graph = driven(drive(1, num_poses=40), 6, halves)
    for landmark in clutter:
        bearing = 0.01 * landmark
        offset = 4.0 * np.array([[np.cos(bearing), np.sin(bearing)]])
        graph.add_landmark(landmark, graph.pose(40).transform(offset)[0])
        graph.add_sighting(Sighting(40, landmark, 4.0, bearing, NOISE))
    graph.update()
    without, among = (
        graph.covariance_around(asked, names) for asked in (names, [*names, *clutter])
    )
    np.testing.assert_allclose(among[:8, :8], without, atol=1e-4 * np.trace(without))
    assert (np.diag(among)[8:] > 0.0).all()
    assert graph.incidents == ()


def turned_about(shared: int) -> Piece:
    """Two poses that see landmarks 5 and 6, and so many of 0 and 1, to 1 cm."""
    landmarks = (5, 6, *range(shared))
    by_things = 100.0 * np.eye(6 + 2 * len(landmarks))[:, 6:].reshape(-1, len(landmarks), 2)
    by_first, by_last = (np.zeros((len(by_things), 3)) for _ in range(2))
    by_first[:3], by_last[:3] = 100.0 * np.eye(3), -100.0 * np.eye(3)
    # In the pose's frame: all of them move and turn with it.
    for k in range(len(landmarks)):
        by_last[6 + 2 * k : 8 + 2 * k] = 100.0 * np.array([[-1.0, 0.0, float(k)], [0.0, -1.0, 1.0]])
    return Piece(10, 11, landmarks, by_first, by_last, by_things)


def test_pieces_that_turn_about_one_landmark_do_not_say_where_the_others_are() -> None:
    newest = Piece(
        20,
        21,
        (0, 1, 2),
        100.0 * np.vstack([np.eye(3), np.zeros((6, 3))]),
        np.zeros((9, 3)),
        100.0 * np.vstack([np.zeros((3, 6)), np.eye(6)]).reshape(9, 3, 2),
    )
    assert covariance_by([turned_about(0)], newest, [2, 5]) is None
    assert covariance_by([turned_about(1)], newest, [2, 5]) is None
    known = covariance_by([turned_about(2)], newest, [2, 5])
    assert known is not None
    np.testing.assert_allclose(known[:2, :2], 1e-4 * np.eye(2), rtol=1e-6)
    assert 1e-4 < known[2, 2] < 0.01


@pytest.mark.parametrize("seed", range(4))
def test_what_is_lone_in_one_piece_is_left_out_without_loss(seed: int) -> None:
    """Against the inverse of all that two pieces say; landmark 9 is two things of the second."""
    rng = np.random.default_rng(seed)
    first = some_piece(rng, 0, (0, 1, 2, 3, 4))
    second = some_piece(rng, 1, (1, 9, 7, 9, 4))
    order = [0, 1, 2, 3, 4, 7, 9]
    information = np.zeros((20, 20))
    for piece, poses in ((first, (piece_pose(14), piece_pose(17))), (second, (piece_pose(17), []))):
        A = np.zeros((len(piece.by_first), 20))
        for landmark, by_thing in zip(
            piece.landmarks, piece.by_things.transpose(1, 0, 2), strict=True
        ):
            A[:, 2 * order.index(landmark) + np.arange(2)] += by_thing
        for by_pose, columns in zip((piece.by_first, piece.by_last), poses, strict=True):
            A[:, columns] += by_pose[:, : len(columns)]
        information += A.T @ A
    found = covariance_by([first], second, [2, 9, 4])
    assert found is not None
    asked = [4, 5, 12, 13, 8, 9]
    np.testing.assert_allclose(found, np.linalg.inv(information)[np.ix_(asked, asked)], rtol=1e-6)


def some_piece(rng: np.random.Generator, first: int, landmarks: tuple[int, ...]) -> Piece:
    height = 2 * len(landmarks) + 6
    by_first, by_last = rng.normal(size=(2, height, 3))
    by_things = rng.normal(scale=9.0, size=(height, len(landmarks), 2))
    return Piece(first, first + 1, landmarks, by_first, by_last, by_things)


def piece_pose(start: int) -> list[int]:
    return list(range(start, start + 3))


def test_where_a_stretch_cannot_be_condensed_anew_nothing_is_condensed_any_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = drive(5, num_poses=30)
    whole, graph = (driven(made, length) for length in (0, 6))

    def refuse(*_: object) -> None:
        raise GraphError("a stretch is nearly singular")

    with monkeypatch.context() as patch:
        patch.setattr("semgraph.graph.windows.condense", refuse)
        graph.remove(1)
    whole.remove(1)
    whole.update()
    graph.update()
    assert num_condensed(graph) == 0
    assert graph.incidents == ("nothing is condensed any more: a stretch is nearly singular",)
    assert_close(optimum(graph), optimum(whole))


def test_the_weakest_link_is_that_across_which_least_was_sighted() -> None:
    """All motions are as unsure; nothing sighted before pose 6 is sighted from there on."""
    made = drive(1, num_poses=10)
    graph = FactorGraph(made.start)
    for pose in range(1, 11):
        add_scan(graph, made, pose, lambda pose, k: k if pose < 6 else k + 10)
        graph.update()
    assert graph.weakest_link(1) == (6, 0)
    assert graph.weakest_link(7)[1] == 4
