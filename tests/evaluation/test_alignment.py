import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.alignment import reference_outliers, rigid_alignment, robust_alignment
from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2

poses = st.builds(
    Pose2,
    st.floats(-500.0, 500.0),
    st.floats(-500.0, 500.0),
    st.floats(-np.pi, np.pi, exclude_max=True),
)
seeds = st.integers(0, 2**32 - 1)


def assert_same_pose(first: Pose2, second: Pose2, tolerance: float) -> None:
    assert np.abs(first.between(second).as_array()).max() < tolerance


@given(world_T_map=poses, seed=seeds, n=st.integers(2, 40))
def test_any_rigid_motion_is_found(world_T_map: Pose2, seed: int, n: int) -> None:
    map_t_points = np.random.default_rng(seed).normal(0.0, 20.0, (n, 2))
    world_t_points = world_T_map.transform(map_t_points)
    for align in (rigid_alignment, robust_alignment):
        assert_same_pose(align(world_t_points, map_t_points), world_T_map, 1e-8)


@given(move=poses, seed=seeds)
def test_moving_the_world_moves_the_alignment(move: Pose2, seed: int) -> None:
    rng = np.random.default_rng(seed)
    world_t_points, map_t_points = rng.normal(0.0, 10.0, (2, 15, 2))
    for align in (rigid_alignment, robust_alignment):
        moved = align(move.transform(world_t_points), map_t_points)
        assert_same_pose(moved, move @ align(world_t_points, map_t_points), 1e-5)


def test_nothing_near_the_alignment_is_better() -> None:
    rng = np.random.default_rng(3)
    world_t_points, map_t_points = rng.normal(0.0, 10.0, (2, 15, 2))
    best = rigid_alignment(world_t_points, map_t_points)

    def cost(world_T_map: Pose2) -> float:
        return float(np.sum((world_t_points - world_T_map.transform(map_t_points)) ** 2))

    for nudge in rng.normal(0.0, 1e-3, (100, 3)):
        assert cost(best @ Pose2.from_array(nudge)) >= cost(best)


def test_weights_of_zero_leave_points_out() -> None:
    rng = np.random.default_rng(4)
    world_t_points, map_t_points = rng.normal(0.0, 10.0, (2, 8, 2))
    weights = np.array([1.0] * 5 + [0.0] * 3)
    weighted = rigid_alignment(world_t_points, map_t_points, weights)
    assert_same_pose(weighted, rigid_alignment(world_t_points[:5], map_t_points[:5]), 1e-9)


@pytest.mark.parametrize(("n", "m"), [(0, 0), (1, 1), (3, 4)])
def test_too_few_or_unpaired_points_are_refused(n: int, m: int) -> None:
    with pytest.raises(InputError, match="two or more pairs"):
        rigid_alignment(np.zeros((n, 2)), np.zeros((m, 2)))


@pytest.mark.parametrize("seed", range(20))
def test_gross_errors_neither_move_the_robust_alignment_nor_stay_unnamed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 400
    map_t_points = np.cumsum(rng.normal(0.0, 1.0, (n, 2)), axis=0)
    world_t_points = Pose2(5.0, 6.0, 2.0).transform(map_t_points) + rng.normal(0.0, 0.3, (n, 2))
    spoilt = rng.choice(n, 12, replace=False)
    world_t_points[spoilt] += rng.choice([-1.0, 1.0], (12, 2)) * rng.uniform(5.0, 150.0, (12, 2))
    aligned = robust_alignment(world_t_points, map_t_points)
    assert_same_pose(aligned, Pose2(5.0, 6.0, 2.0), 0.1)
    is_outlier = reference_outliers(world_t_points, aligned.transform(map_t_points))
    np.testing.assert_array_equal(np.flatnonzero(is_outlier), np.sort(spoilt))


def drive(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """A reference and an estimate beside it, 500 points along a wavy way."""
    along = np.linspace(0.0, 300.0, 500)
    way = np.column_stack([along, 20.0 * np.sin(along / 30.0)])
    return way + rng.normal(0.0, 0.3, way.shape), way


def test_an_estimate_that_bends_away_is_not_excused() -> None:
    reference, estimate = drive(np.random.default_rng(9))
    estimate[300:400, 0] += 10.0 * np.sin(np.linspace(0.0, np.pi, 100))
    assert not reference_outliers(reference, estimate).any()


@pytest.mark.parametrize("rows", [slice(200, 201), slice(200, 210), slice(200, 500)])
def test_an_estimate_that_jumps_is_not_excused(rows: slice) -> None:
    reference, estimate = drive(np.random.default_rng(10))
    estimate[rows] += 20.0
    assert not reference_outliers(reference, estimate).any()


@pytest.mark.parametrize("rows", [slice(0, 1), slice(200, 201), slice(200, 210), slice(495, 500)])
def test_a_reference_that_jumps_is_found(rows: slice) -> None:
    reference, estimate = drive(np.random.default_rng(11))
    reference[rows] += 20.0
    np.testing.assert_array_equal(
        np.flatnonzero(reference_outliers(reference, estimate)), np.arange(500)[rows]
    )
