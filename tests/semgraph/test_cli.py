"""The command line as a user types it, and the README's promises."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from evaluation.studies.study_file import read_study, study_text
from semgraph.cli import _parser

ROOT = Path(__file__).resolve().parents[2]


def semgraph(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "semgraph.cli", *arguments]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=300
    )


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder in which the demo ran, and what it printed."""
    folder = tmp_path_factory.mktemp("demo")
    done = semgraph(folder, "demo")
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def test_the_demo_shows_a_table_and_leaves_what_the_readme_lists(demo: tuple[Path, str]) -> None:
    folder, printed = demo
    assert "smoothed" in printed
    assert "semgraph view" in printed
    written = {path.name for path in (folder / "results" / "latest").iterdir()}
    listed = set(re.findall(r"`([a-z_]+\.[a-z]+)`", _section("What comes out")))
    assert listed <= written, listed - written
    metrics = json.loads((folder / "results" / "latest" / "metrics.json").read_text())
    assert metrics["fast_trajectory_max_origin_m"]["value"] < 0.5
    smoothed, fast = metrics["trajectory_rmse_m"], metrics["fast_trajectory_rmse_m"]
    assert smoothed["value"] < fast["value"]
    assert (smoothed["unit"], smoothed["better"]) == ("m", "lower")
    for name in (
        "trajectory_median_m",
        "trajectory_rmse_unaligned_m",
        "map_rmse_m",
        "landmarks_confirmed",
        "landmarks_missed",
        "landmarks_duplicate",
        "nees_mean",
        "scans_per_second",
        "fast_latency_p99_ms",
    ):
        assert name in metrics


def test_a_run_is_judged_again_from_its_files_alone(demo: tuple[Path, str]) -> None:
    folder, _ = demo
    latest = folder / "results" / "latest"
    before = (latest / "metrics.json").read_text()
    (latest / "metrics.json").unlink()
    done = semgraph(folder, "evaluate", "results/latest")
    assert done.returncode == 0, done.stderr
    assert "trajectory rmse" in done.stdout
    assert json.loads((latest / "metrics.json").read_text()) == json.loads(before)


def test_the_effective_settings_run_again(demo: tuple[Path, str], tmp_path: Path) -> None:
    folder, _ = demo
    settings = folder / "results" / "latest" / "settings.toml"
    done = semgraph(
        tmp_path, "run", "course:perceptions", "--settings", str(settings), "--output", "again"
    )
    assert done.returncode == 0, done.stderr
    first = (folder / "results" / "latest" / "trajectory.tum").read_bytes()
    assert (tmp_path / "again" / "trajectory.tum").read_bytes() == first
    same = semgraph(tmp_path, "compare", "again", str(folder / "results" / "latest"))
    assert "0.000 m" in same.stdout


def test_help_is_quick() -> None:
    seconds = []
    for _ in range(3):
        before = time.perf_counter()
        assert semgraph(ROOT, "--help").returncode == 0
        seconds.append(time.perf_counter() - before)
    loaded = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "semgraph.cli", "--help"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stderr
    assert not re.search(r"\b(gtsam|open3d|rerun|numpy|scipy|matplotlib)\b", loaded)
    assert min(seconds) < 1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "course:papr"], "course:paper"),
        (["run", "nowhere"], "nowhere"),
        (["simulate", "course:paper", "taken"], "taken"),
        (["simulate", "course:rock", "new"], "course:rocks"),
        (["simulate", "course:forest", "new", "--set", "stem_map=none.csv"], "none.csv"),
        (["run", "course:paper", "--set", "sed=1"], "seed"),
        (["run", "course:perceptions", "--set", "num_trees=100000"], "num_trees"),
        (["run", "course:paper", "--settings", "none.toml"], "none.toml"),
        (["run", "course:paper", "--output", "taken"], "taken"),
        (["detect", "course:perceptions", "--output", "new"], "come ready"),
        (["detect", "course:paper", "--set", "detectors.trees-2d.no=1"], "no"),
        (["detect", "course:paper", "--output", "taken"], "taken"),
        (["bench", "graph", "--only", "papr"], "paper"),
        (["evaluate", "nowhere"], "nowhere"),
        (["view", "nowhere"], "nowhere"),
    ],
)
def test_a_known_error_is_one_line_and_status_1(
    tmp_path: Path, arguments: list[str], words: str
) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "a_users_own.txt").write_text("kept")
    done = semgraph(tmp_path, *arguments)
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stderr.count("\n") == 1
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_a_course_is_written_as_a_folder_that_runs_the_same(tmp_path: Path) -> None:
    options = [f"--set={each}" for each in ("track_radius_m=8", "speed=8", "overlap_s=0.5")]
    written = semgraph(tmp_path, "simulate", "course:car-park", "written", *options)
    assert written.returncode == 0, written.stderr
    assert written.stdout.count("\n") == 1
    for source, output in (("course:car-park", "one"), ("written", "two")):
        settings = options if source.startswith("course") else []
        done = semgraph(tmp_path, "run", source, *settings, "--output", output)
        assert done.returncode == 0, done.stderr
    assert "0.000 m" in semgraph(tmp_path, "compare", "one", "two").stdout
    again = semgraph(tmp_path, "simulate", "course:car-park", "written", *options)
    assert again.returncode == 1
    assert "new or empty folder" in again.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["fly"],
        ["bench", "fly"],
        ["bench", "all", "--seeds", "x"],
        ["bench", "detectors", "--seeds", "5-4"],
        ["bench", "detectors", "--seeds", "x"],
        ["bench", "detectors", "--seeds=-3-4"],
        ["bench", "detectors", "--seeds", "1-99999999999"],
        ["run", "course:perceptions", "--speed", "2"],
        ["run", "course:perceptions", "--online", "--speed", "0"],
        ["run", "course:perceptions", "--online", "--speed", "nan"],
    ],
)
def test_wrong_usage_is_status_2(tmp_path: Path, arguments: list[str]) -> None:
    done = semgraph(tmp_path, *arguments)
    assert done.returncode == 2
    assert "usage" in done.stderr


