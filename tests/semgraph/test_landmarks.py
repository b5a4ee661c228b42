import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.arrays import FloatArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2, wrap_angle
from semgraph.landmarks import (
    Diameter,
    Kind,
    Landmark,
    Marker,
    Perceptions,
    Rock,
    Tree,
    concatenate,
    polar_covariances,
    semantic_object,
)

SENSOR_POSES = st.builds(
    Pose2, st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-math.pi, math.pi)
)


def columns(n: int = 3) -> dict[str, Any]:
    """Valid columns of n perceptions, to be spoilt one at a time."""
    return {
        "stamp_ns": 7,
        "kinds": np.arange(n) % 3,
        "ranges_m": 3.0 + np.arange(n),
        "bearings": 0.5 * np.arange(n) - 0.5,
        "covariances": np.tile(np.array([[9e-4, 1e-5], [1e-5, 2.5e-5]]), (n, 1, 1)),
        "diameters_m": np.where(np.arange(n) % 2, np.nan, 0.3),
        "diameter_sigmas_m": np.where(np.arange(n) % 2, np.nan, 0.03),
        "identities": np.array([f"tag {k}" if k % 3 == 2 else "" for k in range(n)], dtype=np.str_),
        "reliabilities": np.linspace(0.0, 1.0, n),
        "common_shares": np.linspace(0.0, 0.5, n),
    }


@pytest.mark.parametrize("kind", list(Kind))
def test_kinds_and_labels_go_there_and_back(kind: Kind) -> None:
    assert Kind.from_label(kind.label) is kind
    assert Kind.from_label(f" {kind.label.title()} ") is kind


def test_an_unknown_label_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="tree, rock, marker, got 'bush'"):
        Kind.from_label("bush")


@pytest.mark.parametrize(
    ("kind", "expected"), [(Kind.TREE, Tree), (Kind.ROCK, Rock), (Kind.MARKER, Marker)]
)
def test_semantic_objects_are_of_their_class(
    kind: Kind, expected: type[Tree] | type[Rock] | type[Marker]
) -> None:
    full = semantic_object(kind, 0.3, 0.02, "A7")
    assert full == expected(Diameter(0.3, 0.02), "A7")
    assert full.kind is kind
    assert semantic_object(kind) == expected(None, "")


@pytest.mark.parametrize(("mean_m", "sigma_m"), [(0, 1), (-1, 1), (1, 0), (np.inf, 1), (1, np.nan)])
def test_an_impossible_diameter_is_refused(mean_m: float, sigma_m: float) -> None:
    with pytest.raises(InputError, match="diameter"):
        Diameter(mean_m, sigma_m)


@pytest.mark.parametrize(
    ("spoilt", "told"),
    [
        ({"map_t_landmark": np.zeros(3)}, "landmark position"),
        ({"map_t_landmark": np.array([np.nan, 0.0])}, "landmark position"),
        ({"covariance": np.diag([1.0, -1.0])}, "landmark covariance"),
        ({"reliability": 1.01}, "reliability"),
        ({"reliability": -0.01}, "reliability"),
        ({"reliability": np.nan}, "reliability"),
    ],
)
def test_an_impossible_landmark_is_refused(spoilt: dict[str, Any], told: str) -> None:
    good: dict[str, Any] = {
        "id": 0,
        "semantics": Tree(),
        "map_t_landmark": np.zeros(2),
        "covariance": np.eye(2),
        "num_sightings": 1,
        "reliability": 1.0,
    }
    assert Landmark(**good).reliability == 1.0
    with pytest.raises(InputError, match=told):
        Landmark(**{**good, **spoilt})


def test_iterating_gives_each_perception_as_a_value() -> None:
    perceptions = Perceptions(**columns(4))
    values = list(perceptions)
    assert len(perceptions) == len(values) == 4
    assert [value.semantics for value in values] == [
        Tree(Diameter(0.3, 0.03)),
        Rock(),
        Marker(Diameter(0.3, 0.03), "tag 2"),
        Tree(),
    ]
    for k, value in enumerate(values):
        assert value.range_m == perceptions.ranges_m[k]
        assert value.bearing == perceptions.bearings[k]
        assert value.reliability == perceptions.reliabilities[k]
        np.testing.assert_array_equal(value.covariance, perceptions.covariances[k])


