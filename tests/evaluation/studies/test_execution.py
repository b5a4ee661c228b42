"""Trials in this process, in local and remote clusters; what ends badly, and who is killed."""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from distributed import Client, wait

from evaluation.studies import execution
from evaluation.studies.execution import Execution, Tls, outcome_lines, run_alone
from evaluation.studies.outcome_lines import parse_outcome
from evaluation.studies.store import TRIALS_JSONL
from evaluation.studies.trial import Status
from evaluation.studies.trial_process import Limits
from evaluation.studies.trial_runner import TrialRunner
from semgraph.errors import SemgraphError
from semgraph.one_thread import ONE_THREAD
from tests.evaluation.studies.processes import environment, kill_tree, wait_until
from tests.evaluation.studies.small_trials import CLIENT, MEASURE, plan, trial

NUMBER = 10
PLAN = plan(NUMBER, seconds="0.1")


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """The lines of all trials of `PLAN`, as a process without workers stores them."""
    folder = tmp_path_factory.mktemp("in-process")
    command = [sys.executable, "-m", CLIENT, str(folder), "0", str(NUMBER), "seconds=0.1"]
    subprocess.run(command, check=True, env=environment() | ONE_THREAD, stdout=subprocess.DEVNULL)
    return sorted((folder / TRIALS_JSONL).read_bytes().splitlines(keepends=True))


@contextmanager
def runner(seconds: float = 30.0, memory_bytes: int = 0) -> Iterator[TrialRunner]:
    opened = TrialRunner(MEASURE, Limits(seconds, memory_bytes))
    try:
        yield opened
    finally:
        opened.end()


@contextmanager
def cluster(
    folder: Path, num_workers: int, *tls: str
) -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """A scheduler and workers as processes of their own, as a user starts them."""
    meeting = folder / "scheduler.json"
    started: list[subprocess.Popen[bytes]] = []

    def start(*arguments: str) -> None:
        command = [sys.executable, "-m", *arguments, *tls, "--scheduler-file", str(meeting)]
        quiet = subprocess.DEVNULL
        started.append(
            subprocess.Popen(command, stdout=quiet, stderr=quiet, cwd=folder, env=environment())
        )

    try:
        start("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
              "--no-dashboard")  # fmt: skip
        wait_until(meeting.exists)
        for _ in range(num_workers):
            start("distributed.cli.dask_worker", "--nthreads", "1", "--host", "127.0.0.1",
                  "--no-dashboard")  # fmt: skip
        address = json.loads(meeting.read_text())["address"]
        yield address, started[0], started[1:]
    finally:
        for process in started:
            kill_tree(process.pid)
            process.wait()


@pytest.mark.parametrize(
    ("estimator", "status", "reason"),
    [
        ("refuses", Status.FAILED, "nothing to see here"),
        ("throws", Status.FAILED, "ZeroDivisionError: by nought (small_trials.py line"),
        ("grabs", Status.OUT_OF_MEMORY, "no memory left"),
        ("crashes", Status.FAILED, "its process killed by SIGSEGV"),
        ("is-killed", Status.OUT_OF_MEMORY, "as Linux does when memory runs out"),
        ("hangs", Status.TIMED_OUT, "not done after 0.5 s (--trial-timeout)"),
    ],
)
def test_whatever_ends_a_trial_is_its_outcome_and_the_next_one_runs(
    shared_runner: TrialRunner, estimator: str, status: Status, reason: str
) -> None:
    ended = parse_outcome(shared_runner.outcome_line(trial(estimator)))
    assert ended.status is status
    assert reason in ended.reason
    assert parse_outcome(shared_runner.outcome_line(trial())).status is Status.FINISHED


@pytest.fixture(scope="module")
def shared_runner() -> Iterator[TrialRunner]:
    with runner(seconds=0.5) as opened:
        yield opened


def test_a_trial_gets_no_more_memory_than_it_may() -> None:
    with runner(memory_bytes=2**33) as narrow:
        outcome = parse_outcome(narrow.outcome_line(trial("fills")))
    assert outcome.status is Status.OUT_OF_MEMORY


def test_a_killed_process_for_trials_is_started_again() -> None:
    others = psutil.Process().children()
    with runner() as opened:
        before = parse_outcome(opened.outcome_line(trial()))
        (process,) = [each for each in psutil.Process().children() if each not in others]
        process.kill()
        process.wait()
        assert parse_outcome(opened.outcome_line(trial())).values == before.values


