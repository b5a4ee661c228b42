"""The graph in a process of its own: the same bits, whatever happens to that process."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.benches.bench_online import is_same
from semgraph import results
from semgraph.beside.graph_beside import GraphBeside
from semgraph.beside.online import OnlineSettings, OnlineSmoother
from semgraph.beside.smoothing_loop import Taken
from semgraph.errors import SemgraphError
from semgraph.fast_estimator import FastEstimator, FastStep
from semgraph.files.yaw_rates import YawRateLog
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Perceptions
from semgraph.moments import moments
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.results import RunResult
from semgraph.settings import Settings
from semgraph.smoothed import Smoothed
from sensors.catalog import open_source
from sensors.measurements import Recording
from sensors.views import View

SHORT = {"seed": 4, "track_radius_m": 10.0, "num_trees": 40, "lap_s": 15.0, "overlap_s": 3.0}
SETTINGS = Settings()
Act = Callable[[OnlineSmoother, int], None]


@dataclass
class Acting:
    """After each scan something is done to the graph's process."""

    graph: OnlineSmoother
    act: Act
    num_scans: int = 0

    def add(self, step: FastStep, perceptions: Perceptions, views: Sequence[View]) -> None:
        self.graph.add(step, perceptions, views)
        self.act(self.graph, self.num_scans)
        self.num_scans += 1

    def finish(self, note: Callable[[str], None]) -> Smoothed:
        return self.graph.finish(note)


def ran(recording: Recording, graph: GraphBeside | None = None) -> RunResult:
    perceiver = Perceiver(recording, SETTINGS)
    return run(recording, SETTINGS, perceiver, Silence(), {}, graph=graph)


def ran_online(recording: Recording, act: Act, **settings: float) -> RunResult:
    online = OnlineSettings.model_validate(settings)
    with OnlineSmoother(SETTINGS.smoother, online, recording.map_T_start) as graph:
        return ran(recording, Acting(graph, act))


def kept_up(graph: OnlineSmoother, _: int = 0) -> None:
    """Waits until the graph has taken in all."""
    while graph.num_behind and graph.worker_pid is not None:
        time.sleep(0.002)
        graph.tend()


def is_alive(pid: int) -> bool:
    """Not so if it is a zombie that nobody has asked for yet."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def wait_until_dead(pid: int, seconds: float = 15.0) -> None:
    until = time.monotonic() + seconds
    while is_alive(pid):
        assert time.monotonic() < until, f"process {pid} lives on"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return open_source("course:perceptions", SHORT).recording


@pytest.fixture(scope="module")
def in_process(recording: Recording) -> RunResult:
    result = ran(recording)
    assert any(event.startswith(results.LOOP_CLOSED) for event in result.events)
    return result


def test_it_is_the_graph_of_one_process_to_the_last_bit_and_corrects_the_pose_in_time(
    recording: Recording, in_process: RunResult
) -> None:
    result = ran_online(recording, kept_up)
    assert is_same(in_process, result)
    assert result.events[: len(in_process.events)] == in_process.events
    online = result.online
    assert online is not None
    assert (online.lost, online.num_restarts) == ("", 0)
    assert online.trajectory.stamps_ns.tolist() == result.fast.stamps_ns.tolist()
    # With each scan at most that scan itself is not in the graph yet.
    assert set(online.lags.tolist()) <= {0, 1}
    last = online.trajectory.pose(-1).between(result.smoothed.pose(-1))
    assert np.hypot(last.x, last.y) < 0.05


def test_killed_at_work_it_comes_to_the_same_bits(
    recording: Recording, in_process: RunResult
) -> None:
    def kill(graph: OnlineSmoother, scan: int) -> None:
        if scan in (60, 140) and graph.worker_pid is not None:
            os.kill(graph.worker_pid, signal.SIGKILL)
        elif scan in (59, 139):
            # It is at work, not still starting.
            kept_up(graph)

    result = ran_online(recording, kill)
    assert is_same(in_process, result)
    assert result.online is not None
    assert (result.online.num_restarts, result.online.lost) == (2, "")
    assert sum("SIGKILL" in event for event in result.events) == 2


def test_hung_it_is_started_anew_and_no_scan_has_waited_for_it(
    recording: Recording, in_process: RunResult
) -> None:
    seconds, stopped = [], []
    before = time.monotonic()

    def stop(graph: OnlineSmoother, scan: int) -> None:
        nonlocal before
        seconds.append(time.monotonic() - before)
        if scan == 20 and graph.worker_pid is not None:
            stopped.append(graph.worker_pid)
            os.kill(stopped[0], signal.SIGSTOP)
        before = time.monotonic()

    result = ran_online(recording, stop, stall_s=7.0, max_restarts=10)
    assert is_same(in_process, result)
    assert any("no sign of life for 7 s" in event for event in result.events)
    assert not is_alive(stopped[0])
    assert max(seconds) < 3.0


def test_given_up_the_run_goes_on_and_the_results_say_what_is_lost(
    recording: Recording, tmp_path: Path
) -> None:
    def kill(graph: OnlineSmoother, scan: int) -> None:
        if scan % 20 == 10 and graph.worker_pid is not None:
            os.kill(graph.worker_pid, signal.SIGKILL)
            time.sleep(0.05)

    result = ran_online(recording, kill, max_restarts=2)
    results.write(result, tmp_path / "out")
    again = results.read(tmp_path / "out")
    for each in (result, again):
        assert each.online is not None
        assert "SIGKILL, after 2 restarts" in each.online.lost
        assert each.online.num_restarts == 2
        assert (len(each.smoothed), each.landmarks) == (0, ())
        assert len(each.fast) == len(each.online.trajectory) == recording.num_scans
        assert any("given up at scan" in event for event in each.events)


def test_what_the_graph_refuses_is_not_tried_again(recording: Recording) -> None:
    seen = next(moments(recording, Perceiver(recording, SETTINGS), YawRateLog())).perceptions
    step = FastEstimator(SETTINGS.tracker, Pose2()).step(seen, None)
    singular = replace(step, motion=UncertainPose2(Pose2(), np.zeros((3, 3))))
    with OnlineSmoother(SETTINGS.smoother, SETTINGS.online, Pose2()) as graph:
        graph.add(singular, seen, ())
        online = graph.finish(Silence().note).online
    assert online is not None
    assert online.num_restarts == 0
    assert "motion" in online.lost


def test_what_fails_unforeseen_is_tried_again_but_not_for_ever(recording: Recording) -> None:
    seen = next(moments(recording, Perceiver(recording, SETTINGS), YawRateLog())).perceptions
    step = FastEstimator(SETTINGS.tracker, Pose2()).step(seen, None)
    with OnlineSmoother(SETTINGS.smoother, OnlineSettings(max_restarts=1), Pose2()) as graph:
        graph.add(step, None, ())  # type: ignore[arg-type]
        outcome = graph.finish(Silence().note)
    assert outcome.online is not None
    assert outcome.online.num_restarts == 1
    assert "AttributeError" in outcome.online.lost
    assert "no correction came" in outcome.events[-1]


def test_without_a_place_for_the_spool_it_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(SemgraphError, match=r"nowhere.*TMPDIR"):
        OnlineSmoother(SETTINGS.smoother, SETTINGS.online, Pose2())


def test_nothing_is_left_of_it(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    open_files = len(list(Path("/proc/self/fd").iterdir()))
    pids = []
    with OnlineSmoother(SETTINGS.smoother, SETTINGS.online, Pose2()) as graph:
        result = ran(recording, Acting(graph, lambda graph, _: pids.append(graph.worker_pid)))
    assert len(result.smoothed) == recording.num_scans
    assert list(tmp_path.iterdir()) == []
    assert all(pid is not None and not is_alive(pid) for pid in set(pids))
    # The tracker of multiprocessing's resources, one for all, may have come.
    assert len(list(Path("/proc/self/fd").iterdir())) <= open_files + 1


_PARENT = """
import sys, time
from evaluation.benches.bench_online import Drive
from semgraph.beside.online import OnlineSmoother
from semgraph.settings import Settings