def spoil(name: str, value: Any, place: int) -> dict[str, Any]:
    good = columns()
    values = np.array(good[name], copy=True)
    values[place] = value
    return {**good, name: values}


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("kinds", 3, "kinds"),
        ("kinds", -1, "kinds"),
        ("ranges_m", 0.0, "ranges"),
        ("ranges_m", -1.0, "ranges"),
        ("ranges_m", np.nan, "ranges"),
        ("ranges_m", np.inf, "ranges"),
        ("bearings", np.nan, "bearings"),
        ("bearings", np.inf, "bearings"),
        ("covariances", np.nan, "covariances"),
        ("covariances", np.zeros((2, 2)), "covariances"),
        ("covariances", np.diag([1.0, -1.0]), "covariances"),
        ("covariances", np.diag([-1.0, -1.0]), "covariances"),
        ("covariances", np.array([[1.0, 2.0], [2.0, 1.0]]), "covariances"),
        ("covariances", np.array([[1.0, 0.5], [-0.5, 1.0]]), "covariances"),
        ("reliabilities", 1.1, "reliabilities"),
        ("reliabilities", -0.1, "reliabilities"),
        ("reliabilities", np.nan, "reliabilities"),
        ("diameters_m", 0.0, "diameters"),
        ("diameters_m", -0.3, "diameters"),
        ("diameters_m", np.inf, "diameters"),
    ],
)
def test_values_outside_their_domain_are_refused(
    name: str, value: Any, told: str, place: int
) -> None:
    with pytest.raises(InputError, match=told) as caught:
        Perceptions(**spoil(name, value, place))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("sigma_m", [0.0, -0.1, np.nan, np.inf])
def test_a_diameter_needs_its_sigma(sigma_m: float) -> None:
    with pytest.raises(InputError, match="diameters: expected positive with a positive sigma"):
        Perceptions(**spoil("diameter_sigmas_m", sigma_m, 0))


@pytest.mark.parametrize("name", [name for name in columns() if name != "stamp_ns"])
@pytest.mark.parametrize("change", ["one less", "one more axis"])
def test_shapes_that_disagree_are_refused(name: str, change: str) -> None:
    good = columns()
    values = good[name][:-1] if change == "one less" else good[name][..., None]
    with pytest.raises(InputError):
        Perceptions(**{**good, name: values})


def test_perceptions_are_read_only_copies() -> None:
    mine = columns()
    perceptions = Perceptions(**mine)
    mine["ranges_m"][0] = 99.0
    assert perceptions.ranges_m[0] == 3.0
    for name in ("kinds", "ranges_m", "bearings", "covariances", "reliabilities"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(perceptions, name)[0] = 1


def test_no_perceptions_are_perceptions() -> None:
    empty = Perceptions(**columns(0))
    assert len(empty) == 0
    assert list(empty) == []
    assert empty.base_t_landmarks().shape == (0, 2)
    assert empty.seen_from(Pose2(1.0, 2.0, 3.0)).base_covariances().shape == (0, 2, 2)


def test_what_is_left_out_of_the_arrays_is_absent() -> None:
    sigmas = np.full(2, 0.1)
    perceptions = Perceptions.from_arrays(
        0, Kind.ROCK, np.ones(2), np.zeros(2), polar_covariances(sigmas, 2.0 * sigmas)
    )
    assert [perception.semantics for perception in perceptions] == [Rock(), Rock()]
    np.testing.assert_array_equal(perceptions.reliabilities, 1.0)
    np.testing.assert_allclose(perceptions.covariances, [np.diag([0.01, 0.04])] * 2)


def test_selecting_and_concatenating_give_the_same_back() -> None:
    whole = Perceptions(**columns(6))
    mask = np.arange(6) < 2
    again = concatenate(9, [whole.select(mask), whole.select(np.arange(2, 6))])
    assert again.stamp_ns == 9
    for name in Perceptions.__slots__[1:]:
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))