def test_one_trial_alone_needs_no_cluster() -> None:
    assert parse_outcome(run_alone(trial(), Execution(measure=MEASURE))).status is Status.FINISHED


def test_local_workers_compute_what_this_process_does_and_killed_ones_are_replaced(
    reference: list[bytes], tmp_path: Path
) -> None:
    once = tmp_path / "killed"
    todo = [
        trial("kills-its-worker", once=str(once)),
        trial("kills-its-worker-always"),
        trial("hangs"),
        *PLAN.trials,
    ]
    how = Execution(workers=2, measure=MEASURE, limits=Limits(2.0))
    lines = list(outcome_lines(todo, how))
    assert once.exists()
    ends = {each.trial.estimator: each for each in map(parse_outcome, lines)}
    assert ends["kills-its-worker"].status is Status.FINISHED
    assert ends["kills-its-worker-always"].reason.startswith("every worker that ran it ended")
    assert ends["hangs"].status is Status.TIMED_OUT
    assert sorted(line for line in lines if b'"plain"' in line) == reference


def test_a_remote_cluster_loses_a_worker_and_no_trial_and_is_missed_when_it_goes(
    reference: list[bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with cluster(tmp_path, 2) as (address, scheduler, workers):
        how = Execution(scheduler=address, measure=MEASURE)
        lines = outcome_lines(PLAN.trials, how)
        came = [next(lines), next(lines)]
        kill_tree(workers[0].pid)
        came += list(lines)
        assert sorted(came) == reference

        lines = outcome_lines(PLAN.trials, how)
        next(lines)
        kill_tree(scheduler.pid)
        with pytest.raises(SemgraphError, match="the scheduler is gone; all finished trials"):
            list(lines)


@pytest.fixture
def certificate(tmp_path: Path) -> Tls:
    """One that vouches for itself."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not there to make a certificate")
    pem, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    command = "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -addext"
    subprocess.run(
        [*command.split(), "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(pem)],
        check=True,
        capture_output=True,
    )
    return Tls(pem, pem, key)


def test_over_tls_strangers_are_kept_out_and_a_cluster_without_workers_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, certificate: Tls
) -> None:
    pem, key = str(certificate.ca), str(certificate.key)
    tls = ("--tls-ca-file", pem, "--tls-cert", pem, "--tls-key", key, "--protocol", "tls")
    with cluster(tmp_path, 1, *tls) as (address, _, workers):
        how = Execution(scheduler=address, tls=certificate, measure=MEASURE)
        lines = outcome_lines(PLAN.trials, how)
        assert parse_outcome(next(lines)).status is Status.FINISHED
        monkeypatch.setattr(execution, "_WORKERLESS_S", 0.0)
        monkeypatch.setattr(execution, "_PATIENCE_S", 2.0)
        with pytest.raises(SemgraphError, match="cannot be reached"):
            list(outcome_lines(PLAN.trials, Execution(scheduler=address, measure=MEASURE)))
        kill_tree(workers[0].pid)
        with pytest.raises(SemgraphError, match="there has been no worker for 0 s"):
            list(lines)
        with pytest.raises(SemgraphError, match="has no workers; start some with: dask worker"):
            list(outcome_lines(PLAN.trials, how))


def test_a_result_that_its_worker_took_along_is_not_waited_for_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(execution, "_PATIENCE_S", 1.0)
    with cluster(tmp_path, 1) as (address, _, workers), Client(address) as client:
        future = execution._submitted(client, Execution(measure=MEASURE), trial())
        wait(future)
        kill_tree(workers[0].pid)
        assert execution._line(trial(), future) is None


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere"])
def test_a_scheduler_that_is_not_there_is_said_soon(
    monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    monkeypatch.setattr(execution, "_PATIENCE_S", 1.0)
    with pytest.raises(SemgraphError, match=f"{address}: the scheduler cannot be reached"):
        list(outcome_lines(PLAN.trials, Execution(scheduler=address, measure=MEASURE)))


def test_a_certificate_that_is_not_there_is_named(tmp_path: Path) -> None:
    how = Execution(scheduler="tls://127.0.0.1:9", tls=Tls(tmp_path / "ca.pem"), measure=MEASURE)
    with pytest.raises(SemgraphError, match=r"ca\.pem: expected a file in PEM"):
        list(outcome_lines(PLAN.trials, how))
