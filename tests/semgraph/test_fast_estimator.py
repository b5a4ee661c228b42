import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError

from semgraph.alignment import Alignment
from semgraph.estimates import NoEstimate, NoEstimateReason
from semgraph.fast_estimator import FastSettings, Rules
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, concatenate
from sensors.simulation.courses.perceptions import CourseOptions, read
from sensors.truth import Source
from tests.semgraph.circles import (
    BEST,
    BOTH_RULES,
    PAPER,
    START,
    arc,
    errors,
    exact_wheels,
    followed,
    seen,
    stand,
)


def course(seed: int) -> Source:
    return read("course:perceptions", CourseOptions.model_validate({"seed": seed, "num_trees": 80}))


def course_scans(source: Source) -> list[Perceptions]:
    return [part for part in source.recording.measurements if isinstance(part, Perceptions)]


@BOTH_RULES
def test_exact_perceptions_and_wheels_are_followed_exactly(settings: FastSettings) -> None:
    poses, trees = arc(150), stand()
    scans = [seen(k, pose, trees) for k, pose in enumerate(poses)]
    steps, estimator = followed(settings, scans, exact_wheels(poses))
    np.testing.assert_allclose(errors(steps, poses), 0.0, atol=1e-7)
    assert all(isinstance(step.closed_form, Alignment) for step in steps[1:])
    assert [step.stamp_ns for step in steps] == [scan.stamp_ns for scan in scans]
    for landmark in estimator.navigation_map:
        assert np.hypot(*(trees - landmark.map_t_landmark).T).min() < 1e-7


def test_the_closed_form_alone_follows_exact_perceptions_exactly() -> None:
    """The paper's rules take nothing from the motion model once two landmarks match."""
    poses, trees = arc(150), stand(1)
    steps, _ = followed(PAPER, [seen(k, pose, trees) for k, pose in enumerate(poses)])
    np.testing.assert_allclose(errors(steps, poses), 0.0, atol=1e-7)


@BOTH_RULES
@pytest.mark.parametrize("world_T_map", [Pose2(137.0, -64.0, 2.3), Pose2(-3.0, 8.0, -0.7)])
def test_moving_the_world_moves_the_estimate(settings: FastSettings, world_T_map: Pose2) -> None:
    source = course(3)
    scans, start = course_scans(source)[:120], source.recording.map_T_start
    here, map_here = followed(settings, scans, start=start)
    there, map_there = followed(settings, scans, start=world_T_map @ start)
    moved = [world_T_map @ step.map_T_base.pose for step in here]
    np.testing.assert_allclose(errors(there, moved), 0.0, atol=1e-7)
    for one, other in zip(here, there, strict=True):
        np.testing.assert_array_equal(one.landmark_ids, other.landmark_ids)
        np.testing.assert_allclose(
            one.map_T_base.covariance, other.map_T_base.covariance, atol=1e-9
        )
    ids = np.arange(len(map_here.navigation_map))
    np.testing.assert_allclose(
        map_there.navigation_map.positions(ids),
        world_T_map.transform(map_here.navigation_map.positions(ids)),
        atol=1e-7,
    )


@BOTH_RULES
def test_the_order_of_perceptions_changes_nothing(settings: FastSettings) -> None:
    source = course(4)
    scans, rng = course_scans(source)[:120], np.random.default_rng(0)
    orders = [rng.permutation(len(scan)) for scan in scans]
    shuffled = [scan.select(order) for scan, order in zip(scans, orders, strict=True)]
    start = source.recording.map_T_start
    one, other = (followed(settings, some, start=start)[0] for some in (scans, shuffled))
    np.testing.assert_allclose(
        errors(other, [step.map_T_base.pose for step in one]), 0.0, atol=1e-7
    )


