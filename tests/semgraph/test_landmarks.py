import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.geometry import Pose2
from semgraph.landmarks import (
    Diameter,
    Kind,
    Marker,
    Perceptions,
    Tree,
    concatenate,
    polar_covariances,
    semantic_object,
)


def trees(ranges_m: list[float], bearings: list[float]) -> Perceptions:
    n = len(ranges_m)
    return Perceptions.from_arrays(
        5,
        Kind.TREE,
        np.array(ranges_m),
        np.array(bearings),
        polar_covariances(np.full(n, 0.05), np.full(n, 0.01)),
    )


def test_semantic_objects_of_columns() -> None:
    assert semantic_object(Kind.TREE, 0.3, 0.02) == Tree(Diameter(0.3, 0.02))
    assert semantic_object(Kind.MARKER, identity="7") == Marker(identity="7")
    with pytest.raises(InputError, match="tree, rock, marker"):
        Kind.from_label("bush")


def test_seen_from_base_is_exact_in_position() -> None:
    base_T_laser = Pose2(3.78, 0.5, 0.3)
    perceptions = trees([4.0, 9.0], [0.2, -1.0])
    moved = perceptions.seen_from(base_T_laser)
    expected = base_T_laser.transform(perceptions.base_t_landmarks())
    np.testing.assert_allclose(moved.base_t_landmarks(), expected)


def test_seen_from_base_carries_the_covariance() -> None:
    rng = np.random.default_rng(0)
    base_T_laser = Pose2(1.0, 0.5, 0.3)
    moved = trees([6.0], [0.8]).seen_from(base_T_laser)
    samples = trees(
        list(6.0 + 0.05 * rng.standard_normal(20_000)),
        list(0.8 + 0.01 * rng.standard_normal(20_000)),
    ).seen_from(base_T_laser)
    measured = np.cov(np.array([samples.ranges_m, samples.bearings]))
    np.testing.assert_allclose(measured, moved.covariances[0], rtol=0.05, atol=2e-6)


@pytest.mark.parametrize(
    ("ranges_m", "bearings"),
    [([-1.0], [0.0]), ([0.0], [0.0]), ([np.nan], [0.0]), ([1.0], [np.inf])],
)
def test_what_no_sensor_can_perceive_is_refused(
    ranges_m: list[float], bearings: list[float]
) -> None:
    with pytest.raises(InputError):
        trees(ranges_m, bearings)


def test_perceptions_select_iterate_and_concatenate() -> None:
    perceptions = trees([4.0, 9.0, 2.0], [0.2, -1.0, 0.0])
    near = perceptions.select(perceptions.ranges_m < 5.0)
    assert [perception.range_m for perception in near] == [4.0, 2.0]
    assert len(concatenate(5, [near, perceptions])) == 5
    with pytest.raises(ValueError, match="read-only"):
        perceptions.ranges_m[0] = 1.0
