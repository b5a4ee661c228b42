"""semgraph localize as a user types it, and the files that it leaves."""

import csv
from pathlib import Path

import numpy as np
import pytest

from semgraph.cli import main
from semgraph.geometry import Pose2
from semgraph.landmarks import Landmark, Tree
from semgraph.localization import QUALITY_COLUMNS, localize
from semgraph.localizer import start_of
from semgraph.perceiving import Perceiver
from semgraph.progress import Silence
from semgraph.results import read
from semgraph.settings import load_settings
from sensors.measurements import Recording
from tests.semgraph.stands import perceive, stand

COURSE = (
    *("--set", "seed=3", "--set", "track_radius_m=10", "--set", "num_trees=40"),
    *("--set", "lap_s=12", "--set", "overlap_s=1", "--set", "odometry=true"),
)


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of a run over the course, with a map."""
    folder = tmp_path_factory.mktemp("mapped") / "run"
    assert main(["run", "course:perceptions", *COURSE, "--output", str(folder)]) == 0
    return folder


def localized(mapped: Path, *arguments: str) -> Path:
    output = mapped.parent / f"localized{len(arguments)}"
    command = ["localize", "course:perceptions", *COURSE, "--map", str(mapped / "map.json")]
    assert main([*command, *arguments, "--output", str(output)]) == 0
    return output


def test_it_is_found_from_anywhere(mapped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = localized(mapped)
    printed = capsys.readouterr().out
    assert "poses are within 1 m by 95 % or more" in printed
    result = read(folder)
    with (folder / "quality.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == QUALITY_COLUMNS
    assert len(rows) == len(result.smoothed) == result.num_scans == 131
    assert float(rows[-1]["quality"]) > 0.95
    assert rows[-1]["estimator"] == "fast"
    assert "fast estimator takes over" in result.events[0]
    assert (folder / "localization.png").stat().st_size > 10_000
    assert (folder / "trajectory_particles.tum").exists()
    assert (folder / "map.csv").read_bytes() == (mapped / "map.csv").read_bytes()
    rmse = next(line for line in printed.splitlines() if line.startswith("RMSE"))
    assert float(rmse.split(": ")[1].split(" m")[0]) < 0.15


def test_the_map_grows_if_it_may(mapped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = localized(mapped, "--grow")
    assert "kept" in capsys.readouterr().out
    assert (folder / "report.csv").read_text().startswith("fate,kind,prior")
    assert (folder / "trajectory_localized.tum").exists()
    before, after = (len((each / "map.csv").read_text().splitlines()) for each in (mapped, folder))
    assert abs(after - before) <= 2
    assert (folder / "map.csv").read_bytes() != (mapped / "map.csv").read_bytes()
    assert len(read(folder).smoothed) == 131


def test_a_start_within_a_radius(mapped: Path) -> None:
    assert len(read(localized(mapped, "--radius", "3", "10", "0")).smoothed) == 131


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--map", "nothing.json"], "nothing.json: expected a file"),
        (["--map", "list.csv", "--radius", "-1", "0", "0"], "expected a radius above 0"),
        (["--map", "list.csv", "--set", "localizer.sed=1"], "did you mean 'seed'"),
        (["--map", "list.csv", "--set", "localizer.particles.leap=1"], "did you mean 'leaps'"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    reason: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("list.csv").write_text("x_m,y_m,kind,diameter_m\n1,2,tree,0.3\n")
    assert main(["localize", "course:perceptions", *COURSE, *arguments, "--output", "out"]) == 1
    assert reason in capsys.readouterr().err
    assert not Path("out").exists()


def test_a_measurement_from_the_past_is_left_out_and_told() -> None:
    """As `run` does: one stamp that runs backwards costs no whole run."""
    trees, settings = stand(), load_settings(None, [])
    poses = [Pose2(20.0 + 0.1 * k, 30.0, 0.0) for k in range(20)]
    rng = np.random.default_rng(0)
    stamps_ns = [100_000_000 * (2 if k == 10 else k) for k in range(20)]
    scans = [
        perceive(trees, pose, stamp_ns, rng)
        for stamp_ns, pose in zip(stamps_ns, poses, strict=True)
    ]
    recording = Recording("backwards", scans, len(scans))
    landmarks = tuple(
        Landmark(k, Tree(), place, 4e-4 * np.eye(2), 5, 1.0)
        for k, place in enumerate(trees.map_t_landmarks)
    )
    start, perceiver = start_of((20.0, 30.0, 0.0), None), Perceiver(recording, settings)
    found = localize(recording, landmarks, start, settings, perceiver, Silence(), {})
    assert len(found.run.smoothed) == 19
    assert any("left out for times that do not run forwards" in each for each in found.run.events)
