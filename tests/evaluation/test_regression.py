"""The regression gate itself: the one long test of the default set."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from evaluation.baseline import METRICS, read_baseline
from evaluation.regression import (
    BASELINE_JSON,
    baseline_trials,
    failures,
    held_against,
    measured_figures,
    told,
    update,
)
from evaluation.studies.execution import Execution
from semgraph.cli import main
from semgraph.errors import SemgraphError
from semgraph.progress import Silence

_QUICK = """
name = "quick"
question = "Does the gate hold?"
seeds = "1"
estimators = ["fast"]

[[condition]]
name = "here"
source = "course:perceptions"
"""


def test_no_figure_is_worse_than_it_was() -> None:
    command = [sys.executable, "-m", "semgraph.cli", "baseline"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_baseline_has_a_figure_of_each_trial_in_each_direction() -> None:
    figures = read_baseline(BASELINE_JSON)
    groups = {name.rpartition(", ")[0] for name in figures}
    assert groups == {f"{each.condition}, {each.estimator}" for each in baseline_trials()}
    assert {name.rpartition(", ")[2] for name in figures} == set(METRICS)


def test_a_worse_baseline_is_never_written_by_accident(tmp_path: Path) -> None:
    study, path = tmp_path / "study.toml", tmp_path / "baseline.json"
    study.write_text(_QUICK)
    now = measured_figures(baseline_trials(study), Execution(workers=0), Silence())
    assert not failures(update(path, now, worse_too=False))
    assert not failures(held_against(path, now))
    first = path.read_bytes()

    better = json.loads(first)
    better["here, fast, trajectory_rmse_m"]["value"] /= 2.0
    path.write_text(json.dumps(better))
    found = held_against(path, now)
    assert [each.name for each in failures(found)] == ["here, fast, trajectory_rmse_m"]
    assert told(found)[0].startswith("here, fast, trajectory_rmse_m: worse: 0.0")
    assert failures(update(path, now, worse_too=False))
    assert json.loads(path.read_text()) == better
    update(path, now, worse_too=True)
    assert path.read_bytes() == first


def test_no_baseline_is_no_pass(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    with pytest.raises(SemgraphError, match="expected a file"):
        held_against(path, {})
    path.write_text("{}")
    with pytest.raises(SemgraphError, match="expected figures"):
        held_against(path, {})


def test_worse_too_needs_an_update(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["baseline", "--worse-too"]) == 1
    assert "--update" in capsys.readouterr().err


def test_the_readmes_demo_is_in_the_baseline() -> None:
    """What `semgraph demo` is said to reach in the README, to the digits it is told in."""
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    row = next(line for line in readme.splitlines() if line.startswith("| `semgraph demo`"))
    figures = read_baseline(BASELINE_JSON)
    for name, digits in (
        ("fast, trajectory_rmse_m", 3),
        ("fast, map_rmse_m", 3),
        ("fast, trajectory_max_origin_m", 2),
        ("smoothed, trajectory_rmse_m", 3),
        ("smoothed, map_rmse_m", 3),
    ):
        assert f"{figures[f'demo, {name}'].value:.{digits}f}" in row