class Telling:
    def __init__(self, graph, at):
        self.graph, self.at, self.num_scans = graph, at, 0

    def add(self, *scan):
        self.graph.add(*scan)
        self.num_scans += 1
        if self.num_scans == self.at:
            print(self.graph.worker_pid, self.graph.num_behind, flush=True)
            time.sleep(60.0)

if __name__ == "__main__":
    drive = Drive("course:perceptions", {}, float(sys.argv[1]))
    recording = drive.recording(1)
    settings = Settings()
    with OnlineSmoother(settings.smoother, settings.online, recording.map_T_start) as graph:
        drive.played(recording, Telling(graph, int(sys.argv[2])))
"""


@pytest.mark.parametrize(("speed", "num_scans", "wait_s"), [("inf", 150, 0.0), ("10", 50, 1.0)])
def test_it_ends_with_its_parent_with_work_left_as_when_idle(
    tmp_path: Path, speed: str, num_scans: int, wait_s: float
) -> None:
    script = tmp_path / "parent.py"
    script.write_text(_PARENT)
    command = [sys.executable, str(script), speed, str(num_scans)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid, num_behind = map(int, parent.stdout.readline().split())
        assert num_behind > 1 or wait_s
        time.sleep(wait_s)
        assert is_alive(pid)
        parent.kill()
    wait_until_dead(pid)


def test_an_interrupt_ends_both_with_one_line(tmp_path: Path) -> None:
    # What is started in the background is told to ignore interrupts, and so would this run be.
    heeding = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from semgraph.cli import main; sys.exit(main())"
    )
    command = [sys.executable, "-c", heeding, "run", "course:perceptions", "--online"]
    with subprocess.Popen(
        [*command, "--speed", "0.5"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        # The first line of the progress: the run goes on, the graph's process too.
        assert "scans" in process.stdout.readline()
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60.0)
        assert process.returncode == 130
        assert errors == "semgraph: interrupted; nothing was written\n"
    assert list(tmp_path.iterdir()) == []


def test_a_correction_moves_map_T_odom_and_not_odom() -> None:
    map_T_odom, odom_T_base = Pose2(1.0, -2.0, 0.3), Pose2(5.0, 1.0, -0.4)
    taken = Taken(7, map_T_odom @ odom_T_base, odom_T_base)
    np.testing.assert_allclose(taken.map_T_odom.as_array(), map_T_odom.as_array(), atol=1e-12)