@pytest.mark.parametrize("seed", range(2))
def test_the_map_of_a_course_has_every_tree_once(seed: int) -> None:
    source = course(seed)
    assert source.truth.associations is not None
    assert source.truth.path is not None
    scans = course_scans(source)
    steps, estimator = followed(BEST, scans, start=source.recording.map_T_start)
    pairs = {
        (landmark_id, tree)
        for step in steps
        for landmark_id, tree in zip(
            step.landmark_ids.tolist(),
            source.truth.associations[step.stamp_ns].tolist(),
            strict=True,
        )
        if landmark_id >= 0
    }
    ids, trees = (sorted(pair[k] for pair in pairs) for k in (0, 1))
    assert ids == list(range(len(estimator.navigation_map)))
    assert len(set(trees)) == len(trees)
    last = steps[-1].map_T_base.pose
    assert np.hypot(*(source.truth.path.world_t_reference[-1] - (last.x, last.y))) < 0.1


@pytest.mark.parametrize("seed", range(2))
def test_the_paper_rules_close_the_loop_of_a_course(seed: int) -> None:
    source = course(seed)
    assert source.truth.path is not None
    steps, _ = followed(PAPER, course_scans(source), start=source.recording.map_T_start)
    positions = np.array([step.map_T_base.pose.as_array()[:2] for step in steps])
    off = np.hypot(*(positions - source.truth.path.world_t_reference).T)
    assert off.max() < 0.6
    assert off[-1] < 0.1


@BOTH_RULES
def test_empty_scans_are_survived_by_the_motion_model(settings: FastSettings) -> None:
    poses, trees = arc(80), stand()
    scans = [seen(k, pose, trees) for k, pose in enumerate(poses)]
    for k in range(40, 45):
        scans[k] = scans[k].select(np.zeros(0, dtype=np.int64))
    steps, estimator = followed(settings, scans)
    for k in range(40, 45):
        assert steps[k].closed_form == NoEstimate(NoEstimateReason.NO_PERCEPTIONS)
        assert len(steps[k].landmark_ids) == 0
    variances = [float(steps[k].map_T_base.covariance[0, 0]) for k in range(39, 45)]
    assert variances == sorted(variances)
    assert np.abs(errors(steps, poses)).max() < 0.1
    assert isinstance(steps[45].closed_form, Alignment)
    assert (estimator.navigation_map.num_sightings(np.arange(5)) > 1).all()


@BOTH_RULES
@pytest.mark.parametrize(
    ("num_kept", "reason"),
    [(0, NoEstimateReason.NO_PERCEPTIONS), (1, NoEstimateReason.TOO_FEW_MATCHES)],
)
def test_too_little_in_sight_is_told_and_the_motion_carries_on(
    settings: FastSettings, num_kept: int, reason: NoEstimateReason
) -> None:
    poses, trees = arc(60), stand()
    scans = [seen(k, pose, trees) for k, pose in enumerate(poses)]
    scans[30] = scans[30].select(np.arange(num_kept))
    steps, _ = followed(settings, scans, exact_wheels(poses))
    assert steps[30].closed_form == NoEstimate(reason)
    np.testing.assert_allclose(errors(steps, poses), 0.0, atol=1e-7)


def test_landmarks_too_close_together_give_no_heading() -> None:
    close = np.array([[6.0, 0.0], [6.0, 1.02]])
    settings = FastSettings.model_validate({"map_sigma_m": 1.5})
    scans = [seen(k, Pose2(), close) for k in range(2)]
    steps, _ = followed(settings, scans, start=Pose2())
    assert steps[1].closed_form == NoEstimate(NoEstimateReason.DEGENERATE_GEOMETRY)
    np.testing.assert_array_equal(steps[1].landmark_ids, [0, 1])


@BOTH_RULES
def test_a_run_without_any_perception_stays_at_the_start(settings: FastSettings) -> None:
    scans = [seen(k, START, np.zeros((0, 2))) for k in range(20)]
    steps, estimator = followed(settings, scans)
    assert len(estimator.navigation_map) == 0
    np.testing.assert_allclose(errors(steps, [START] * 20), 0.0, atol=1e-12)


