import time
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2, relative_poses, wrap_angle
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import WheelOdometry
from sensors.simulation.courses.perceptions import CourseOptions, read
from sensors.simulation.courses.planting import BORDER_M, apart, most_that_fit
from sensors.truth import Source, TrueLandmarks, TruePath

DEFAULT = CourseOptions.model_validate({"lap_s": 12.0, "overlap_s": 2.0})
SPARSE = CourseOptions.model_validate(
    {"lap_s": 12.0, "overlap_s": 2.0, "num_trees": 25, "missed": 0.0}
)


def path_of(source: Source) -> TruePath:
    assert source.truth.path is not None
    return source.truth.path


def trees_of(source: Source) -> TrueLandmarks:
    assert source.truth.landmarks is not None
    return source.truth.landmarks


def scans_of(source: Source) -> list[tuple[Perceptions, Pose2, IntArray]]:
    """Each scan with its true pose and the tree of each perception."""
    path, associations = path_of(source), source.truth.associations
    assert associations is not None
    assert path.headings is not None
    poses = np.column_stack([path.world_t_reference, path.headings])
    scans = [part for part in source.recording.measurements if isinstance(part, Perceptions)]
    return [
        (scan, Pose2.from_array(pose), associations[scan.stamp_ns])
        for scan, pose in zip(scans, poses, strict=True)
    ]


def visible(world_T_base: Pose2, trees: TrueLandmarks, options: CourseOptions) -> set[int]:
    """Rows of the trees in view, one by one: no nearer trunk covers the line to the centre."""
    points = world_T_base.inverse().transform(trees.world_t_landmarks)
    seen = set()
    for k, point in enumerate(points):
        range_m, bearing = np.hypot(*point), np.arctan2(point[1], point[0])
        if range_m >= options.max_range_m or abs(bearing) >= options.field_of_view_rad / 2:
            continue
        ahead = point / range_m
        along = points @ ahead
        aside = np.abs(points @ np.array([-ahead[1], ahead[0]]))
        nearer = (np.hypot(*points.T) < range_m) & (along > 0.0)
        if not (nearer & (aside < 0.5 * trees.diameters_m)).any():
            seen.add(k)
    return seen


def whitened_errors(source: Source) -> FloatArray:
    """(n, 2) perceived minus true range and bearing, in sigmas."""
    trees = trees_of(source).world_t_landmarks
    errors = []
    for scan, world_T_base, rows in scans_of(source):
        real = rows >= 0
        points = world_T_base.inverse().transform(trees[rows[real]])
        differences = np.column_stack(
            [
                scan.ranges_m[real] - np.hypot(*points.T),
                wrap_angle(scan.bearings[real] - np.arctan2(points[:, 1], points[:, 0])),
            ]
        )
        errors.append(differences / np.sqrt(scan.covariances[real][:, [0, 1], [0, 1]]))
    return np.vstack(errors)


def test_the_same_seed_gives_the_same_course_and_another_another() -> None:
    options = DEFAULT.model_copy(update={"odometry": True, "clutter": 1.0})
    one, same = read("course:perceptions", options), read("paper", options)
    other = read("course:perceptions", options.model_copy(update={"seed": 1}))
    first, second = trees_of(one).world_t_landmarks, trees_of(same).world_t_landmarks
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, trees_of(other).world_t_landmarks)
    pairs = zip(one.recording.measurements, same.recording.measurements, strict=True)
    for a, b in pairs:
        assert type(a) is type(b)
        assert a.stamp_ns == b.stamp_ns
        if isinstance(a, Perceptions):
            for name in Perceptions.__slots__[1:]:
                np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        else:
            assert a == b
    for (_, _, rows), (_, _, others) in zip(scans_of(one), scans_of(same), strict=True):
        np.testing.assert_array_equal(rows, others)


def test_the_track_is_a_circle_driven_counter_clockwise_with_an_overlap() -> None:
    source = read("course:perceptions", DEFAULT)
    path = path_of(source)
    assert path.headings is not None
    assert source.recording.num_scans == len(path.stamps_ns) == 141
    radii = np.hypot(*path.world_t_reference.T)
    np.testing.assert_allclose(radii, DEFAULT.track_radius_m)
    poses = np.column_stack([path.world_t_reference, path.headings])
    np.testing.assert_allclose(poses[120:], poses[:21], atol=1e-9)
    steps = relative_poses(poses[:-1], poses[1:])
    np.testing.assert_allclose(steps, np.tile(steps[0], (len(steps), 1)), atol=1e-9)
    assert steps[0, 0] == pytest.approx(2.0 * np.pi * 20.0 / 120.0, rel=1e-3)
    assert steps[0, 2] == pytest.approx(2.0 * np.pi / 120.0)
    assert source.recording.map_T_start == Pose2.from_array(poses[0])


