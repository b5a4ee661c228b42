"""Small drives past four landmarks, and the factor graphs made of them."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.factor_graph import FactorGraph
from semgraph.graph.factors import Sighting
from semgraph.measurement_model import predict

LANDMARKS = np.array([[3.0, 4.0], [6.0, -2.0], [8.0, 5.0], [2.0, -5.0]])
START = UncertainPose2(Pose2(), np.diag([1e-3, 1e-3, 1e-4]) ** 2)
STEP_COVARIANCE = np.diag([0.05, 0.03, 0.02]) ** 2
# Of (range, bearing): unequal and correlated, so that no order can be mistaken for another.
NOISE = np.array([[0.05**2, 2e-4], [2e-4, 0.01**2]])


@dataclass(frozen=True)
class Drive:
    """What was measured on a drive past the landmarks, pose by pose."""

    start: UncertainPose2 = START
    motions: list[UncertainPose2] = field(default_factory=list)
    guesses: list[Pose2] = field(default_factory=list)
    seen: list[tuple[int, int, float, float]] = field(default_factory=list)

    def of_pose(self, pose: int) -> list[tuple[int, int, float, float]]:
        return [each for each in self.seen if each[0] == pose]


def drive(seed: int = 0, num_poses: int = 8, start: UncertainPose2 = START) -> Drive:
    """Every landmark is sighted from each pose but the start, with the noise that is stated."""
    rng = np.random.default_rng(seed)
    made, pose = Drive(start), start.pose
    points = start.pose.transform(LANDMARKS)
    for index in range(1, num_poses + 1):
        step = Pose2(1.0, 0.05, 0.1)
        pose = pose @ step
        noise = rng.multivariate_normal(np.zeros(3), STEP_COVARIANCE)
        made.motions.append(UncertainPose2(step @ Pose2.from_array(noise), STEP_COVARIANCE))
        made.guesses.append(pose @ Pose2(0.1, -0.1, 0.02))
        polar = predict(pose, points)
        polar += np.clip(rng.multivariate_normal(np.zeros(2), NOISE, len(points)), -0.1, 0.1)
        made.seen.extend((index, k, float(r), float(b)) for k, (r, b) in enumerate(polar))
    return made


def add_scan(
    graph: FactorGraph, made: Drive, pose: int, name: Callable[[int, int], int] = lambda _, k: k
) -> None:
    """One pose of the drive; `name` (pose, landmark) is what its landmarks are called."""
    assert graph.add_pose(made.motions[pose - 1], made.guesses[pose - 1]) == pose
    for _, landmark, range_m, bearing in made.of_pose(pose):
        called = name(pose, landmark)
        if called not in graph.landmarks():
            guess = made.start.pose.transform(LANDMARKS[[landmark]] + 0.2)[0]
            graph.add_landmark(called, guess)
        graph.add_sighting(Sighting(pose, called, range_m, bearing, NOISE, track=called))


def built(
    made: Drive, every: int = 1, name: Callable[[int, int], int] = lambda _, k: k
) -> FactorGraph:
    graph = FactorGraph(made.start)
    for pose in range(1, len(made.motions) + 1):
        add_scan(graph, made, pose, name)
        if pose % every == 0:
            graph.update()
    graph.update()
    return graph


def polished(graph: FactorGraph) -> FactorGraph:
    graph.polish()
    return graph


def assert_same(a: FactorGraph, b: FactorGraph, atol: float = 1e-4) -> None:
    one, other = a.estimate(), b.estimate()
    np.testing.assert_allclose(one.map_T_bases, other.map_T_bases, atol=atol)
    assert one.map_t_landmarks.keys() == other.map_t_landmarks.keys()
    for landmark, position in one.map_t_landmarks.items():
        np.testing.assert_allclose(position, other.map_t_landmarks[landmark], atol=atol)
    order = sorted(a.landmarks())
    np.testing.assert_allclose(
        a.landmark_covariance(order), b.landmark_covariance(order), rtol=0.01, atol=1e-7
    )


def halves(pose: int, landmark: int) -> int:
    """From the fifth pose on each landmark is taken for a new one."""
    return landmark + 10 * (pose > 4)
