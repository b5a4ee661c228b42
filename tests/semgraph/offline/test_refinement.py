"""Refinement on a small course: wrong associations, prior maps, two sessions."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from evaluation.benches.bench_runs import known, run_course
from semgraph import results
from semgraph.arrays import FloatArray, IntArray
from semgraph.cli import main
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.files.run_log import RunLog
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.landmarks import Kind
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.map_changes import Change, Fate
from semgraph.offline.prior_map import PriorMap, read_prior_map
from semgraph.offline.refinement import Refined, refine, refined
from semgraph.offline.refining import Refinement, refine_sessions
from semgraph.results import RunResult
from tests.semgraph.logs import log

SETTINGS = SmootherSettings()
SHORT: dict[str, object] = {
    "seed": 4,
    "track_radius_m": 10.0,
    "num_trees": 40,
    "lap_s": 20.0,
    "overlap_s": 3.0,
    "scan_rate_hz": 5.0,
}
SIGMA_M = 0.1


@dataclass(frozen=True)
class Course:
    """A run, what it measured, and where its trees are in the map."""

    result: RunResult
    log: RunLog
    map_t_trees: FloatArray
    diameters_m: FloatArray
    truly: IntArray


@cache
def course() -> Course:
    source, result = run_course("course:perceptions", **SHORT)
    path, truly = known(source.truth.path), known(source.truth.associations)
    x, y = path.world_t_reference[0].tolist()
    world_T_base = Pose2(x, y, float(known(path.headings)[0]))
    map_T_world = source.recording.map_T_start @ world_T_base.inverse()
    trees = known(source.truth.landmarks)
    rows = [truly[stamp_ns] for stamp_ns in result.smoothed.stamps_ns.tolist()]
    return Course(
        result,
        known(result.log),
        map_T_world.transform(trees.world_t_landmarks),
        trees.diameters_m,
        np.concatenate(rows),
    )


def silent(_: str) -> None:
    """Nobody listens."""


def refined_from(landmarks: IntArray) -> Refined:
    measured = course().log
    batch = Batch.of(measured)
    belief, rounds = refine(
        batch, Belief(measured.trajectory.map_T_bases, landmarks, {}), SETTINGS, silent
    )
    return refined(batch, belief, SETTINGS, rounds)


def errors_m(result: Refined) -> FloatArray:
    """(n,) how far each landmark is from the nearest tree."""
    places = np.array([each.map_t_landmark for each in result.landmarks])
    apart = np.linalg.norm(places[:, None] - course().map_t_trees[None], axis=2)
    nearest: FloatArray = apart.min(axis=1)
    return nearest


def num_wrong(result: Refined) -> int:
    """Perceptions that are not of the tree which most of their landmark's are of."""
    truly, taken_for = course().truly, result.belief.landmarks
    wrong = 0
    for landmark in np.unique(taken_for[taken_for >= 0]).tolist():
        counts = np.unique(truly[taken_for == landmark], return_counts=True)[1]
        wrong += int(counts.sum() - counts.max())
    return wrong


def test_a_good_run_stays_and_settles() -> None:
    result = refined_from(course().log.landmarks)
    assert result.is_settled
    assert len(result.landmarks) == 40
    assert errors_m(result).max() < 0.15
    assert num_wrong(result) == 0
    assert result.pose_covariances.shape == (len(course().log.trajectory), 3, 3)
    again = refined_from(result.belief.landmarks)
    assert again.changes == (0,)
    assert again.cost == pytest.approx(result.cost, rel=1e-4)


