"""Figures of localization: of a small stand, of runs made by hand, and without recordings."""

from pathlib import Path

import numpy as np
import pytest

from evaluation.benches.bench import measure
from evaluation.benches.bench_localization import calibration, false_alarms, ratio, sections
from evaluation.benches.localization_recordings import tree_map
from evaluation.benches.localization_runs import Run, Trial, try_it
from evaluation.benches.localization_trials import MapErrors, Stand, drive, mapped
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from semgraph.progress import Silence
from tests.semgraph.stands import fixed, perceive


@pytest.fixture
def stems(tmp_path: Path) -> Path:
    """A stand of 150 trees, 80 m by 80 m."""
    rng = np.random.default_rng(0)
    rows = np.column_stack([rng.uniform(0.0, 80.0, (150, 2)), rng.uniform(10.0, 60.0, 150)])
    path = tmp_path / "stems.csv"
    np.savetxt(path, rows, "%.3f", ",", header="x,y,mark", comments="")
    return path


def run_of(errors_m: list[float], qualities: list[float]) -> Run:
    n = len(errors_m)
    return Run(
        np.array(errors_m),
        np.zeros(n),
        np.array(qualities),
        np.ones(n, dtype=bool),
        np.zeros(n),
        np.full(n, 0.1),
        np.zeros(n),
        np.full(n, 5.0),
    )


def test_a_drive_through_a_stand_is_localized(stems: Path) -> None:
    run = try_it(stems, Trial(num_scans=12), 3)
    assert run.is_right[-1]
    assert not run.is_confidently_wrong.any()
    assert run.qualities[-1] > 0.9
    assert np.nanmedian(run.best_m) < 0.2
    near = try_it(stems, Trial(num_scans=3, within_m=10.0), 3)
    assert near.errors_m[-1] < 0.3


def test_maps_have_the_errors_asked_for(stems: Path) -> None:
    stand = Stand.read(stems)
    rng = np.random.default_rng(1)
    made = mapped(stand, MapErrors(sigma_m=0.3, missing=0.2, false=0.1, diameters=False), rng)
    kept = made.rows >= 0
    assert 0.7 < kept.mean() < 0.9
    assert len(made.fixed_map) == kept.sum() + 15
    off = made.fixed_map.map_t_landmarks[made.rows[kept]] - stand.world_t_stems[kept]
    assert 0.25 < off.std() < 0.35
    assert np.isnan(made.fixed_map.diameters_m).all()


def test_drives_stay_inside_and_leap_as_told(stems: Path) -> None:
    stand = Stand.read(stems)
    moments = drive(stand, 60, np.random.default_rng(2), largest_step=(5.0, 1.0))
    places = np.array([moment.world_T_base.as_array()[:2] for moment in moments])
    assert (places > 0.0).all()
    assert (places < 80.0).all()
    steps = np.hypot(*np.diff(places, axis=0).T)
    assert (np.delete(steps, np.arange(8, 59, 10)) < 0.21).all()
    assert steps[8::10].max() > 1.0
    assert all(moment.odometry is None for moment in moments)
    carried = drive(stand, 10, np.random.default_rng(2), carried_off_at=(5,))
    told = carried[5].odometry
    assert told is not None
    assert abs(told.pose.x) < 0.02


def test_calibration_is_the_worst_bin_with_enough_poses() -> None:
    honest = run_of([0.1] * 90 + [5.0] * 10, [0.9] * 100)
    assert calibration([honest]).value == pytest.approx(0.0, abs=1e-9)
    boasting = run_of([0.1] * 50 + [5.0] * 50, [0.9] * 100)
    assert calibration([boasting]).value == pytest.approx(0.4)
    few = run_of([5.0] * 10 + [0.1] * 100, [0.5] * 10 + [1.0] * 100)
    assert calibration([few]).value == pytest.approx(0.0)


def test_alarms_count_where_nothing_is_wrong() -> None:
    assert false_alarms(run_of([0.1, 0.1, 0.1, 0.1], [1.0, 0.3, 0.9, 0.2])) == 2
    assert false_alarms(run_of([0.1, 30.0, 30.0], [1.0, 0.9, 0.1])) == 0
    assert false_alarms(run_of([0.1] * 102, [1.0] * 100 + [0.4, 1.0])) == 0


def test_the_ratio_is_of_found_poses() -> None:
    assert ratio([run_of([0.2, 0.2, 9.0, 0.2], [1.0, 1.0, 1.0, 0.1])]) == pytest.approx(2.0)


def test_trees_seen_from_known_poses_become_a_map() -> None:
    trees = fixed(np.array([[5.0, 0.0], [0.0, 6.0], [-4.0, -3.0]]), np.array([0.2, 0.3, 0.4]))
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-1.0, 1.0, (6, 2)), rng.uniform(-3.0, 3.0, 6)])
    seen = [perceive(trees, Pose2.from_array(pose), k, rng) for k, pose in enumerate(poses)]
    made = tree_map(seen, poses)
    assert len(made) == 3
    order = np.argsort(made.diameters_m)
    np.testing.assert_allclose(made.map_t_landmarks[order], trees.map_t_landmarks, atol=0.06)
    np.testing.assert_allclose(made.diameters_m[order], [0.2, 0.3, 0.4], rtol=0.15)


def test_without_recordings_all_is_left_out_with_the_reason() -> None:
    chosen = sections(None)
    assert len({section.name for section in chosen}) == len(chosen)
    for measured in measure(chosen, range(1), Silence()):
        assert measured.rows == ()
        assert "expected --data DIR with" in measured.left_out


def test_a_stem_map_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none"):
        try_it(tmp_path / "none.csv", Trial(), 0)