def test_a_match_that_contradicts_all_others_is_left_out() -> None:
    poses, trees = arc(30), stand()
    scans = [seen(k, pose, trees) for k, pose in enumerate(poses)]
    ranges_m = scans[29].ranges_m.copy()
    ranges_m[4] += 0.4
    scans[29] = Perceptions.from_arrays(
        scans[29].stamp_ns, Kind.TREE, ranges_m, scans[29].bearings, scans[29].covariances
    )
    steps, _ = followed(BEST, scans, exact_wheels(poses))
    np.testing.assert_allclose(errors(steps, poses), 0.0, atol=1e-7)
    assert steps[29].landmark_ids[4] == -1
    assert (np.delete(steps[29].landmark_ids, 4) >= 0).all()


def test_a_trunk_that_is_thicker_from_the_other_side_is_the_same() -> None:
    """Within what two perceptions may differ; not if a mean of many were surer than one."""
    poses, trees = arc(60), stand()
    scans = []
    for k, pose in enumerate(poses):
        scan = seen(k, pose, trees)
        diameters_m = np.full(len(scan), 0.30 if k < 30 else 0.42)
        scans.append(
            replace(scan, diameters_m=diameters_m, diameter_sigmas_m=np.full(len(scan), 0.03))
        )
    steps, estimator = followed(BEST, scans, exact_wheels(poses))
    assert all((step.landmark_ids >= 0).all() for step in steps)
    assert len(estimator.navigation_map) == len(
        np.unique(np.concatenate([step.landmark_ids for step in steps]))
    )
    places = estimator.navigation_map.positions(np.arange(len(estimator.navigation_map)))
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    assert apart[apart > 0.0].min() > 1.0


def with_diameters(scan: Perceptions, diameter_m: float) -> Perceptions:
    count = len(scan)
    return replace(
        scan, diameters_m=np.full(count, diameter_m), diameter_sigmas_m=np.full(count, 0.01)
    )


@pytest.mark.parametrize(("diameter_m", "num_more"), [(0.05, 1), (0.5, 0)])
def test_what_shows_beside_a_matched_trunk_is_another_one_if_it_has_room(
    diameter_m: float, num_more: int
) -> None:
    """Hidden in the first scans, and nearer than the insert radius; not what lies inside it."""
    poses, trees = arc(40), stand()
    twin = trees[np.argmin(np.hypot(*(trees - START.as_array()[:2]).T))] + (0.3, 0.0)
    both = np.concatenate([trees, [twin]])
    scans = [seen(k, pose, trees if k < 5 else both) for k, pose in enumerate(poses)]
    scans = [with_diameters(scan, diameter_m) for scan in scans]
    _, alone = followed(BEST, [seen(k, pose, trees) for k, pose in enumerate(poses)])
    _, estimator = followed(BEST, scans, exact_wheels(poses))
    assert len(list(estimator.navigation_map)) == len(list(alone.navigation_map)) + num_more
    near = [
        landmark.map_t_landmark
        for landmark in estimator.navigation_map
        if np.hypot(*(landmark.map_t_landmark - twin)) < 0.4
    ]
    assert len(near) == 1 + num_more


def test_memory_forgets_what_was_not_sighted_for_its_distance() -> None:
    """A full turn of 75 m: with a memory of 30 m the first trees are new ones the second time."""
    poses, trees = arc(340), stand()
    scans = [seen(k, pose, trees) for k, pose in enumerate(poses)]
    wheels = exact_wheels(poses)
    forever, whole = followed(BEST, scans, wheels)
    short = FastSettings.model_validate({"memory_m": 30.0})
    forgetful, double = followed(short, scans, wheels)
    assert len(whole.navigation_map) < len(double.navigation_map)
    assert set(forever[0].landmark_ids.tolist()) & set(forever[-1].landmark_ids.tolist())
    far = np.hypot(*(scans[0].base_t_landmarks() - (0.0, 12.0)).T) > 15.0
    outside = set(forgetful[0].landmark_ids[far].tolist())
    assert outside
    assert not outside & {i for step in forgetful[300:] for i in step.landmark_ids.tolist()}
    for steps in (forever, forgetful):
        np.testing.assert_allclose(errors(steps, poses), 0.0, atol=1e-7)


