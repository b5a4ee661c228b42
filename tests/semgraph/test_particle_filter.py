"""The particle filter: against a Kalman filter, from everywhere, shrinking, and lost."""

import numpy as np
import pytest

from semgraph.alignment import fuse_with_prior
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.known_map.belief import Belief
from semgraph.known_map.fixed_map import FixedMap
from semgraph.known_map.particles import (
    Gaussian,
    Particles,
    importance_samples,
    kld_number,
    num_bins,
    systematic,
)
from semgraph.known_map.pose_likelihood import LikelihoodSettings, PoseLikelihood
from semgraph.known_map.pose_quality import Elsewhere, UsualSight
from semgraph.landmarks import Kind, Perceptions
from semgraph.particle_filter import FilterSettings, ParticleFilter
from tests.semgraph.stands import ODOMETRY, fixed, measured, moved, perceive, stand

STEP = Pose2(0.3, 0.0, 0.03)
STILL = UncertainPose2(Pose2(), np.zeros((3, 3)))
# No clutter to speak of, and no error of the map but its own: the linear-Gaussian case.
PLAIN = LikelihoodSettings(clutter=1e-6, map_sigma_m=0.0)


def filter_in(
    trees: FixedMap, seed: int = 0, likelihood: LikelihoodSettings | None = None, least: int = 400
) -> ParticleFilter:
    settings = FilterSettings(least_particles=least)
    model = PoseLikelihood(trees, likelihood or LikelihoodSettings())
    return ParticleFilter(model, settings, np.random.default_rng(seed))


def driven(
    particles: ParticleFilter, trees: FixedMap, start: Pose2, num_scans: int, seed: int
) -> tuple[Belief, Pose2, list[Belief]]:
    rng, pose, beliefs = np.random.default_rng(seed), start, []
    for k in range(num_scans):
        motion = STILL
        if k:
            pose, motion = pose @ STEP, measured(STEP, rng)
        beliefs.append(particles.step(perceive(trees, pose, k, rng), motion))
    return beliefs[-1], pose, beliefs


def error(belief: Belief, pose: Pose2) -> tuple[float, float]:
    off = belief.map_T_base.pose.between(pose)
    return float(np.hypot(off.x, off.y)), abs(off.theta)


def is_near(belief: Belief, pose: Pose2, within_m: float, within_rad: float) -> bool:
    off_m, turned = error(belief, pose)
    return off_m < within_m and turned < within_rad


def test_agrees_with_a_kalman_filter_where_that_is_right() -> None:
    trees = fixed(np.array([[4.0, 3.0], [6.0, -5.0], [-3.0, 6.0], [12.0, 4.0]]), sigma_m=0.05)
    rng, pose = np.random.default_rng(5), Pose2()
    start = UncertainPose2(Pose2(0.05, -0.04, 0.02), np.diag([0.1, 0.1, 0.05]) ** 2)
    particles, kalman = filter_in(trees, 1, PLAIN, least=5000), start
    particles.start_at(start)
    for k in range(10):
        pose, motion = pose @ STEP, measured(STEP, rng)
        seen = perceive(trees, pose, k, rng, reach_m=30.0)
        belief = particles.step(seen, motion)
        prior = kalman @ motion
        R = np.array(
            [
                [np.cos(prior.pose.theta), -np.sin(prior.pose.theta)],
                [np.sin(prior.pose.theta), np.cos(prior.pose.theta)],
            ]
        )
        covariances = seen.base_covariances() + R.T @ trees.covariances @ R
        kalman = fuse_with_prior(
            prior.pose, prior, seen.base_t_landmarks(), trees.map_t_landmarks, covariances
        )
        apart = kalman.pose.between(belief.map_T_base.pose).as_array()
        sigmas = np.sqrt(np.diag(kalman.covariance))
        assert (np.abs(apart) < 0.2 * sigmas).all()
        ratios = np.sqrt(np.diag(belief.map_T_base.covariance)) / sigmas
        assert (np.abs(ratios - 1.0) < 0.15).all()


