"""A study goes on wherever it was interrupted; its tables are whole or not there."""

import csv
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from pyarrow import parquet

from evaluation.studies.execution import Execution
from evaluation.studies.outcome_lines import outcome_line
from evaluation.studies.running import endings, read_run, run_study
from evaluation.studies.store import TRIALS_JSONL, opened_store, read_outcomes
from evaluation.studies.study_file import Plan
from evaluation.studies.trial import Outcome, Status
from evaluation.studies.trial_tables import TRIALS_CSV, TRIALS_PARQUET, write_tables
from semgraph.errors import InputError, SemgraphError
from tests.evaluation.studies.processes import environment, kill_tree, wait_until
from tests.evaluation.studies.small_trials import CLIENT, MEASURE, measure, plan, trial, unwatched
from tests.evaluation.studies.test_store import no_file_above

HERE = Execution(workers=0, measure=MEASURE)


def run(folder: Path, asked: Plan, *, retry: bool = False) -> tuple[tuple[Outcome, ...], list[str]]:
    told: list[str] = []
    return run_study(asked, folder, HERE, unwatched, told.append, retry=retry), told


def test_a_study_runs_once_and_grows_with_its_seeds(tmp_path: Path) -> None:
    log = tmp_path / "log"
    first, told = run(tmp_path / "out", plan(3, log=str(log)))
    assert [each.trial.seed for each in first] == [0, 1, 2]
    assert not told
    more, told = run(tmp_path / "out", plan(5, log=str(log)))
    assert [each.trial.seed for each in more] == [0, 1, 2, 3, 4]
    assert told == ["3 of 5 trials are there already"]
    assert set(Counter(log.read_text().split()).values()) == {1}
    study, read = read_run(tmp_path / "out")
    assert study.seeds == "0-4"
    assert [each.trial for each in read] == [each.trial for each in more]


def test_failed_trials_run_again_only_if_asked(tmp_path: Path) -> None:
    log = tmp_path / "log"
    asked = plan(2, ("plain", "refuses"), log=str(log))
    outcomes, _ = run(tmp_path / "out", asked)
    assert endings(outcomes) == {Status.FINISHED: 2, Status.FAILED: 2}
    run(tmp_path / "out", asked)
    assert len(log.read_text().split()) == 4
    run(tmp_path / "out", asked, retry=True)
    assert sorted(Counter(log.read_text().split()).values()) == [1, 1, 2, 2]
    assert len(read_outcomes(tmp_path / "out")) == 4


def test_another_studys_folder_is_refused_and_stays_as_it_is(tmp_path: Path) -> None:
    run(tmp_path, plan(2, seconds="0.0"))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(InputError, match="holds 2 trials that this study does not have"):
        run(tmp_path, plan(2))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_after_kill_9_nothing_is_lost_or_run_twice_and_nobody_is_left(tmp_path: Path) -> None:
    folder, log = tmp_path / "out", tmp_path / "log"
    options = [f"log={log}", "seconds=0.3"]
    command = [sys.executable, "-m", CLIENT, str(folder), "2", "12", *options]
    client = subprocess.Popen(command, env=environment(), stdout=subprocess.DEVNULL)
    try:
        lines = folder / TRIALS_JSONL
        wait_until(lambda: lines.exists() and lines.read_bytes().count(b"\n") >= 3)
        workers = psutil.Process(client.pid).children(recursive=True)
        client.send_signal(signal.SIGKILL)
        client.wait()
        kept = {each.trial.id for each in read_outcomes(folder)}
        wait_until(lambda: not any(each.is_running() for each in workers), 20.0)
    finally:
        kill_tree(client.pid)
    outcomes, told = run(folder, plan(12, log=str(log), seconds="0.3"))
    assert 3 <= len(kept) < 12
    assert f"{len(kept)} of 12 trials are there already" in told
    assert len(outcomes) == 12
    runs = Counter(log.read_text().split())
    assert all(runs[each] == 1 for each in kept)


def test_on_a_full_disk_a_study_stops_with_a_word_and_goes_on_later(tmp_path: Path) -> None:
    with no_file_above(5000), pytest.raises(SemgraphError, match="make room and give the same"):
        run(tmp_path, plan(12))
    kept = len(read_outcomes(tmp_path))
    assert 0 < kept < 12
    outcomes, told = run(tmp_path, plan(12))
    assert told == [f"{kept} of 12 trials are there already"]
    assert len(outcomes) == 12


def test_tables_hold_a_row_a_trial_and_every_metric(tmp_path: Path) -> None:
    failed = Outcome(trial("refuses"), Status.FAILED, 'why, "really"')
    write_tables(tmp_path, [measure(trial()), failed])
    with (tmp_path / TRIALS_CSV).open(newline="") as file:
        rows = list(csv.DictReader(file))
    columns = parquet.read_table(tmp_path / TRIALS_PARQUET).to_pydict()
    value = measure(trial()).values["error_m"]
    assert [row["reason"] for row in rows] == columns["reason"] == ["", 'why, "really"']
    assert columns["error_m"] == [value, None]
    assert [row["error_m"] for row in rows] == [repr(value), ""]
    assert columns["seed"] == [0, 0]


def test_tables_are_both_there_or_none(tmp_path: Path) -> None:
    outcomes = [measure(trial(seed=seed)) for seed in range(4)]
    with no_file_above(1000), pytest.raises(SemgraphError, match=r"trials.csv and .* File too"):
        write_tables(tmp_path, outcomes)
    assert not list(tmp_path.iterdir())


def test_what_a_spreadsheet_would_run_is_text_in_csv_alone(tmp_path: Path) -> None:
    write_tables(tmp_path, [measure(trial(condition="=1+1"))])
    with (tmp_path / TRIALS_CSV).open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["condition"] == "'=1+1"
    columns = parquet.read_table(tmp_path / TRIALS_PARQUET).to_pydict()
    assert columns["condition"] == ["=1+1"]


def test_several_versions_in_one_folder_are_told(tmp_path: Path) -> None:
    asked = plan(3)
    with opened_store(tmp_path) as store:
        earlier = replace(measure(asked.trials[0]), versions=(("numpy", "1.0"),))
        store.append(outcome_line(earlier))
    _, told = run(tmp_path, asked)
    (words,) = [each for each in told if "several versions" in each]
    assert f"numpy 1.0 (1), {np.__version__} (2); " in words
    _, told = run(tmp_path / "new", asked)
    assert not [each for each in told if "several versions" in each]
