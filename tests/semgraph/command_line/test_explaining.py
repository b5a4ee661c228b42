"""The decisions of a run come back from their file, and are told as stories."""

from pathlib import Path

import numpy as np
import pytest

from semgraph.command_line.explaining import explain
from semgraph.decisions import Decision, What
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.files.decision_files import read_decisions, write_decisions
from semgraph.landmarks import Kind, Landmark, Tree
from semgraph.results import RunResult

DECISIONS = (
    Decision(3, What.RESUMED, Kind.TREE, 8, 7, 6.5, "unseen for 20 scans"),
    Decision(5, What.LOOP_CLOSED, Kind.TREE, 7, 2, 9.25, "unseen for 300 scans"),
    Decision(6, What.MOVING, Kind.TREE, 9, why="first sighted at scan 4"),
    Decision(8, What.TAKEN_BACK, Kind.TREE, 7, 2, -40.0, "taken for one with log odds 9.2"),
    Decision(9, What.GONE, Kind.ROCK, 4, why="last sighted at scan 1; 4 looks in vain"),
)


def result() -> RunResult:
    poses = Trajectory(np.arange(10) * 10**9, np.zeros((10, 3)))
    return RunResult(
        name="some run",
        smoothed=poses,
        smoothed_covariances=np.tile(np.eye(3), (10, 1, 1)),
        fast=poses,
        landmarks=(Landmark(2, Tree(), np.array([1.0, 2.0]), np.eye(2), 5, 0.9),),
        fast_seconds=np.zeros(10),
        wall_seconds=1.0,
        num_scans=10,
        decisions=DECISIONS,
    )


def test_they_come_back_from_their_file(tmp_path: Path) -> None:
    file = tmp_path / "decisions.csv"
    write_decisions(file, DECISIONS)
    assert [str(each) for each in read_decisions(file)] == [str(each) for each in DECISIONS]


@pytest.mark.parametrize(
    "row",
    [
        "x,1,2,0.0,moving,tree,",
        "1,1,2,0.0,flying,tree,",
        "1,1,2,0.0,moving,bush,",
        "nan,1,2,0.0,moving,tree,",
        "inf,1,2,0.0,moving,tree,",
        "1,2,0.0,moving,tree,",
    ],
)
def test_a_damaged_row_is_refused_with_its_line(tmp_path: Path, row: str) -> None:
    file = tmp_path / "decisions.csv"
    write_decisions(file, DECISIONS[:1])
    file.write_text(file.read_text() + row + "\n")
    with pytest.raises(InputError, match="line 3"):
        read_decisions(file)


def test_a_run_is_told_in_order_with_counts_first() -> None:
    lines = list(explain(result()))
    assert "loop closed: 1" in lines
    assert sum("at scan" in line for line in lines) == len(DECISIONS)
    assert "    5.0 s  loop closed at scan 5: tree 7 is 2, unseen for 300 scans" in lines[-4]


def test_the_story_of_a_landmark_holds_what_became_it() -> None:
    lines = list(explain(result(), 2))
    assert lines[0].startswith("tree 2 at (1.00, 2.00) m: 5 sightings")
    told = "\n".join(lines[1:])
    assert "tree 8 is 7" in told
    assert "tree 7 is 2" in told
    assert "tree 7 is not 2" in told
    assert "rock" not in told


def test_of_what_never_was_nothing_is_told() -> None:
    with pytest.raises(InputError, match="landmark 77"):
        list(explain(result(), 77))
