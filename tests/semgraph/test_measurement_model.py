import numpy as np

from semgraph.geometry import Pose2
from semgraph.measurement_model import innovations, jacobians, mahalanobis2, predict


def test_jacobians_agree_with_numerical_ones() -> None:
    rng = np.random.default_rng(1)
    pose = Pose2(1.0, -2.0, 0.7)
    landmarks = rng.uniform(-10.0, 10.0, (8, 2))
    by_pose, by_landmark = jacobians(pose, landmarks)
    step = 1e-6
    predicted = predict(pose, landmarks)
    for column in range(3):
        tangent = np.zeros(3)
        tangent[column] = step
        moved = predict(pose @ Pose2.from_array(tangent), landmarks)
        numerical = innovations(predicted, moved[:, 0], moved[:, 1]) / step
        np.testing.assert_allclose(by_pose[:, :, column], numerical, atol=1e-5)
    for column in range(2):
        offset = np.zeros(2)
        offset[column] = step
        moved = predict(pose, landmarks + offset)
        numerical = innovations(predicted, moved[:, 0], moved[:, 1]) / step
        np.testing.assert_allclose(by_landmark[:, :, column], numerical, atol=1e-5)


def test_bearing_innovations_are_wrapped() -> None:
    predicted = np.array([[5.0, 3.1]])
    difference = innovations(predicted, np.array([5.5]), np.array([-3.1]))[0]
    np.testing.assert_allclose(difference, [0.5, 2 * np.pi - 6.2])


def test_mahalanobis_of_a_hand_computed_case() -> None:
    distances2 = mahalanobis2(np.array([[2.0, 3.0]]), np.diag([4.0, 9.0])[None])
    np.testing.assert_allclose(distances2, [2.0])
