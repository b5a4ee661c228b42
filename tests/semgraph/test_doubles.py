"""What several sensors show at one moment is each thing once, and no two things are one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.arrays import FloatArray
from semgraph.doubles import each_once
from semgraph.landmarks import Kind, Perceptions
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.settings import load_settings
from sensors.measurements import Recording


def seen(
    base_t_things: FloatArray,
    sigma_m: float,
    rng: np.random.Generator | None = None,
    kind: Kind = Kind.TREE,
    stamp_ns: int = 0,
) -> Perceptions:
    """Things (n, 2) as one sensor perceives them, exactly if nothing is random."""
    x, y = base_t_things.T
    noise = np.zeros((2, len(x))) if rng is None else rng.normal(0.0, 1.0, (2, len(x)))
    ranges_m = np.hypot(x, y)
    sigmas = np.column_stack([np.full(len(x), sigma_m), sigma_m / ranges_m])
    return Perceptions.from_arrays(
        stamp_ns,
        kind,
        ranges_m + noise[0] * sigmas[:, 0],
        np.arctan2(y, x) + noise[1] * sigmas[:, 1],
        np.eye(2) * sigmas[:, None, :] ** 2,
    )


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(0, 12), st.integers(0, 12))
def test_what_both_show_is_there_once(seed: int, both: int, first: int, second: int) -> None:
    rng = np.random.default_rng(seed)
    grid = 1.0 + np.argwhere(np.ones((8, 8))) * 2.0
    things = grid[rng.permutation(len(grid))[: both + first + second]]
    one = seen(things[: both + first], 0.02, rng)
    other = seen(np.concatenate([things[:both], things[both + first :]]), 0.01, rng)
    once = each_once(7, [one, other])
    assert once.stamp_ns == 7
    assert len(once) == both + first + second
    apart_m = np.linalg.norm(once.base_t_landmarks()[:, None] - things[None], axis=2)
    assert sorted(apart_m.argmin(axis=1).tolist()) == list(range(len(things)))
    sigmas_m = np.sqrt(once.covariances[:, 0, 0])
    of_both = np.isclose(sigmas_m, (0.02**-2 + 0.01**-2) ** -0.5)
    of_one = np.isclose(sigmas_m, 0.02), np.isclose(sigmas_m, 0.01)
    assert [int(each.sum()) for each in (of_both, *of_one)] == [both, first, second]


@pytest.mark.parametrize("of_one_measurement", [False, True])
def test_two_that_are_alike_are_right_in_the_mean_and_as_sure_as_they_say(
    *, of_one_measurement: bool
) -> None:
    """The surer of two would be the nearer one: a bearing's error is less there."""
    rng, sigma_m = np.random.default_rng(1), 0.05
    things = 2.0 * np.argwhere(np.ones((40, 40))) + 5.0
    first = seen(things, sigma_m, rng)
    second = first if of_one_measurement else seen(things, sigma_m, rng)
    once = each_once(0, [first, second], of_one_measurement=of_one_measurement)
    assert len(once) == len(things)
    apart_m = np.linalg.norm(once.base_t_landmarks()[:, None] - things[None], axis=2)
    errors = once.ranges_m - np.linalg.norm(things, axis=1)[apart_m.argmin(axis=1)]
    normalized = errors / np.sqrt(once.covariances[:, 0, 0])
    assert abs(normalized.mean()) < 4.0 / len(things) ** 0.5
    assert normalized.std() == pytest.approx(1.0, abs=0.08)


def test_a_diameter_that_one_knows_is_known_and_of_two_it_is_the_mean() -> None:
    def thick(diameter_m: float, sigma_m: float) -> Perceptions:
        return Perceptions.from_arrays(
            0,
            Kind.TREE,
            np.array([5.0]),
            np.zeros(1),
            1e-4 * np.eye(2)[None],
            diameters_m=np.array([diameter_m]),
            diameter_sigmas_m=np.array([sigma_m]),
        )

    unknown = thick(np.nan, np.nan)
    for parts in ([thick(0.3, 0.02), unknown], [unknown, thick(0.3, 0.02)]):
        once = each_once(0, parts)
        assert once.diameters_m == pytest.approx(0.3)
        assert once.diameter_sigmas_m == pytest.approx(0.02)
    assert np.isnan(each_once(0, [unknown, unknown]).diameters_m).all()
    both = each_once(0, [thick(0.3, 0.02), thick(0.33, 0.02)])
    assert both.diameters_m == pytest.approx(0.315)
    assert both.diameter_sigmas_m == pytest.approx(0.02)


@pytest.mark.parametrize(("beside_m", "num_things"), [(0.05, 1), (0.3, 2)])
def test_what_stands_beside_is_another_thing(beside_m: float, num_things: int) -> None:
    """Farther off than noise and mounting say."""
    one, other = np.array([[5.0, 0.0]]), np.array([[5.0, beside_m]])
    assert len(each_once(0, [seen(one, 0.01), seen(other, 0.01)])) == num_things


def test_a_thick_trunk_seen_from_both_sides_is_one() -> None:
    """Where each sensor takes it to be differs by less than it is thick."""
    sides = [
        Perceptions.from_arrays(
            0,
            Kind.TREE,
            np.array([range_m]),
            np.zeros(1),
            1e-4 * np.eye(2)[None],
            diameters_m=np.array([0.6]),
            diameter_sigmas_m=np.array([0.02]),
        )
        for range_m in (5.0, 5.4)
    ]
    assert len(each_once(0, sides)) == 1


def test_kinds_names_and_diameters_keep_things_apart() -> None:
    place = np.array([[5.0, 1.0]])
    tree, rock = seen(place, 0.01), seen(place, 0.01, kind=Kind.ROCK)
    assert len(each_once(0, [tree, rock])) == 2

    def named(name: str, sigma_m: float = 0.01, diameter_m: float = np.nan) -> Perceptions:
        return Perceptions.from_arrays(
            0,
            Kind.MARKER,
            np.array([5.0]),
            np.zeros(1),
            sigma_m**2 * np.eye(2)[None],
            identities=np.array([name]),
            diameters_m=np.array([diameter_m]),
            diameter_sigmas_m=np.array([0.01 * diameter_m]),
        )

    assert len(each_once(0, [named("a"), named("b")])) == 2
    assert len(each_once(0, [named("", diameter_m=0.1), named("", diameter_m=0.4)])) == 2
    for parts in ([named("a", 0.02), named("")], [named(""), named("a", 0.02)]):
        assert each_once(0, parts).identities.tolist() == ["a"]


def test_of_three_sensors_too_and_of_none() -> None:
    places = np.array([[5.0, 1.0], [6.0, -3.0]])
    parts = [seen(places, sigma_m) for sigma_m in (0.02, 0.01, 0.03)]
    assert len(each_once(0, parts)) == 2
    assert len(each_once(0, [])) == 0


def test_a_map_of_two_sensors_that_begin_together_has_each_thing_once() -> None:
    rng = np.random.default_rng(3)
    trees = np.array([[4.0, 1.0], [6.0, -2.0], [3.0, 3.0], [8.0, 0.5]])
    both = [
        seen(trees, sigma_m, rng, stamp_ns=200_000_000 * k)
        for k in range(20)
        for sigma_m in (0.02, 0.03)
    ]
    recording = Recording("two sensors", both, len(both))
    settings = load_settings(None, [])
    result = run(recording, settings, Perceiver(recording, settings), Silence(), {})
    places = np.array([each.map_t_landmark for each in result.landmarks])
    assert len(places) == len(trees)
    assert np.linalg.norm(places[:, None] - trees[None], axis=2).min(axis=1).max() < 0.03