def test_bearings_are_counter_clockwise_from_ahead() -> None:
    perceptions = Perceptions.from_arrays(
        0,
        Kind.TREE,
        np.array([2.0, 3.0]),
        np.array([0.0, np.pi / 2]),
        np.tile(np.eye(2), (2, 1, 1)),
    )
    np.testing.assert_allclose(perceptions.base_t_landmarks(), [[2.0, 0.0], [0.0, 3.0]], atol=1e-12)


def test_a_landmark_ahead_errs_ahead_by_its_range_and_aside_by_its_bearing() -> None:
    perceptions = Perceptions.from_arrays(
        0, Kind.TREE, np.array([10.0]), np.zeros(1), np.diag([0.04, 0.01**2])[None]
    )
    np.testing.assert_allclose(perceptions.base_covariances()[0], np.diag([0.04, 0.01]))


@given(SENSOR_POSES)
def test_seen_from_keeps_every_point_where_it_is(base_T_sensor: Pose2) -> None:
    perceptions = Perceptions(**columns(5))
    seen = perceptions.seen_from(base_T_sensor)
    np.testing.assert_allclose(
        seen.base_t_landmarks(), base_T_sensor.transform(perceptions.base_t_landmarks()), atol=1e-9
    )
    assert ((seen.bearings >= -np.pi) & (seen.bearings < np.pi)).all()
    for name in ("kinds", "diameters_m", "identities", "reliabilities"):
        np.testing.assert_array_equal(getattr(seen, name), getattr(perceptions, name))


@given(SENSOR_POSES)
def test_seen_from_the_inverse_is_the_same_again(base_T_sensor: Pose2) -> None:
    perceptions = Perceptions(**columns(5))
    again = perceptions.seen_from(base_T_sensor).seen_from(base_T_sensor.inverse())
    np.testing.assert_allclose(again.ranges_m, perceptions.ranges_m, atol=1e-9)
    np.testing.assert_allclose(wrap_angle(again.bearings - perceptions.bearings), 0.0, atol=1e-9)
    np.testing.assert_allclose(again.covariances, perceptions.covariances, rtol=1e-6, atol=1e-12)


def monte_carlo(perceptions: Perceptions, base_T_sensor: Pose2, count: int) -> FloatArray:
    """(count, 2) range and bearing from base of the one perception with its noise drawn."""
    rng = np.random.default_rng(5)
    polar = rng.multivariate_normal(
        [perceptions.ranges_m[0], perceptions.bearings[0]], perceptions.covariances[0], count
    )
    sensor_t_points = polar[:, :1] * np.column_stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])])
    points = base_T_sensor.transform(sensor_t_points)
    return np.column_stack([np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])])


@pytest.mark.parametrize(
    "base_T_sensor", [Pose2(), Pose2(1.5, -0.5, 0.8), Pose2(-3.0, 1.0, -2.5), Pose2(0.0, 0.0, 3.0)]
)
def test_covariances_seen_from_base_are_those_of_monte_carlo(base_T_sensor: Pose2) -> None:
    perceptions = Perceptions.from_arrays(
        0, Kind.TREE, np.array([6.0]), np.array([0.4]), np.array([[[4e-4, 5e-5], [5e-5, 1e-4]]])
    )
    seen = perceptions.seen_from(base_T_sensor)
    polar = monte_carlo(perceptions, base_T_sensor, 60_000)
    errors = polar - (seen.ranges_m[0], seen.bearings[0])
    errors[:, 1] = wrap_angle(errors[:, 1])
    whitened = np.linalg.solve(np.linalg.cholesky(seen.covariances[0]), errors.T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(2), atol=0.03)


def test_a_landmark_at_the_base_itself_has_no_bearing_and_is_left_out() -> None:
    perceptions = Perceptions(**columns(3))
    place = perceptions.base_t_landmarks()[1]
    seen = perceptions.seen_from(Pose2(-float(place[0]), -float(place[1]), 0.0))
    np.testing.assert_array_equal(seen.kinds, perceptions.kinds[[0, 2]])
