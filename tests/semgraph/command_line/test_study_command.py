"""`semgraph study` as it is typed."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from evaluation.studies.store import read_outcomes
from evaluation.studies.trial import Status
from semgraph.cli import main
from semgraph.one_thread import ONE_THREAD

STUDY = """
name = "small"
question = "How near is the fast estimator to what is possible?"
seeds = "1-2"
estimators = ["fast", "oracle"]

[[condition]]
name = "a short course"
source = "course:perceptions"
options = { lap_s = 8.0, overlap_s = 1.0, num_trees = 30, track_radius_m = 8.0 }

[[condition]]
name = "of a recording"
source = "car-park:{data}/car_park"
"""


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The beginning of a command, run from a folder without data."""
    for name in ONE_THREAD:
        monkeypatch.setenv(name, "1")
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(STUDY)
    return ["study", "small.toml", "--workers", "0"]


def test_a_study_runs_goes_on_and_ends_with_its_report(
    study: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*study, "--seeds", "1-1"]) == 0
    said = capsys.readouterr().out
    assert "of a recording: left out" in said
    assert "2 trials: 2 finished" in said
    folder = Path("results", "study-small")
    assert {path.name for path in folder.iterdir()} >= {
        "study.toml",
        "trials.jsonl",
        "trials.csv",
        "trials.parquet",
        "report.html",
    }
    assert main(study) == 0
    assert "2 of 4 trials are there already" in capsys.readouterr().out
    outcomes = read_outcomes(folder)
    assert [each.status for each in outcomes] == [Status.FINISHED] * 4

    wanted = outcomes[0].trial.id
    assert main([*study, "--trial", wanted[:8]]) == 0
    alone = capsys.readouterr().out
    value = outcomes[0].values["trajectory_rmse_m"]
    assert f"trajectory_rmse_m {value:.6g} m" in alone

    assert main([*study, "--seeds", "2-2"]) == 1
    assert "choose another --output" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (["study", "papr"], 1, "did you mean 'paper'"),
        (["study", "paper", "--seeds", "5-1"], 2, "expected the smaller seed first"),
        (["study", "paper", "--tls-ca", "ca.pem"], 1, "expected --scheduler with them"),
        (["study", "paper", "--trial", "zz"], 1, "0 begin so"),
        (["study", "paper", "--workers", "2", "--scheduler", "tcp://h:1"], 2, "not allowed with"),
        (["study", "paper", "--workers", "-1"], 2, "--workers"),
        (["study", "paper", "--trial-timeout", "0"], 2, "--trial-timeout"),
        (["study", "paper", "--trial-memory", "-1"], 2, "--trial-memory"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(
    study: list[str],
    arguments: list[str],
    status: int,
    reason: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    try:
        came = main(arguments)
    except SystemExit as end:
        came = int(end.code or 0)
    assert came == status
    assert reason in capsys.readouterr().err


def test_help_imports_neither_cluster_nor_numbers() -> None:
    command = [sys.executable, "-X", "importtime", "-m", "semgraph.cli", "study", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "--trial-timeout" in done.stdout
    imported = set(re.findall(r"\| +([\w.]+)$", done.stderr, re.MULTILINE))
    assert "argparse" in imported
    assert not imported & {"dask", "distributed", "numpy", "gtsam", "pyarrow", "rich"}
