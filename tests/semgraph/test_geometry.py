import math
from collections.abc import Callable

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.geometry import (
    Pose2,
    UncertainPose2,
    frozen_covariance,
    pose_in_degrees,
    relative_poses,
    rotation,
    transform_points,
    wrap_angle,
)

METRES = st.floats(-1e3, 1e3)
POSES = st.builds(Pose2, METRES, METRES, st.floats(-math.pi, math.pi, exclude_max=True))
POINTS = st.lists(st.tuples(METRES, METRES), min_size=1, max_size=5).map(np.array)


def assert_same(one: Pose2, other: Pose2) -> None:
    assert (one.x, one.y) == pytest.approx((other.x, other.y), abs=1e-9)
    assert wrap_angle(one.theta - other.theta) == pytest.approx(0.0, abs=1e-11)


def homogeneous(pose: Pose2) -> FloatArray:
    matrix = np.eye(3)
    matrix[:2, :2] = rotation(pose.theta)
    matrix[:2, 2] = pose.x, pose.y
    return matrix


def random_covariance(rng: np.random.Generator, sigmas: tuple[float, ...]) -> FloatArray:
    root = np.diag(sigmas) @ (np.eye(len(sigmas)) + 0.4 * rng.standard_normal((len(sigmas),) * 2))
    return root @ root.T


def drawn(
    rng: np.random.Generator, uncertain: UncertainPose2, count: int
) -> tuple[FloatArray, FloatArray]:
    """(count, 2) positions and (count,) headings of poses with their error in the body frame."""
    errors = rng.multivariate_normal(np.zeros(3), uncertain.covariance, count)
    positions = uncertain.pose.transform(errors[:, :2])
    return positions, uncertain.pose.theta + errors[:, 2]


def body_errors(mean: Pose2, positions: FloatArray, headings: FloatArray) -> FloatArray:
    return np.column_stack([mean.inverse().transform(positions), wrap_angle(headings - mean.theta)])


@given(POSES, POSES, POSES)
def test_composition_is_associative(a: Pose2, b: Pose2, c: Pose2) -> None:
    assert_same((a @ b) @ c, a @ (b @ c))


@given(POSES)
def test_the_identity_changes_nothing_and_the_inverse_undoes(a: Pose2) -> None:
    assert_same(a @ Pose2(), a)
    assert_same(Pose2() @ a, a)
    assert_same(a @ a.inverse(), Pose2())
    assert_same(a.inverse() @ a, Pose2())
    assert_same(a.inverse().inverse(), a)


@given(POSES, POSES)
def test_the_inverse_of_a_product_is_the_product_of_inverses(a: Pose2, b: Pose2) -> None:
    assert_same((a @ b).inverse(), b.inverse() @ a.inverse())


@given(POSES, POSES)
def test_between_leads_from_one_pose_to_the_other(a: Pose2, b: Pose2) -> None:
    assert_same(a @ a.between(b), b)


@given(POSES, POSES, POINTS)
def test_composition_is_one_transform_after_the_other(
    a: Pose2, b: Pose2, points: FloatArray
) -> None:
    np.testing.assert_allclose(
        (a @ b).transform(points), a.transform(b.transform(points)), atol=1e-9
    )
    np.testing.assert_allclose(a.inverse().transform(a.transform(points)), points, atol=1e-9)


@given(POSES, POSES)
def test_composition_is_the_product_of_matrices(a: Pose2, b: Pose2) -> None:
    np.testing.assert_allclose(homogeneous(a @ b), homogeneous(a) @ homogeneous(b), atol=1e-9)


@given(POSES)
def test_arrays_have_the_order_x_y_theta(a: Pose2) -> None:
    np.testing.assert_array_equal(a.as_array(), [a.x, a.y, a.theta])
    assert Pose2.from_array(a.as_array()) == a


def test_a_quarter_turn_to_the_left_takes_ahead_to_the_left() -> None:
    map_T_base = Pose2(10.0, 20.0, math.pi / 2)
    np.testing.assert_allclose(map_T_base.transform(np.array([[3.0, 0.0]])), [[10.0, 23.0]])
    assert_same(map_T_base @ Pose2(3.0, 1.0, 0.5), Pose2(9.0, 23.0, math.pi / 2 + 0.5))


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_are_the_same_direction_in_the_half_open_turn(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)
    assert wrap_angle(np.array([angle]))[0] == wrapped


@pytest.mark.parametrize("turns", [-3, -1, 1, 3])
@pytest.mark.parametrize("ulps", [-1, 0, 1])
def test_angles_beside_half_a_turn_stay_in_the_half_open_turn(turns: int, ulps: int) -> None:
    angle = turns * math.pi
    if ulps:
        angle = math.nextafter(angle, ulps * math.inf)
    assert -math.pi <= wrap_angle(angle) < math.pi
    assert -math.pi <= wrap_angle(np.array([angle]))[0] < math.pi


@given(POSES)
def test_the_adjoint_is_that_of_the_numerical_conjugation(a_T_b: Pose2) -> None:
    step = 1e-4
    numerical = np.zeros((3, 3))
    for axis in range(3):
        plus, minus = (
            (a_T_b @ Pose2.from_array(sign * step * np.eye(3)[axis]) @ a_T_b.inverse()).as_array()
            for sign in (1.0, -1.0)
        )
        numerical[:, axis] = (plus - minus) / (2.0 * step)
    np.testing.assert_allclose(a_T_b.adjoint(), numerical, atol=1e-4)


@given(POSES, POSES)
def test_the_adjoint_of_a_product_is_the_product_of_adjoints(a: Pose2, b: Pose2) -> None:
    np.testing.assert_allclose((a @ b).adjoint(), a.adjoint() @ b.adjoint(), atol=1e-8)