def seconds_apart(num_scans: int) -> tuple[list[Pose2], list[Perceptions]]:
    """3 s between scans: without wheels nobody knows by the metre where the next one is from."""
    poses, trees = arc(num_scans, turn=0.08), stand()
    return poses, [seen(30 * k, pose, trees, 20.0) for k, pose in enumerate(poses)]


def test_a_scan_that_fits_nowhere_is_where_the_map_begins_anew() -> None:
    """And does not unsettle those after it."""
    poses, scans = seconds_apart(20)
    elsewhere = seen(0, Pose2(90.0, 40.0, 2.0), stand(9) + np.array([90.0, 40.0]), 20.0)
    scans[6] = replace(elsewhere, stamp_ns=scans[6].stamp_ns)
    short = FastSettings.model_validate({"memory_m": 20.0})
    steps, _ = followed(short, scans)
    assert not set(steps[6].landmark_ids.tolist()) & set(steps[5].landmark_ids.tolist())
    for (before, after), (a, b) in zip(pairwise(steps[7:]), pairwise(poses[7:]), strict=True):
        moved = before.map_T_base.pose.between(after.map_T_base.pose)
        np.testing.assert_allclose(moved.as_array(), a.between(b).as_array(), atol=1e-6)
        known = np.isin(after.landmark_ids, before.landmark_ids)
        assert known.mean() > 0.5


def test_a_scan_of_which_less_than_half_is_known_is_placed_after_a_long_stop() -> None:
    """It stood for 40 s and turned; every second tree is hidden, and as many are new."""
    poses, scans = seconds_apart(20)
    turned, rng = poses[-1] @ Pose2(1.0, 0.5, 0.7), np.random.default_rng(1)
    again = seen(0, turned, stand(), 20.0)
    again = again.select(np.arange(0, len(again), 2))
    others = seen(0, turned, turned.transform(rng.uniform(-20.0, 20.0, (200, 2))), 20.0)
    new = others.select(np.arange(len(again) + 1))
    scans.append(concatenate(scans[-1].stamp_ns + 40_000_000_000, [again, new]))
    short = FastSettings.model_validate({"memory_m": 20.0})
    steps, _ = followed(short, scans)
    error = turned.between(steps[-1].map_T_base.pose).as_array()
    np.testing.assert_allclose(error, 0.0, atol=0.05)


def hidden_but(num_trees: int) -> tuple[list[Pose2], list[Perceptions]]:
    """Scan 20 shows the nearest trees only."""
    poses, scans = seconds_apart(30)
    nearest = np.sort(np.argsort(scans[20].ranges_m)[:num_trees])
    scans[20] = scans[20].select(nearest)
    return poses, scans


def test_where_too_little_is_seen_to_find_a_place_it_goes_on_as_usual() -> None:
    """Three trees place no scan; by how evenly it moved they are taken for what they are."""
    poses, scans = hidden_but(3)
    short = FastSettings.model_validate({"memory_m": 20.0})
    steps, _ = followed(short, scans)
    np.testing.assert_allclose(errors(steps, poses), 0.0, atol=1e-6)
    known = {i for step in steps[:20] for i in step.landmark_ids.tolist()}
    assert known.issuperset(steps[20].landmark_ids.tolist())
    assert steps[20].motion.covariance[0, 0] < 1.0 < steps[19].motion.covariance[0, 0]


def test_two_trees_as_far_apart_as_two_others_say_not_where_it_is() -> None:
    """Who moves evenly by a metre finds two such trees somewhere; the map begins anew."""
    poses, scans = hidden_but(2)
    short = FastSettings.model_validate({"memory_m": 20.0})
    steps, _ = followed(short, scans)
    known = {i for step in steps[:20] for i in step.landmark_ids.tolist()}
    assert known.isdisjoint(steps[20].landmark_ids.tolist())
    assert 0.5 < steps[20].motion.covariance[0, 0] < 1.0
    for (before, after), (a, b) in zip(pairwise(steps[22:]), pairwise(poses[22:]), strict=True):
        moved = before.map_T_base.pose.between(after.map_T_base.pose)
        np.testing.assert_allclose(moved.as_array(), a.between(b).as_array(), atol=1e-6)


