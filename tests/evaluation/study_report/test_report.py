"""The report from a study's files alone."""

import csv
from pathlib import Path

import pytest

from evaluation.studies.outcome_lines import outcome_line
from evaluation.studies.store import TRIALS_JSONL
from evaluation.studies.trial import Outcome
from evaluation.study_report.report import write_report
from semgraph.cli import main
from semgraph.errors import InputError
from tests.evaluation.study_report import made

_STUDY = """
name = "paper"
question = "How near is the oracle?"
seeds = "1-8"
estimators = ["dead-reckoning", "paper", "fast", "particle-filter", "smoothed", "refined",
    "oracle", "ekf-slam", "plain-isam2"]

[[condition]]
name = "here"
source = "course:perceptions"
options = { rows = true }
"""


def test_it_is_made_again_from_the_files_to_the_byte(tmp_path: Path) -> None:
    _study_folder(tmp_path, made.outcomes(8, ("here",)))
    path = write_report(tmp_path)
    first = path.read_bytes()
    assert main(["report", str(tmp_path)]) == 0
    assert path.read_bytes() == first
    assert b"How near is the oracle?" in first
    assert not list(tmp_path.glob(".*.*"))


def test_the_order_in_which_trials_ended_does_not_matter(tmp_path: Path) -> None:
    outcomes = made.outcomes(8, ("here",))
    pages = []
    for name, its in (("one", outcomes), ("other", outcomes[::-1])):
        (tmp_path / name).mkdir()
        _study_folder(tmp_path / name, its)
        pages.append(write_report(tmp_path / name).read_bytes())
    assert pages[0] == pages[1]


def test_the_tables_beside_it_hold_what_the_page_says(tmp_path: Path) -> None:
    _study_folder(tmp_path, made.outcomes(8, ("here",)))
    write_report(tmp_path)
    with (tmp_path / "summaries.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    fast = [row for row in rows if row["estimator"] == "fast"]
    assert {row["metric"] for row in fast} >= {"trajectory_rmse_m", "nees_mean"}
    assert all(float(row["low"]) <= float(row["median"]) <= float(row["high"]) for row in fast)
    with (tmp_path / "differences.csv").open(newline="") as file:
        assert {row["condition"] for row in csv.DictReader(file)} == {"here"}


def test_a_part_of_a_study_says_how_much_is_missing(tmp_path: Path) -> None:
    _study_folder(tmp_path, made.outcomes(8, ("here",))[:-2])
    assert "2 trials have not run" in write_report(tmp_path).read_text(encoding="utf-8")


def test_a_folder_that_is_no_study_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match=r"study\.toml"):
        write_report(tmp_path)
    assert main(["report", str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def _study_folder(folder: Path, outcomes: tuple[Outcome, ...]) -> None:
    (folder / "study.toml").write_text(_STUDY)
    (folder / TRIALS_JSONL).write_bytes(b"".join(map(outcome_line, outcomes)))