def test_finds_the_robot_anywhere_and_shrinks() -> None:
    trees = stand()
    for seed in range(3):
        particles = filter_in(trees, seed)
        last, pose, beliefs = driven(particles, trees, Pose2(25.0, 30.0, 2.0 * seed), 8, seed)
        assert is_near(last, pose, 0.1, 0.02)
        assert last.quality > 0.95
        assert last.is_one
        assert last.num_particles < beliefs[0].num_particles or last.num_particles == 400


def test_a_radius_is_enough_where_proposals_fail() -> None:
    trees = fixed(np.array([[10.0, 10.0], [14.0, 10.0], [11.0, 15.0]]))
    particles = filter_in(trees)
    particles.start_within(np.array([11.0, 11.0]), 3.0)
    first = particles.belief(0).num_particles
    last, pose, _ = driven(particles, trees, Pose2(10.5, 11.5, 0.3), 6, 0)
    assert first > 10_000
    assert last.num_particles < first / 10
    assert is_near(last, pose, 0.15, 0.03)


def test_carried_off_it_says_so_and_finds_itself_again() -> None:
    trees = stand(num_trees=80)
    particles = filter_in(trees)
    _, _, before = driven(particles, trees, Pose2(15.0, 20.0, 0.0), 6, 0)
    assert before[-1].quality > 0.95
    last, pose, after = driven(particles, trees, Pose2(45.0, 40.0, 3.0), 8, 1)
    wrong = [
        belief.quality > 0.9 and np.hypot(belief.map_T_base.pose.x - 45.0, 1e-9) > 10.0
        for belief in after[3:]
    ]
    assert not any(wrong)
    assert is_near(last, pose, 0.2, 0.03)
    assert last.quality > 0.9


def test_the_world_may_be_elsewhere() -> None:
    trees, elsewhere = stand(), Pose2(200.0, -50.0, 0.0)
    here = filter_in(trees, 3)
    there = filter_in(moved(trees, elsewhere), 3)
    pose = Pose2(30.0, 25.0, 1.0)
    one, true, _ = driven(here, trees, pose, 4, 7)
    other, _, _ = driven(there, trees, pose, 4, 7)
    apart = (elsewhere @ one.map_T_base.pose).between(other.map_T_base.pose)
    assert np.hypot(apart.x, apart.y) < 0.05
    assert is_near(one, true, 0.1, 0.02)


def test_the_order_of_perceptions_does_not_matter() -> None:
    trees = stand()
    seen = perceive(trees, Pose2(30.0, 25.0, 1.0), 0, np.random.default_rng(0))
    mixed = seen.select(np.random.default_rng(1).permutation(len(seen)))
    one, other = (filter_in(trees, 2).step(each, STILL) for each in (seen, mixed))
    apart = one.map_T_base.pose.between(other.map_T_base.pose)
    assert np.hypot(apart.x, apart.y) < 0.05


def test_nothing_perceived_leaves_all_open() -> None:
    trees = stand()
    nothing = Perceptions.from_arrays(0, Kind.TREE, np.zeros(0), np.zeros(0), np.zeros((0, 2, 2)))
    particles = filter_in(trees)
    assert particles.step(nothing, STILL).quality < 0.01
    particles.start_at(UncertainPose2(Pose2(30.0, 30.0), np.diag([0.1, 0.1, 0.05]) ** 2))
    believed = particles.step(nothing, UncertainPose2(STEP, ODOMETRY))
    assert believed.quality > 0.9
    np.testing.assert_allclose(believed.map_T_base.pose.x, 30.3, atol=0.05)


def test_one_tree_is_a_map_and_leaves_the_pose_open() -> None:
    trees = fixed(np.array([[5.0, 5.0]]))
    last, _, _ = driven(filter_in(trees), trees, Pose2(3.0, 4.0, 0.5), 4, 0)
    assert last.quality < 0.9


