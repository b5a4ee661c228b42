import gtsam
import numpy as np
import pytest
from scipy.optimize import least_squares

from semgraph.errors import SemgraphError
from semgraph.factor_graph import FactorGraph, Sighting
from semgraph.geometry import Pose2, UncertainPose2, wrap_angle

STEP = UncertainPose2(Pose2(1.0, 0.0, 0.1), np.diag([0.05, 0.03, 0.02]) ** 2)
START = UncertainPose2(Pose2(), np.diag([1e-3, 1e-3, 1e-4]) ** 2)
LANDMARKS = np.array([[3.0, 4.0], [6.0, -2.0], [8.0, 5.0]])
NOISE = np.diag([0.05**2, 0.01**2])


def sighting(pose: int, landmark: int, seen_from: Pose2, rng: np.random.Generator) -> Sighting:
    x, y = seen_from.inverse().transform(LANDMARKS[[landmark % 3]])[0]
    return Sighting(
        pose=pose,
        landmark=landmark,
        range_m=float(np.hypot(x, y) + 0.05 * rng.standard_normal()),
        bearing=float(np.arctan2(y, x) + 0.01 * rng.standard_normal()),
        covariance=NOISE,
    )


def build(seed: int = 0, num_poses: int = 8, twin: bool = False) -> FactorGraph:  # noqa: FBT001  test
    """A drive past three landmarks; with `twin` the later half calls landmark 0 number 3."""
    rng = np.random.default_rng(seed)
    graph = FactorGraph(START)
    pose = Pose2()
    for index in range(1, num_poses + 1):
        noise = rng.multivariate_normal(np.zeros(3), STEP.covariance)
        pose = pose @ STEP.pose @ Pose2.from_array(noise)
        assert graph.add_pose(STEP, pose) == index
        for landmark in (0, 1, 2):
            name = 3 if twin and landmark == 0 and index > num_poses // 2 else landmark
            if name not in graph.landmarks():
                graph.add_landmark(name, LANDMARKS[landmark] + 0.1)
            graph.add_sighting(sighting(index, name, pose, rng))
        graph.update()
    return graph


def test_the_optimum_is_that_of_an_independent_solver() -> None:
    graph = build()
    graph.polish()
    estimate = graph.estimate()
    n = graph.num_poses
    rows = [each for landmark in graph.landmarks() for each in graph.sightings(landmark)]

    def residuals(x: np.ndarray) -> np.ndarray:
        poses = [Pose2(*row) for row in x[: 3 * n].reshape(n, 3)]
        points = x[3 * n :].reshape(-1, 2)
        parts = [poses[0].as_array() / np.sqrt(np.diag(START.covariance))]
        for k in range(n - 1):
            error = gtsam.Pose2.Logmap(
                gtsam.Pose2(*STEP.pose.as_array()).between(
                    gtsam.Pose2(*poses[k].between(poses[k + 1]).as_array())
                )
            )
            parts.append(error / np.sqrt(np.diag(STEP.covariance)))
        for each in rows:
            a, b = poses[each.pose].inverse().transform(points[[each.landmark]])[0]
            parts.append(
                np.array(
                    [
                        (np.hypot(a, b) - each.range_m) / 0.05,
                        wrap_angle(float(np.arctan2(b, a)) - each.bearing) / 0.01,
                    ]
                )
            )
        return np.concatenate(parts)

    points = np.array([estimate.map_t_landmarks[k] for k in range(3)])
    ours = np.concatenate([estimate.map_T_bases.ravel(), points.ravel()])
    solution = least_squares(residuals, ours + 0.01, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(ours, solution.x, atol=1e-4)
    information = solution.jac.T @ solution.jac
    expected = np.linalg.inv(information)[3 * n :, 3 * n :]
    np.testing.assert_allclose(graph.landmark_covariance([0, 1, 2]), expected, rtol=0.02, atol=1e-6)
    swapped = graph.landmark_covariance([2, 0, 1])
    np.testing.assert_allclose(
        swapped[:2, :2], graph.landmark_covariance([2]), rtol=1e-6, atol=1e-9
    )


def test_merging_gives_the_graph_of_the_true_identity() -> None:
    merged, known = build(twin=True), build()
    assert set(merged.landmarks()) == {0, 1, 2, 3}
    merged.merge(3, 0)
    merged.polish()
    known.polish()
    assert set(merged.landmarks()) == {0, 1, 2}
    np.testing.assert_allclose(
        merged.estimate().map_T_bases, known.estimate().map_T_bases, atol=1e-5
    )
    np.testing.assert_allclose(
        merged.landmark_covariance([0]), known.landmark_covariance([0]), 1e-4
    )


def test_bearing_and_range_noise_are_not_swapped() -> None:
    graph = FactorGraph(UncertainPose2(Pose2(), 1e-12 * np.eye(3)))
    graph.add_landmark(0, np.array([10.0, 0.0]))
    graph.add_sighting(Sighting(0, 0, 10.0, 0.0, np.diag([1.0**2, 0.001**2])))
    graph.update()
    np.testing.assert_allclose(
        graph.landmark_covariance([0]), np.diag([1.0, 1e-4]), rtol=1e-3, atol=1e-8
    )


def test_sigmas_that_differ_by_six_decades_are_solved() -> None:
    graph = FactorGraph(UncertainPose2(Pose2(), np.diag([100.0, 100.0, 3.0]) ** 2))
    fine = UncertainPose2(Pose2(1.0, 0.0, 0.0), np.diag([1e-4, 1e-4, 1e-5]) ** 2)
    for index in range(1, 20):
        graph.add_pose(fine, Pose2(float(index), 0.0, 0.0))
        graph.update()
    assert graph.incidents == ()
    np.testing.assert_allclose(graph.pose(19).as_array(), [19.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("range_m", "bearing", "covariance"),
    [
        (np.nan, 0.0, NOISE),
        (-1.0, 0.0, NOISE),
        (0.0, 0.0, NOISE),
        (5.0, np.inf, NOISE),
        (5.0, 0.0, np.diag([1.0, -1.0])),
        (5.0, 0.0, np.full((2, 2), np.nan)),
    ],
)
def test_what_gtsam_would_take_in_silence_is_refused(
    range_m: float, bearing: float, covariance: np.ndarray
) -> None:
    graph = build(num_poses=3)
    with pytest.raises(SemgraphError):
        graph.add_sighting(Sighting(1, 0, range_m, bearing, covariance))
    graph.update()
    assert graph.incidents == ()


def test_a_failed_update_is_named_and_the_graph_rebuilt(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = build(num_poses=4)
    expected = build(num_poses=5)

    class Failing:
        def update(self, *_: object) -> None:
            raise RuntimeError("Indeterminant linear system near variable 7\nmore")

    rng = np.random.default_rng(0)
    pose = Pose2()
    for _ in range(5):
        noise = rng.multivariate_normal(np.zeros(3), STEP.covariance)
        pose = pose @ STEP.pose @ Pose2.from_array(noise)
        fresh = [sighting(5, landmark, pose, rng) for landmark in (0, 1, 2)]
    graph.add_pose(STEP, pose)
    for each in fresh:
        graph.add_sighting(each)
    monkeypatch.setattr(graph, "_isam", Failing())
    graph.update()
    assert graph.incidents == (
        "update failed, graph rebuilt: Indeterminant linear system near variable 7",
    )
    graph.polish()
    expected.polish()
    np.testing.assert_allclose(
        graph.estimate().map_T_bases, expected.estimate().map_T_bases, atol=1e-6
    )