def test_the_tangent_has_the_order_x_y_theta_in_the_body_frame() -> None:
    """An error along the way of a robot that looks along +y of the map is one in y of the map."""
    exact = UncertainPose2(Pose2(5.0, 7.0, math.pi / 2), np.zeros((3, 3)))
    along = UncertainPose2(Pose2(), np.diag([0.04, 0.0, 0.0]))
    np.testing.assert_allclose((exact @ along).covariance, np.diag([0.04, 0.0, 0.0]), atol=1e-15)
    in_map = rotation(exact.pose.theta) @ np.diag([0.04, 0.0]) @ rotation(exact.pose.theta).T
    np.testing.assert_allclose(in_map, np.diag([0.0, 0.04]), atol=1e-15)
    heading = UncertainPose2(Pose2(), np.diag([0.0, 0.0, 1e-4]))
    ahead = UncertainPose2(Pose2(10.0, 0.0, 0.0), np.zeros((3, 3)))
    swung = (heading @ ahead).covariance
    np.testing.assert_allclose(np.diag(swung), [0.0, 100.0 * 1e-4, 1e-4], atol=1e-15)
    assert swung[1, 2] == pytest.approx(10.0 * 1e-4)


def test_the_tangent_is_that_of_gtsam() -> None:
    pose = Pose2(1.5, -2.0, 0.7)
    theirs = gtsam.Pose2(pose.x, pose.y, pose.theta)
    np.testing.assert_allclose(theirs.AdjointMap(), pose.adjoint(), atol=1e-12)
    small = Pose2(1e-5, -2e-5, 3e-5)
    moved = theirs.retract(small.as_array())
    assert_same(Pose2(moved.x(), moved.y(), moved.theta()), pose @ small)


@pytest.mark.parametrize("seed", range(3))
def test_the_covariance_of_a_product_is_that_of_monte_carlo(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = UncertainPose2(Pose2(3.0, -1.0, 0.9), random_covariance(rng, (0.1, 0.03, 0.02)))
    b = UncertainPose2(Pose2(4.0, 2.0, -1.7), random_covariance(rng, (0.02, 0.08, 0.03)))
    product = a @ b
    (a_positions, a_headings), (b_positions, b_headings) = (
        drawn(rng, pose, 40_000) for pose in (a, b)
    )
    drawn_a = np.column_stack([a_positions, a_headings])
    positions = transform_points(drawn_a, b_positions)
    errors = body_errors(product.pose, positions, a_headings + b_headings)
    whitened = np.linalg.solve(np.linalg.cholesky(product.covariance), errors.T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.04)


@pytest.mark.parametrize("seed", range(3))
def test_the_covariance_of_an_inverse_is_that_of_monte_carlo(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a_T_b = UncertainPose2(Pose2(3.0, -1.0, 0.9), random_covariance(rng, (0.1, 0.03, 0.02)))
    positions, headings = drawn(rng, a_T_b, 40_000)
    b_T_a = relative_poses(np.column_stack([positions, headings]), np.zeros((40_000, 3)))
    inverse = a_T_b.inverse()
    errors = body_errors(inverse.pose, b_T_a[:, :2], b_T_a[:, 2])
    whitened = np.linalg.solve(np.linalg.cholesky(inverse.covariance), errors.T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.04)
    np.testing.assert_allclose(inverse.inverse().covariance, a_T_b.covariance, atol=1e-12)


@given(st.lists(st.tuples(POSES, POSES), min_size=1, max_size=6))
def test_rows_of_poses_are_what_single_poses_are(pairs: list[tuple[Pose2, Pose2]]) -> None:
    a, b = (np.array([pair[k].as_array() for pair in pairs]) for k in (0, 1))
    for (one, other), a_T_b, placed in zip(
        pairs, relative_poses(a, b), transform_points(a, b[:, :2]), strict=True
    ):
        assert_same(Pose2.from_array(a_T_b), one.between(other))
        np.testing.assert_allclose(placed, one.transform(other.as_array()[None, :2])[0], atol=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(3))
def test_a_pose_that_is_not_finite_is_refused(bad: float, place: int) -> None:
    values = np.array([1.0, 2.0, 3.0])
    values[place] = bad
    with pytest.raises(InputError, match="expected finite"):
        Pose2.from_array(values)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (np.eye(2), "expected shape"),
        (np.ones(3), "expected shape"),
        (np.diag([1.0, np.nan, 1.0]), "expected finite"),
        (np.diag([1.0, -0.1, 1.0]), "positive semi-definite"),
        (np.array([[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]]), "symmetric"),
        (np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), "positive semi-definite"),
    ],
)
@pytest.mark.parametrize(
    "make",
    [
        lambda values: UncertainPose2(Pose2(), values).covariance,
        lambda values: frozen_covariance("this covariance", values, 3),
    ],
)
def test_what_is_no_covariance_is_refused(
    values: FloatArray, told: str, make: Callable[[FloatArray], FloatArray]
) -> None:
    with pytest.raises(InputError, match=told) as caught:
        make(values)
    assert "\n" not in str(caught.value)


def test_a_covariance_is_a_read_only_copy() -> None:
    mine = np.eye(3)
    pose = UncertainPose2(Pose2(), mine)
    mine[0, 0] = 9.0
    assert pose.covariance[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        pose.covariance[0, 0] = 2.0


def test_a_yaw_that_a_person_wrote_is_in_degrees() -> None:
    pose = pose_in_degrees(1.0, -2.0, 450.0)
    assert (pose.x, pose.y) == (1.0, -2.0)
    assert pose.theta == pytest.approx(math.pi / 2.0)
