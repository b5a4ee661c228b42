import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.geometry import Pose2
from semgraph.landmarks import Perceptions
from sensors.simulation.course import CourseOptions, read


def test_each_perception_lies_near_its_tree_and_clutter_is_marked() -> None:
    source = read("paper", CourseOptions(seed=2, clutter=2.0))
    path, trees, rows = source.truth.path, source.truth.landmarks, source.truth.associations
    assert path is not None
    assert path.headings is not None
    assert trees is not None
    assert rows is not None
    num_clutter = 0
    for k, perceptions in enumerate(source.recording.measurements):
        assert isinstance(perceptions, Perceptions)
        pose = Pose2(*path.world_t_reference[k], path.headings[k])
        seen = pose.transform(perceptions.base_t_landmarks())
        of_tree = rows[perceptions.stamp_ns] >= 0
        num_clutter += int((~of_tree).sum())
        offsets = seen[of_tree] - trees.world_t_landmarks[rows[perceptions.stamp_ns][of_tree]]
        assert np.abs(offsets).max(initial=0.0) < 0.5
    assert num_clutter / source.recording.num_scans == pytest.approx(2.0, abs=0.3)


def test_the_seed_decides_and_too_many_trees_are_refused() -> None:
    first, again, other = (read("paper", CourseOptions(seed=seed)) for seed in (1, 1, 2))
    positions = [source.truth.landmarks for source in (first, again, other)]
    assert positions[0] is not None
    assert positions[1] is not None
    assert positions[2] is not None
    np.testing.assert_array_equal(positions[0].world_t_landmarks, positions[1].world_t_landmarks)
    assert not np.array_equal(positions[0].world_t_landmarks, positions[2].world_t_landmarks)
    with pytest.raises(InputError, match="num_trees"):
        read("paper", CourseOptions(num_trees=50_000))
    with pytest.raises(InputError, match="course:paper"):
        read("nowhere", CourseOptions())


def test_missed_and_hidden_trees_are_not_perceived() -> None:
    def mean_count(options: CourseOptions) -> float:
        scans = read("paper", options).recording.measurements
        return float(np.mean([len(scan) for scan in scans if isinstance(scan, Perceptions)]))

    everything = mean_count(CourseOptions(seed=3, missed=0.0))
    half = mean_count(CourseOptions(seed=3, missed=0.5))
    assert half / everything == pytest.approx(0.5, abs=0.05)