def test_a_scan_that_shows_nothing_lets_nothing_be_forgotten() -> None:
    poses, scans = hidden_but(0)
    short = FastSettings.model_validate({"memory_m": 20.0})
    steps, _ = followed(short, scans)
    known = {i for step in steps[:20] for i in step.landmark_ids.tolist()}
    assert len(scans[20]) == 0
    assert np.isin(steps[21].landmark_ids, list(known)).mean() > 0.5
    np.testing.assert_allclose(errors(steps[21:], poses[21:]), 0.0, atol=1e-6)


def test_who_was_blind_for_long_matches_nothing_by_chance() -> None:
    """It stopped when it went blind; each step by itself is sure enough, all together are not."""
    driven, trees = arc(21, turn=0.08), stand()
    poses = [*driven, *[driven[-1]] * 30]
    scans = [
        replace(seen(0, pose, trees, 20.0), stamp_ns=250_000_000 * k)
        for k, pose in enumerate(poses)
    ]
    for k in range(21, 45):
        scans[k] = scans[k].select(np.zeros(len(scans[k]), dtype=np.bool_))
    short = FastSettings.model_validate({"memory_m": 20.0})
    steps, _ = followed(short, scans)
    known = {i for step in steps[:21] for i in step.landmark_ids.tolist()}
    assert known.isdisjoint(steps[45].landmark_ids.tolist())
    assert (steps[46].landmark_ids == steps[45].landmark_ids).all()


def test_one_tree_with_a_name_is_what_it_is() -> None:
    poses, scans = hidden_but(1)
    names = {i: f"tree {i}" for i in range(len(stand()))}
    named = []
    for scan, pose in zip(scans, poses, strict=True):
        places = pose.transform(scan.base_t_landmarks())
        which = np.hypot(*(places[:, None] - stand()[None]).transpose(2, 0, 1)).argmin(axis=1)
        named.append(replace(scan, identities=np.array([names[i] for i in which.tolist()])))
    short = FastSettings.model_validate({"memory_m": 20.0})
    steps, _ = followed(short, named)
    known = {i for step in steps[:20] for i in step.landmark_ids.tolist()}
    assert len(scans[20]) == 1
    assert known.issuperset(steps[20].landmark_ids.tolist())
    # The map has not begun anew, at a pose that is known by definition.
    assert steps[20].map_T_base.covariance[0, 0] > 0.01**2


@pytest.mark.parametrize(
    "setting",
    [
        {"search_radius_m": 0.0},
        {"search_radius_m": float("nan")},
        {"insert_radius_m": -1.0},
        {"memory_m": 0.0},
        {"sweep_max_rad": 4.0},
        {"rules": "worst"},
        {"search_radius": 1.0},
    ],
)
def test_settings_out_of_their_domain_are_refused(setting: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        FastSettings.model_validate(setting)


def test_the_defaults_are_the_best_rules_without_forgetting() -> None:
    settings = FastSettings.model_validate({})
    assert settings.rules is Rules.BEST
    assert math.isinf(settings.memory_m)


@pytest.mark.parametrize("off_m", [0.05, 0.3])
def test_a_map_begins_anew_also_where_the_robot_has_not_moved(off_m: float) -> None:
    """Three trees place no scan, and after 30 s nobody knows where it is."""
    trees = np.array([[5.0, 0.0], [4.0, 3.0], [2.0, -4.0]])
    after = trees + off_m * np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    scans = [
        replace(seen(0, Pose2(), places, 20.0), stamp_ns=30_000_000_000 * k)
        for k, places in enumerate((trees, after))
    ]
    steps, _ = followed(FastSettings.model_validate({"memory_m": 20.0}), scans)
    assert set(steps[1].landmark_ids.tolist()) == {3, 4, 5}
