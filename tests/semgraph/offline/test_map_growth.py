"""A given map grown by a run: its errors told from the pose's, new trees added."""

import numpy as np

from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.known_map.fixed_map import FixedMap
from semgraph.localizer import Estimator, Localized
from semgraph.measurement_model import CHI2_3DOF_999
from semgraph.offline.map_changes import Fate
from semgraph.offline.map_growth import Grown, Stretches, grow
from semgraph.settings import TrackerSettings
from tests.semgraph.stands import fixed, measured, perceive, stand

STEP = Pose2(0.3, 0.0, 0.03)
START = Pose2(20.0, 20.0, 0.2)
SIGMA_M = 0.3


def shifted(trees: FixedMap, rng: np.random.Generator) -> FixedMap:
    """The same trees, each somewhat off, by as much as the map says."""
    off = SIGMA_M * rng.standard_normal(trees.map_t_landmarks.shape)
    return fixed(trees.map_t_landmarks + off, sigma_m=SIGMA_M)


def followed(trees: FixedMap, mapped: FixedMap, qualities: list[float]) -> tuple[Grown, Pose2]:
    """A drive, localized to 0.2 m and with these qualities, in a map that errs."""
    rng, pose = np.random.default_rng(0), START
    stretches = Stretches(TrackerSettings())
    for k, quality in enumerate(qualities):
        odometry = measured(STEP, rng) if k else None
        pose = pose @ STEP if k else pose
        seen = perceive(trees, pose, round(2e8 * k), rng)
        off = Pose2(0.2, 0.1, 0.01)
        found = UncertainPose2(pose @ off, np.diag([0.2, 0.2, 0.02]) ** 2)
        localized = Localized(seen.stamp_ns, found, quality, Estimator.FAST, 0)
        stretches.add(seen, odometry, (), localized)
    grown = grow(mapped.landmarks(), stretches.logs(), SmootherSettings(), lambda _: None)
    assert grown is not None
    return grown, pose


def test_many_looks_tell_the_maps_errors_from_the_poses() -> None:
    trees = stand(num_trees=80)
    mapped = shifted(trees, np.random.default_rng(1))
    grown, pose = followed(trees, mapped, [1.0] * 40)
    kept = [each for each in grown.changes if each.fate is Fate.KEPT]
    rows = [int(each.prior) for each in kept]
    places = np.array([each.map_t_landmark for each in kept])
    before = np.linalg.norm(mapped.map_t_landmarks[rows] - trees.map_t_landmarks[rows], axis=1)
    after = np.linalg.norm(places - trees.map_t_landmarks[rows], axis=1)
    assert len(kept) > 15
    assert np.sqrt(np.mean(after**2)) < 0.6 * np.sqrt(np.mean(before**2))
    off = Pose2.from_array(grown.trajectory.map_T_bases[-1]).between(pose).as_array()
    covariance = grown.covariances[-1]
    assert off @ np.linalg.solve(covariance, off) < CHI2_3DOF_999
    # A bound that a single look does not reach: of twenty trees, 0.3 m off each.
    assert np.trace(covariance[:2, :2]) < 2.0 * SIGMA_M**2 / 10.0
    assert len(grown.trajectory) == 40


def test_what_the_map_lacks_is_added_and_the_rest_stays() -> None:
    trees = stand(num_trees=80)
    near = np.argsort(np.linalg.norm(trees.map_t_landmarks - [22.0, 21.0], axis=1))
    left_out = int(near[1])
    kept = np.delete(np.arange(80), left_out)
    mapped = fixed(trees.map_t_landmarks[kept], sigma_m=0.05)
    grown, _ = followed(trees, mapped, [1.0] * 30)
    added = [each for each in grown.changes if each.fate is Fate.ADDED]
    assert len(added) == 1
    off_m = np.linalg.norm(added[0].map_t_landmark - trees.map_t_landmarks[left_out])
    assert off_m < 0.2
    assert len({each.id for each in grown.landmarks}) == len(grown.landmarks)
    unseen = {each.prior for each in grown.changes if each.fate is Fate.NOT_VISITED}
    given = {str(each.id): each for each in mapped.landmarks()}
    for each in grown.landmarks:
        if str(each.id) in unseen:
            np.testing.assert_array_equal(each.map_t_landmark, given[str(each.id)].map_t_landmark)


def test_stretches_end_where_the_robot_is_lost() -> None:
    trees = stand(num_trees=80)
    grown, _ = followed(trees, trees, [1.0] * 15 + [0.1] * 5 + [1.0] * 15)
    assert len(grown.trajectory) == 30


def test_never_held_nothing_grows() -> None:
    assert grow(stand().landmarks(), (), SmootherSettings(), lambda _: None) is None