def test_two_alike_places_share_the_belief() -> None:
    group = np.array([[0.0, 0.0], [6.0, 1.0], [2.0, 7.0], [-4.0, 5.0]])
    trees = fixed(np.vstack([group, group + np.array([100.0, 0.0])]))
    last, pose, _ = driven(filter_in(trees), trees, Pose2(1.0, 3.0, 0.4), 4, 0)
    assert 0.25 < last.quality < 0.75
    off = min(error(last, pose)[0], error(last, Pose2(100.0) @ pose)[0])
    assert off < 0.2


def test_an_unknown_motion_leaves_no_track_but_a_region() -> None:
    trees = stand(num_trees=80)
    particles = filter_in(trees)
    _, pose, _ = driven(particles, trees, Pose2(20.0, 25.0, 0.5), 4, 0)
    rng, pose = np.random.default_rng(9), pose @ Pose2(4.0, -3.0, 1.5)
    open_motion = UncertainPose2(Pose2(), np.diag([3.0, 3.0, 1.8]) ** 2)
    nothing = Perceptions.from_arrays(0, Kind.TREE, np.zeros(0), np.zeros(0), np.zeros((0, 2, 2)))
    assert particles.step(nothing, open_motion).quality < 0.01
    found = particles.step(perceive(trees, pose, 5, rng), STILL)
    assert is_near(found, pose, 0.15, 0.03)
    assert found.quality > 0.9


def test_few_things_in_sight_speak_for_a_sparse_place() -> None:
    usual = UsualSight()
    assert usual.evidence(1.0) == 0.0
    for _ in range(10):
        usual.add(np.array([5.0, 12.0, 3.0, 8.0]), np.array([0.1, -2.0, 0.4, 1.5]))
    assert usual.number == pytest.approx(4.0)
    assert (usual.reach_m, usual.half_field) == (12.0, 2.0)
    assert usual.evidence(1.0) == pytest.approx(2.0)
    assert usual.evidence(-5.0) == -3.0
    model = PoseLikelihood(stand(num_trees=200), LikelihoodSettings())
    assert model.sparseness(np.array([500.0, 500.0]), 10.0) == 1.0
    assert abs(model.sparseness(np.array([30.0, 30.0]), 15.0)) < 0.6
    assert model.sparseness(np.array([30.0, 30.0]), 0.0) == 0.0


def test_elsewhere_weighs_evidence() -> None:
    doubt = Elsewhere(0.5)
    doubt.weigh(3.0)
    assert doubt.probability == pytest.approx(np.exp(-3.0) / (1.0 + np.exp(-3.0)), rel=1e-6)
    doubt.weigh(3.0)
    seen_again = doubt.wrong
    doubt.move(Pose2(1.5), 1e-3)
    assert doubt.gone == pytest.approx(1e-3, rel=0.1)
    doubt.weigh(3.0)
    assert doubt.wrong == pytest.approx(seen_again * np.exp(-0.3), rel=0.05)
    assert doubt.gone == pytest.approx(1e-3 * np.exp(-3.0), rel=0.1)
    for _ in range(20):
        doubt.move(Pose2(0.5), 1e-4)
        doubt.weigh(-5.0)
    assert doubt.probability > 0.99


def test_systematic_resampling_keeps_the_shares() -> None:
    weights = np.array([0.1, 0.0, 0.6, 0.3])
    rows = systematic(weights, 1000, np.random.default_rng(0))
    counts = np.bincount(rows, minlength=4)
    np.testing.assert_allclose(counts, 1000 * weights, atol=1.0)


def test_more_places_need_more_particles() -> None:
    assert kld_number(1) == 1
    assert kld_number(10) < kld_number(100) < kld_number(1000)
    # Fox 2003: about (bins - 1) / (2 error) for many.
    assert 10_000 < kld_number(1000) < 12_000
    poses = np.array([[0.1, 0.1, 0.0], [0.2, 0.1, 0.0], [5.0, 0.0, 0.0], [5.0, 0.0, 1.0]])
    assert num_bins(poses) == 3
    assert Particles.alike(poses).effective == pytest.approx(4.0)