@pytest.mark.parametrize("seed", range(3))
def test_trees_stand_in_the_band_apart_and_off_the_track(seed: int) -> None:
    options = DEFAULT.model_copy(update={"seed": seed, "num_trees": 150})
    trees = trees_of(read("course:perceptions", options))
    radii = np.hypot(*trees.world_t_landmarks.T)
    assert len(radii) == 150
    assert ((radii >= 10.0) & (radii <= 30.0)).all()
    assert (np.abs(radii - 20.0) > 1.5).all()
    apart = np.linalg.norm(trees.world_t_landmarks[:, None] - trees.world_t_landmarks, axis=2)
    assert apart[~np.eye(150, dtype=np.bool_)].min() > 0.8
    assert (trees.kinds == Kind.TREE).all()
    assert ((trees.diameters_m >= 0.08) & (trees.diameters_m <= 0.75)).all()


def test_each_perception_lies_at_its_tree_as_its_covariance_says() -> None:
    errors = whitened_errors(read("course:perceptions", DEFAULT))
    assert len(errors) > 2000
    assert np.abs(errors).max() < 6.0
    np.testing.assert_allclose(errors.mean(axis=0), 0.0, atol=5.0 / np.sqrt(len(errors)))
    np.testing.assert_allclose(np.cov(errors.T), np.eye(2), atol=0.1)


def test_no_tree_is_perceived_twice_in_a_scan() -> None:
    for _, _, rows in scans_of(read("course:perceptions", DEFAULT)):
        assert len(np.unique(rows)) == len(rows)


def test_diameters_are_those_of_the_trees_as_their_sigmas_say() -> None:
    source = read("course:perceptions", DEFAULT)
    true_m = trees_of(source).diameters_m
    ratios = np.concatenate([scan.diameters_m / true_m[rows] for scan, _, rows in scans_of(source)])
    sigmas = np.concatenate(
        [scan.diameter_sigmas_m / scan.diameters_m for scan, _, _ in scans_of(source)]
    )
    assert np.median(ratios) == pytest.approx(1.0, abs=0.02)
    assert np.log(ratios).std() == pytest.approx(np.median(sigmas), rel=0.1)


def test_what_is_perceived_is_what_no_nearer_trunk_hides() -> None:
    options = DEFAULT.model_copy(update={"missed": 0.0, "num_trees": 200})
    source = read("course:perceptions", options)
    trees = trees_of(source)
    num_hidden = 0
    for _, world_T_base, rows in scans_of(source)[::10]:
        expected = visible(world_T_base, trees, options)
        assert set(rows.tolist()) == expected
        points = world_T_base.inverse().transform(trees.world_t_landmarks)
        in_view = (np.hypot(*points.T) < options.max_range_m) & (
            np.abs(np.arctan2(points[:, 1], points[:, 0])) < options.field_of_view_rad / 2
        )
        num_hidden += int(in_view.sum()) - len(expected)
    assert num_hidden > 20


@pytest.mark.parametrize("missed", [0.0, 0.1, 0.6])
def test_the_share_of_missed_trees_is_the_one_asked_for(missed: float) -> None:
    options = SPARSE.model_copy(update={"missed": missed})
    source = read("course:perceptions", options)
    trees = trees_of(source)
    num_visible = sum(len(visible(pose, trees, options)) for _, pose, _ in scans_of(source))
    num_seen = sum(len(rows) for _, _, rows in scans_of(source))
    sigma = np.sqrt(max(missed * (1.0 - missed), 0.0) / num_visible)
    assert 1.0 - num_seen / num_visible == pytest.approx(missed, abs=5.0 * sigma + 1e-12)


@pytest.mark.parametrize("clutter", [0.0, 0.5, 4.0])
def test_the_clutter_of_a_scan_is_the_one_asked_for(clutter: float) -> None:
    options = SPARSE.model_copy(update={"clutter": clutter})
    scans = scans_of(read("course:perceptions", options))
    counts = np.array([(rows == -1).sum() for _, _, rows in scans])
    sigma = np.sqrt(clutter / len(scans))
    assert counts.mean() == pytest.approx(clutter, abs=5.0 * sigma)
    for scan, _, rows in scans:
        false = scan.select(rows == -1)
        assert (false.ranges_m < options.max_range_m + 6.0 * options.range_sigma_m).all()


