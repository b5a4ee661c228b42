"""Likelihoods of poses: exact and by the field, what they are normalised by, what they ignore."""

from dataclasses import fields

import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.geometry import Pose2
from semgraph.known_map.fixed_map import FixedMap
from semgraph.known_map.likelihood_field import LikelihoodField
from semgraph.known_map.pose_likelihood import LikelihoodSettings, PoseLikelihood
from semgraph.landmarks import Kind, Perceptions
from tests.semgraph.stands import fixed, moved, perceive, stand

POSE = Pose2(30.0, 28.0, 0.7)


def likelihood(trees: FixedMap) -> PoseLikelihood:
    return PoseLikelihood(trees, LikelihoodSettings())


def test_the_true_pose_explains_far_better_than_others() -> None:
    trees = stand()
    model = likelihood(trees)
    seen = model.see(perceive(trees, POSE, 0, np.random.default_rng(1)))
    others = POSE.as_array() + np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.2]])
    logs = model.log_likelihoods(seen, others)
    assert logs[0] > 20.0
    assert (logs[1:] < logs[0] - 20.0).all()


def test_the_mean_over_the_map_is_one() -> None:
    trees = stand(num_trees=12, size_m=20.0)
    model = likelihood(trees)
    seen = model.see(perceive(trees, Pose2(10.0, 10.0), 0, np.random.default_rng(1), 4.0))
    seen = seen.blurred(0.4, 0.0)
    one = np.random.default_rng(2)
    low, high = trees.bounds()
    poses = np.column_stack([one.uniform(low, high, (400_000, 2)), one.uniform(-3.2, 3.2, 400_000)])
    first = type(seen)(*(getattr(seen, each.name)[:1] for each in fields(seen)))
    # Where the perceived point falls outside the box it meets nothing; hence a little below 1.
    mean = np.exp(model.log_likelihoods(first, poses)).mean()
    assert 0.75 < mean < 1.1


def test_the_field_agrees_with_the_exact_likelihood() -> None:
    trees = stand()
    model = likelihood(trees)
    seen = model.see(perceive(trees, POSE, 0, np.random.default_rng(1))).blurred(0.4, 0.0)
    rng = np.random.default_rng(3)
    poses = POSE.as_array() + rng.normal(0.0, [0.2, 0.2, 0.01], (200, 3))
    exact = model.log_likelihoods(seen, poses)
    weights = model.log_weights(seen, np.arange(len(seen))[:, None], np.arange(len(trees))[None])
    coarse = LikelihoodField(trees).log_likelihoods(seen, poses, weights)
    assert np.corrcoef(exact, coarse)[0, 1] > 0.95
    assert np.abs(exact - coarse).max() < 0.15 * np.abs(exact).max()


def test_the_order_of_perceptions_does_not_matter() -> None:
    trees = stand()
    model = likelihood(trees)
    perceptions = perceive(trees, POSE, 0, np.random.default_rng(1))
    shuffled = perceptions.select(np.random.default_rng(2).permutation(len(perceptions)))
    poses = POSE.as_array() + np.random.default_rng(4).normal(0.0, 0.05, (50, 3))
    np.testing.assert_allclose(
        model.log_likelihoods(model.see(perceptions), poses),
        model.log_likelihoods(model.see(shuffled), poses),
        rtol=1e-9,
    )


def test_the_world_may_be_elsewhere() -> None:
    trees = stand()
    perceptions = perceive(trees, POSE, 0, np.random.default_rng(1))
    elsewhere = Pose2(-100.0, 40.0, 0.0)
    shifted = likelihood(moved(trees, elsewhere))
    model = likelihood(trees)
    here = model.log_likelihoods(model.see(perceptions), POSE.as_array()[None])
    there = shifted.log_likelihoods(shifted.see(perceptions), (elsewhere @ POSE).as_array()[None])
    np.testing.assert_allclose(here, there, rtol=1e-6)


def test_another_kind_says_nothing_and_another_diameter_speaks_against() -> None:
    trees = fixed(np.array([[5.0, 0.0], [0.0, 6.0]]), np.array([0.2, 0.5]))
    model = likelihood(trees)
    at = np.zeros((1, 3))

    def of(kind: Kind, diameter_m: float) -> float:
        perceptions = Perceptions.from_arrays(
            0,
            kind,
            np.array([5.0]),
            np.array([0.0]),
            np.array([np.diag([1e-3, 1e-4])]),
            diameters_m=np.array([diameter_m]),
            diameter_sigmas_m=np.array([0.02]),
        )
        return float(model.log_likelihoods(model.see(perceptions), at)[0])

    assert of(Kind.TREE, 0.2) > of(Kind.TREE, 0.5) + 2.0
    assert of(Kind.ROCK, 0.2) == pytest.approx(np.log(0.2))


def test_identities_decide() -> None:
    trees = fixed(np.array([[5.0, 0.0], [0.0, 5.0]]))
    named = FixedMap(
        trees.map_t_landmarks,
        trees.covariances,
        trees.kinds,
        trees.diameters_m,
        trees.diameter_sigmas_m,
        np.array(["a", "b"]),
    )
    model = likelihood(named)
    perceptions = Perceptions.from_arrays(
        0,
        Kind.TREE,
        np.array([5.0]),
        np.array([0.0]),
        np.array([np.diag([1e-3, 1e-4])]),
        identities=np.array(["b"]),
    )
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2]])
    logs = [model.log_likelihoods(model.see(perceptions), pose[None])[0] for pose in poses]
    assert logs[1] > logs[0] + 5.0


def test_no_perceptions_say_nothing_and_no_landmarks_are_no_map() -> None:
    trees = stand()
    model = likelihood(trees)
    nothing = perceive(trees, Pose2(500.0, 500.0), 0, np.random.default_rng(0))
    assert (model.log_likelihoods(model.see(nothing), np.zeros((3, 3))) == 0.0).all()
    with pytest.raises(InputError, match="at least one landmark"):
        FixedMap.of_landmarks(())


def test_the_field_is_the_same_in_projected_coordinates() -> None:
    """Of a northing of 5,800 km 32 bit tell half a metre."""
    trees, far = stand(), Pose2(500_000.0, 5_800_000.0, 0.0)
    seen = likelihood(trees).see(perceive(trees, POSE, 0, np.random.default_rng(1)))
    poses = POSE.as_array() + np.random.default_rng(2).normal(0.0, [0.3, 0.3, 0.02], (200, 3))
    near, moved_there = (
        LikelihoodField(each).log_likelihoods(
            seen,
            at,
            likelihood(each).log_weights(
                seen, np.arange(len(seen))[:, None], np.arange(len(each))[None]
            ),
        )
        for each, at in (
            (trees, poses),
            (moved(trees, far), poses + far.as_array()),
        )
    )
    assert np.corrcoef(near, moved_there)[0, 1] > 0.999