def test_wrong_associations_are_put_right() -> None:
    """Some swapped, one tree in two, two trees in one."""
    rng = np.random.default_rng(3)
    landmarks = np.array(course().log.landmarks)
    swapped = rng.choice(np.flatnonzero(landmarks >= 0), len(landmarks) // 20, replace=False)
    landmarks[swapped] = rng.permutation(landmarks[swapped])
    ids, counts = np.unique(landmarks[landmarks >= 0], return_counts=True)
    torn, one, other = ids[np.argsort(-counts)[:3]].tolist()
    halves = np.flatnonzero(landmarks == torn)
    landmarks[halves[len(halves) // 2 :]] = ids.max() + 1
    landmarks[landmarks == other] = one
    result = refined_from(landmarks)
    assert result.is_settled
    assert len(result.landmarks) == 40
    assert errors_m(result).max() < 0.15
    assert num_wrong(result) <= 2


def prior_map(places: FloatArray, sigma_m: float = SIGMA_M) -> PriorMap:
    k = len(places)
    return PriorMap(
        tuple(str(number) for number in range(k)),
        np.full(k, Kind.TREE),
        places,
        np.broadcast_to(sigma_m**2 * np.eye(2), (k, 2, 2)),
        np.full(k, np.nan),
        np.full(k, np.nan),
        ("",) * k,
    )


def noisy_trees() -> FloatArray:
    trees = course().map_t_trees
    noise = np.random.default_rng(9).normal(0.0, SIGMA_M, trees.shape)
    return np.asarray(trees + np.clip(noise, -2.0 * SIGMA_M, 2.0 * SIGMA_M))


def against(places: FloatArray, start: Pose2 | None = None, sigma_m: float = SIGMA_M) -> Refinement:
    prior = prior_map(places, sigma_m)
    return refine_sessions([("one", course().log)], SETTINGS, prior, start, silent)


def of(changes: tuple[Change, ...] | None, fate: Fate) -> list[Change]:
    return [change for change in known(changes) if change.fate is fate]


def test_one_false_and_one_missing_are_named() -> None:
    trees = noisy_trees()
    # Beside the way, where no tree is near.
    false = free_place()
    result = against(np.vstack([trees[1:], false]))
    (gone,), (added,) = of(result.changes, Fate.GONE), of(result.changes, Fate.ADDED)
    assert gone.prior == "39"
    assert gone.looks > 5
    assert gone.log_odds < -3.0
    np.testing.assert_allclose(added.map_t_landmark, course().map_t_trees[0], atol=0.3)
    kept = of(result.changes, Fate.KEPT)
    assert len(kept) == 39
    assert max(change.moved_m for change in kept) < 0.5
    assert 0.5 < np.mean([change.significance for change in kept]) < 4.0
    assert len(known(result.changes)) == 41


def free_place() -> FloatArray:
    """A place within 4 m of the way and 2.5 m from all trees."""
    poses = course().log.trajectory.map_T_bases[::5]
    for pose in poses:
        place = Pose2.from_array(pose).transform(np.array([[3.0, 1.5]]))
        apart = np.linalg.norm(course().map_t_trees - place, axis=1)
        if apart.min() > 2.5:
            return place
    raise AssertionError("no free place")


def test_what_was_moved_is_told_with_how_far() -> None:
    trees = course().map_t_trees.copy()
    trees[5] += (0.4, 0.3)
    result = against(trees, sigma_m=0.03)
    (moved,) = of(result.changes, Fate.MOVED)
    assert moved.prior == "5"
    assert moved.moved_m == pytest.approx(0.5, abs=0.1)
    assert moved.significance > 50.0
    assert len(of(result.changes, Fate.KEPT)) == 39


def test_what_nobody_came_by_is_not_visited() -> None:
    far = np.array([[200.0, 200.0]])
    result = against(np.vstack([noisy_trees(), far]))
    (away,) = of(result.changes, Fate.NOT_VISITED)
    assert (away.prior, away.looks) == ("40", 0)
    assert not of(result.changes, Fate.GONE)


def test_a_run_that_sighted_nothing_says_nothing() -> None:
    blind = log(2, sighted_from=())
    result = refine_sessions([("blind", blind)], SETTINGS, prior_map(noisy_trees()), None, silent)
    assert not result.refined.landmarks
    assert len(of(result.changes, Fate.NOT_VISITED)) == 40


def test_a_map_in_another_frame_needs_the_start() -> None:
    prior_T_map = Pose2(30.0, -20.0, 2.0)
    start = prior_T_map @ course().log.start.pose
    near = start @ Pose2(0.5, -0.4, 0.03)
    result = against(prior_T_map.transform(noisy_trees()), near)
    assert len(of(result.changes, Fate.KEPT)) == 40
    places = np.array([each.map_t_landmark for each in result.refined.landmarks])
    trees = prior_T_map.transform(course().map_t_trees)
    apart_m = np.linalg.norm(places[:, None] - trees[None], axis=2).min(axis=1)
    assert apart_m.max() < 0.2


def shifted(log: RunLog, by: Pose2) -> RunLog:
    """The same, as if it had been started elsewhere."""
    poses = [(by @ Pose2.from_array(pose)).as_array() for pose in log.trajectory.map_T_bases]
    return replace(
        log,
        trajectory=Trajectory(log.trajectory.stamps_ns, np.array(poses)),
        start=UncertainPose2(by @ log.start.pose, log.start.covariance),
    )


def test_two_sessions_give_one_map() -> None:
    measured = course().log
    alone = refine_sessions([("one", measured)], SETTINGS, None, None, silent)
    other = shifted(measured, Pose2(0.4, -0.3, 0.02))
    both = refine_sessions([("one", measured), ("two", other)], SETTINGS, None, None, silent)
    assert both.changes is None
    assert len(both.refined.landmarks) == 40
    assert [len(each) for each in both.trajectories] == [len(measured.trajectory)] * 2
    np.testing.assert_allclose(
        both.trajectories[1].map_T_bases, both.trajectories[0].map_T_bases, atol=0.01
    )
    one, two = (
        np.linalg.det([each.covariance for each in result.refined.landmarks])
        for result in (alone, both)
    )
    # Where the first session started stays as uncertain relative to the map as it was.
    assert (two < one).all()


def test_sessions_of_two_places_are_refused() -> None:
    measured = course().log
    with pytest.raises(InputError, match="session 2: expected 2 landmarks or more"):
        refine_sessions(
            [("one", measured), ("two", shifted(measured, Pose2(500.0, 0.0, 0.0)))],
            SETTINGS,
            None,
            None,
            silent,
        )


def test_the_command_writes_map_paths_report_and_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results.write(course().result, tmp_path / "run")
    (tmp_path / "run" / "truth.json").write_text("{}")
    trees = np.column_stack([noisy_trees(), course().diameters_m])
    rows = [",".join(map(str, tree)) for tree in trees.tolist()]
    (tmp_path / "stems.csv").write_text("\n".join(["x,y,diameter", *rows]) + "\n")
    folder = tmp_path / "refined"
    arguments = ["refine", str(tmp_path / "run"), "--map", str(tmp_path / "stems.csv")]
    status = main([*arguments, "--map-sigma", "0.1", "--output", str(folder)])
    printed = capsys.readouterr()
    assert status == 0, printed.err
    assert "40 kept, 0 moved, 0 gone" in printed.out
    names = {"map.json", "map.csv", "trajectory.tum", "trajectory_covariance.csv"}
    names |= {"report.csv", "report.txt", "refined.json", "refined.png"}
    assert {file.name for file in folder.iterdir()} == names
    lines = (folder / "report.csv").read_text().splitlines()
    assert len(lines) == 41
    assert lines[0].startswith("fate,kind,prior,landmark,x_m,y_m")


def test_a_run_without_a_log_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results.write(replace(course().result, log=None), tmp_path / "run")
    assert main(["refine", str(tmp_path / "run"), "--output", str(tmp_path / "out")]) == 1
    assert "expected log.npz" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_prior_maps_are_read_from_runs_and_lists(tmp_path: Path) -> None:
    results.write(course().result, tmp_path / "run")
    one, other = (read_prior_map(tmp_path / "run" / name, 1.0) for name in ("map.json", "map.csv"))
    np.testing.assert_array_equal(one.map_t_landmarks, other.map_t_landmarks)
    np.testing.assert_allclose(one.covariances, other.covariances, rtol=1e-9)
    assert one.names == other.names == read_prior_map(tmp_path / "run", 1.0).names
    file = tmp_path / "stems.csv"
    file.write_text("x,y\n1,2\n3,4\n")
    listed = read_prior_map(file, 0.2)
    np.testing.assert_array_equal(listed.map_t_landmarks, [[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_allclose(listed.covariances[1], 0.04 * np.eye(2))


@pytest.mark.parametrize(
    "text", ["", "x,y\n", "x,y\n1\n", "x,y\n1,nan\n", "a,b\n1,2\n", "x,y,diameter\n1,2,-1\n"]
)
def test_what_is_no_map_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "stems.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=r"stems\.csv"):
        read_prior_map(file, 0.2)