@pytest.mark.parametrize("num_trees", [0, 1, 2])
@pytest.mark.parametrize("seed", range(5))
def test_a_course_with_hardly_a_tree_is_a_course(num_trees: int, seed: int) -> None:
    options = CourseOptions.model_validate(
        {"seed": seed, "num_trees": num_trees, "lap_s": 2.0, "overlap_s": 0.0}
    )
    source = read("course:perceptions", options)
    assert len(trees_of(source).diameters_m) == num_trees
    assert source.recording.num_scans == 21


@pytest.mark.parametrize(
    "options",
    [
        CourseOptions.model_validate({"num_trees": 3000, "track_radius_m": 10.0, "band_m": 4.0}),
        CourseOptions.model_validate({"num_trees": 1, "band_m": 1.0}),
    ],
)
def test_too_many_trees_are_refused(options: CourseOptions) -> None:
    with pytest.raises(InputError, match="do not fit around the track; take fewer") as caught:
        read("course:perceptions", options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "option",
    [
        {"num_trees": -1},
        {"missed": 1.0},
        {"missed": -0.1},
        {"clutter": -1.0},
        {"track_radius_m": 0.0},
        {"range_sigma_m": 0.0},
        {"scan_rate_hz": float("nan")},
        {"field_of_view_rad": 7.0},
        {"num_rocks": 3},
    ],
)
def test_options_out_of_their_domain_are_refused(option: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        CourseOptions.model_validate(option)


def test_there_are_wheels_only_where_asked_for() -> None:
    recording = read("course:perceptions", DEFAULT).recording
    assert recording.odometry_noise is None
    assert all(isinstance(part, Perceptions) for part in recording.measurements)


def test_wheels_come_before_their_scan_and_err_as_the_vehicle_does() -> None:
    options = DEFAULT.model_copy(update={"odometry": True, "lap_s": 120.0, "num_trees": 5})
    source = read("course:perceptions", options)
    noise = source.recording.odometry_noise
    assert noise is not None
    measurements = list(source.recording.measurements)
    wheels = [part for part in measurements if isinstance(part, WheelOdometry)]
    for wheel, scan in zip(measurements[0::2], measurements[1::2], strict=True):
        assert isinstance(wheel, WheelOdometry)
        assert isinstance(scan, Perceptions)
        assert wheel.stamp_ns == scan.stamp_ns
    true_steps = [one.between(other) for (_, one, _), (_, other, _) in pairwise(scans_of(source))]
    errors = np.array(
        [
            one.odom_T_base.between(other.odom_T_base).as_array() - true.as_array()
            for (one, other), true in zip(pairwise(wheels), true_steps, strict=True)
        ]
    )
    distance_m, turned = 2.0 * np.pi * 20.0 / 1200.0, 2.0 * np.pi / 1200.0
    variances = [
        noise.along_per_sqrt_m**2 * distance_m,
        noise.across_per_sqrt_m**2 * distance_m,
        noise.heading_per_sqrt_m**2 * distance_m + noise.heading_per_sqrt_rad**2 * turned,
    ]
    np.testing.assert_allclose(errors.std(axis=0), np.sqrt(variances), rtol=0.1)


def test_an_orchard_stands_in_rows_of_alike_trees() -> None:
    source = read("course:perceptions", DEFAULT.model_copy(update={"rows": True}))
    true = source.truth.landmarks
    assert true is not None
    for axis, spacing_m in ((0, 4.0), (1, 3.0)):
        first = -(DEFAULT.track_radius_m + DEFAULT.band_m)
        off_m = (true.world_t_landmarks[:, axis] - first + 0.5 * spacing_m) % spacing_m
        assert np.abs(off_m - 0.5 * spacing_m).max() < 0.6
    assert np.std(np.log(true.diameters_m)) < 0.15
    assert np.abs(np.hypot(*true.world_t_landmarks.T) - DEFAULT.track_radius_m).min() > 1.5


def test_far_too_many_trees_are_refused_before_any_is_planted() -> None:
    before = time.process_time()
    with pytest.raises(InputError, match="num_trees"):
        read("course:perceptions", DEFAULT.model_copy(update={"num_trees": 200_000}))
    assert time.process_time() - before < 1.0


def test_no_planting_is_closer_than_what_is_refused_at_once() -> None:
    side, spacing_m = 40, 2.0 * BORDER_M * (1.0 + 1e-9)
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    closest = spacing_m * np.column_stack([(x + 0.5 * (y % 2)).ravel(), 0.5 * 3**0.5 * y.ravel()])
    assert len(apart(closest)) == side**2
    assert most_that_fit(float(np.prod(np.ptp(closest, axis=0) + 2.0 * BORDER_M))) >= side**2