def test_a_leap_is_found_again_by_what_is_near() -> None:
    """The same three trees stand in sixty places, only one of them near."""
    spots = np.vstack([[5.0, 5.0], np.random.default_rng(3).uniform(30.0, 400.0, (59, 2))])
    three = np.array([[0.0, 0.0], [4.0, 1.0], [1.0, 3.0]])
    trees = fixed((spots[:, None] + three).reshape(-1, 2))
    before, after = Pose2(3.0, 3.0, 0.2), Pose2(6.5, 2.0, 0.9)
    rng, still = np.random.default_rng(0), UncertainPose2(Pose2(), np.diag([0.1, 0.1, 0.05]) ** 2)
    particles = filter_in(trees)
    particles.start_at(UncertainPose2(before, np.diag([0.05, 0.05, 0.02]) ** 2))
    belief = particles.step(perceive(trees, before, 0, rng), STILL)
    for k in range(1, 4):
        belief = particles.step(perceive(trees, after, k, rng), still, leaps=0.01)
    assert is_near(belief, after, 0.15, 0.03)
    assert belief.quality > 0.9


def test_hardly_any_sample_with_weight_is_drawn_anew() -> None:
    narrow = Gaussian(np.array([1.0, 2.0, 0.3]), np.diag([0.2, 0.2, 0.05]) ** 2)
    wide = Gaussian(np.zeros(3), np.diag([3.0, 3.0, 1.0]) ** 2)
    drawn = wide.draw(300, np.random.default_rng(0))
    once = np.exp(narrow.log_densities(drawn) - wide.log_densities(drawn))
    assert Particles(drawn, once / once.sum()).effective < 5.0
    poses, log_weights = importance_samples(
        narrow.log_densities, (wide,), 300, np.random.default_rng(0)
    )
    weights = np.exp(log_weights)
    found = Particles(poses, weights / weights.sum())
    assert found.effective > 10.0
    np.testing.assert_allclose(found.gaussian().mean, narrow.mean, atol=0.1)
    assert 0.1 < np.sqrt(found.gaussian().covariance[0, 0]) < 0.3


def test_particles_far_apart_find_the_place_where_all_fits() -> None:
    """Five of many trees: elsewhere some of them fit, and particles half a metre apart are near."""
    found = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        trees, pose = fixed(rng.uniform(0, 60, (80, 2))), Pose2(30, 30, rng.uniform(-3, 3))
        model, settings = (
            PoseLikelihood(trees, LikelihoodSettings()),
            FilterSettings(most_particles=50_000),
        )
        particles = ParticleFilter(model, settings, np.random.default_rng(seed))
        particles.start_within(np.array([33.0, 26.0]), 8.0)
        seen = perceive(trees, pose, 0, rng)
        nearest = seen.select(np.argsort(seen.ranges_m)[:5])
        found.append(error(particles.step(nearest, STILL), pose)[0] < 0.3)
    assert np.mean(found) > 0.93


def test_a_near_place_taken_for_the_true_one_is_left() -> None:
    """Turned by 0.3 rad, one of each pair is where the other should be."""
    bearings = np.array([0.1, 0.4, 1.6, 1.9, -2.0, -1.7])
    ranges_m = np.repeat([5.0, 6.0, 7.0], 2)[:, None]
    pairs = ranges_m * np.column_stack([np.cos(bearings), np.sin(bearings)])
    far = np.random.default_rng(1).uniform(-60.0, 60.0, (60, 2))
    trees = fixed(np.vstack([pairs, far[np.hypot(*far.T) > 20.0]]))
    particles, pose, rng = filter_in(trees), Pose2(), np.random.default_rng(2)
    particles.start_at(UncertainPose2(Pose2(0.0, 0.0, -0.3), np.diag([0.03, 0.03, 0.01]) ** 2))
    standing = UncertainPose2(Pose2(), np.diag([1e-3, 1e-3, 1e-3]) ** 2)
    for k in range(4):
        belief = particles.step(perceive(trees, pose, k, rng), standing)
    assert is_near(belief, pose, 0.1, 0.02)
    assert belief.quality > 0.9
