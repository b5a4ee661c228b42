import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.errors import InputError
from semgraph.geometry import Pose2, UncertainPose2, relative_poses, transform_points, wrap_angle

coordinates = st.floats(-50.0, 50.0)
poses = st.builds(Pose2, coordinates, coordinates, st.floats(-3.0, 3.0))


def close(first: Pose2, second: Pose2) -> bool:
    offset = first.between(second).as_array()
    return bool(np.abs(offset).max() < 1e-9)


@given(poses, poses, poses)
def test_poses_are_a_group(a: Pose2, b: Pose2, c: Pose2) -> None:
    assert close((a @ b) @ c, a @ (b @ c))
    assert close(a @ a.inverse(), Pose2())
    assert close(a @ a.between(b), b)


@given(poses, poses)
def test_frames_cancel_for_points_too(a: Pose2, b: Pose2) -> None:
    points = np.array([[1.0, 2.0], [-3.0, 0.5]])
    np.testing.assert_allclose((a @ b).transform(points), a.transform(b.transform(points)))
    rows = np.array([a.as_array(), b.as_array()])
    expected = [a.transform(points[:1])[0], b.transform(points[1:])[0]]
    np.testing.assert_allclose(transform_points(rows, points), expected, atol=1e-9)
    between = relative_poses(rows[:1], rows[1:])[0]
    np.testing.assert_allclose(between, a.between(b).as_array(), atol=1e-9)


@given(poses)
def test_adjoint_moves_a_tangent_vector(a: Pose2) -> None:
    small = 1e-6 * np.array([0.3, -0.7, 0.5])
    moved = (a @ Pose2.from_array(small) @ a.inverse()).as_array()
    np.testing.assert_allclose(moved, a.adjoint() @ small, atol=1e-9)


def test_composed_covariance_agrees_with_monte_carlo() -> None:
    rng = np.random.default_rng(3)
    first = UncertainPose2(Pose2(2.0, 1.0, 0.7), np.diag([0.02, 0.01, 0.005]) ** 2)
    second = UncertainPose2(Pose2(5.0, -1.0, -0.4), np.diag([0.01, 0.03, 0.004]) ** 2)
    composed = first @ second
    samples = np.array(
        [
            composed.pose.between(
                first.pose
                @ Pose2.from_array(rng.multivariate_normal(np.zeros(3), first.covariance))
                @ second.pose
                @ Pose2.from_array(rng.multivariate_normal(np.zeros(3), second.covariance))
            ).as_array()
            for _ in range(4000)
        ]
    )
    spread = np.sqrt(np.diag(np.cov(samples.T)) / np.diag(composed.covariance))
    np.testing.assert_allclose(spread, 1.0, atol=0.06)


def test_covariance_is_in_the_bodys_own_frame_x_first() -> None:
    facing_left = Pose2(0.0, 0.0, np.pi / 2)
    along = UncertainPose2(facing_left, np.diag([1.0, 0.0, 0.0]))
    in_map = facing_left.adjoint() @ along.covariance @ facing_left.adjoint().T
    np.testing.assert_allclose(np.diag(in_map), [0.0, 1.0, 0.0], atol=1e-12)


@given(st.floats(-1000.0, 1000.0))
def test_wrapped_angles_are_the_same_angle(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)


@pytest.mark.parametrize(
    "covariance",
    [np.diag([1.0, -1.0, 1.0]), np.full((3, 3), np.nan), np.eye(2), np.triu(np.ones((3, 3)))],
)
def test_what_is_no_covariance_is_refused(covariance: np.ndarray) -> None:
    with pytest.raises(InputError):
        UncertainPose2(Pose2(), covariance)


def test_a_pose_that_is_not_finite_is_refused() -> None:
    with pytest.raises(InputError):
        Pose2(np.nan, 0.0, 0.0)