def test_online_is_the_same_run_with_what_was_known_in_time(tmp_path: Path) -> None:
    options = [f"--set={each}" for each in ("track_radius_m=8", "lap_s=10", "overlap_s=2")]
    for output, online in (("one", []), ("two", ["--online", "--speed", "20"])):
        done = semgraph(
            tmp_path, "run", "course:perceptions", *options, *online, "--output", output
        )
        assert done.returncode == 0, done.stderr
    assert "online" in done.stdout
    one, two = tmp_path / "one", tmp_path / "two"
    for name in ("trajectory.tum", "trajectory_covariance.csv", "map.json", "settings.toml"):
        assert (one / name).read_bytes() == (two / name).read_bytes()
    added = {path.name for path in two.iterdir()} - {path.name for path in one.iterdir()}
    assert added == {"trajectory_online.tum"}
    assert "played at 20 times real time" in (two / "events.log").read_text()
    judged = json.loads((two / "metrics.json").read_text())
    assert {"online_trajectory_rmse_m", "online_delay_max_s", "online_restarts"} <= judged.keys()
    assert semgraph(tmp_path, "evaluate", "two").returncode == 0
    assert json.loads((two / "metrics.json").read_text()) == judged


def test_what_is_detected_is_written_drawn_and_counted(tmp_path: Path) -> None:
    done = semgraph(tmp_path, "detect", "course:paper", "--output", "out")
    assert done.returncode == 0, done.stderr
    assert "trees-2d" in done.stdout
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"perceptions.csv", "detections.png", "settings.toml"}
    settings = str(tmp_path / "out" / "settings.toml")
    again = semgraph(tmp_path, "detect", "course:paper", "--settings", settings, "--output", "two")
    assert again.returncode == 0, again.stderr
    first, second = (tmp_path / name / "perceptions.csv" for name in ("out", "two"))
    assert first.read_bytes() == second.read_bytes()


def test_a_folder_written_by_hand_runs(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "recording.toml").write_text('name = "mine"\n')
    rows = ["stamp_s,kind,range_m,bearing_rad"]
    for k in range(30):
        rows += [f"{0.1 * k:.1f},tree,{5 - 0.05 * k:.2f},0.0", f"{0.1 * k:.1f},rock,4.0,1.5"]
    (folder / "perceptions.csv").write_text("\n".join(rows) + "\n")
    done = semgraph(tmp_path, "run", "mine", "--output", "out")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "map.png").stat().st_size > 10_000


def test_from_an_empty_directory_to_the_report_of_a_study(tmp_path: Path) -> None:
    (command,) = re.findall(r"semgraph (study .+)", _section("Studies").split("```")[1])
    study = read_study("paper").model_copy(update={"estimators": ["paper", "fast"]})
    first = study.model_copy(update={"condition": study.condition[:1], "seeds": "1-2"})
    (tmp_path / "paper.toml").write_text(study_text(first))
    arguments = command.replace("study paper ", "study paper.toml ").split()
    done = semgraph(tmp_path, *arguments, "--workers", "0")
    assert done.returncode == 0, done.stderr
    files = {path.name for path in (tmp_path / "results" / "paper").iterdir()}
    told = set(
        re.findall(
            r"`([a-z]+\.[a-z]+)`", _section("Studies").split("| file")[1].split("A study file")[0]
        )
    )
    assert len(told) == 6
    assert told <= files
    page = (tmp_path / "results" / "paper" / "report.html").read_text(encoding="utf-8")
    assert "4 trials: 2 estimators under 1 condition with 2 seeds. All that ran finished." in page
    assert semgraph(tmp_path, "report", "results/paper").returncode == 0


def test_the_readmes_commands_exist() -> None:
    named = set(re.findall(r"(?m)(?:`|^)semgraph ([a-z]+)\b", _text()))
    assert {"demo", "run", "evaluate", "view", "bench", "detect", "refine"} <= named
    assert {"study", "report", "baseline"} <= named
    (commands,) = (each for each in _parser()._actions if each.dest == "command")
    assert named <= set(commands.choices or ())
    assert "./check" in _text()
    assert (ROOT / "check").stat().st_mode & 0o111
    assert "./check" in (ROOT / ".ci" / "run").read_text()


def _text() -> str:
    return (ROOT / "README.md").read_text()


def _section(title: str) -> str:
    return _text().split(f"## {title}\n")[1].split("\n## ")[0]
