"""Many hypotheses followed several times."""

import numpy as np
import pytest

from semgraph.beside.graph_beside import GraphInProcess
from semgraph.errors import GraphError
from semgraph.files.run_log import LogRecorder, RunLog
from semgraph.offline.resighting import Resighted, resighted
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.settings import Settings, TrackerSettings
from semgraph.smoothed import Smoothed
from semgraph.tracking import tracker_of
from semgraph.tries import Tries
from sensors.catalog import open_source
from sensors.measurements import OdometryNoise, Recording
from tests.semgraph.test_hypotheses import START, drive

MARKS = Recording("marks", (), 0, OdometryNoise(), map_T_start=START, num_hypotheses=60)


def ran(settings: Settings) -> tuple[Tries, Smoothed, RunLog]:
    tries, tracker = Tries(MARKS, settings), tracker_of(MARKS, settings.tracker)
    graph = GraphInProcess(settings.smoother, START)
    recorder = LogRecorder(settings.smoother.start(START))
    for seen, odometry in drive()[0]:
        step = tracker.step(seen, odometry)
        graph.add(step, seen, ())
        recorder.add(step, seen, ())
        tries.add(seen, odometry, ())
    smoothed = graph.finish(lambda _: None)
    return tries, smoothed, recorder.log(smoothed.trajectory, smoothed.associations)


def with_tries(tries: int, seed: int = 0) -> Settings:
    return Settings(tracker=TrackerSettings(tries=tries, seed=seed))


def test_the_most_probable_of_several_is_kept() -> None:
    misfits = []
    for seed in range(3):
        _, _, log = ran(with_tries(1, seed))
        misfits.append(resighted(log, Settings().smoother, lambda _: None).misfit)
    notes: list[str] = []
    tries, smoothed, log = ran(with_tries(3))
    best, its_log = tries.best(smoothed, log, notes.append)
    number = int(np.argmin(misfits)) + 1
    assert best.events[-1] == f"try {number} of 3 is the most probable"
    beginnings = [note.split(", ")[:2] for note in notes if note.startswith("try ")]
    assert ["try 2 of 3", "0%"] in beginnings
    assert ["try 3 of 3", "0%"] in beginnings
    assert all(note.endswith(" s left") for note in notes if note.startswith("try "))
    assert len(its_log.landmarks) == len(log.landmarks)


def test_path_map_and_associations_belong_together() -> None:
    tries, smoothed, log = ran(with_tries(1))
    best, its_log = tries.best(smoothed, log, lambda _: None)
    assert np.array_equal(np.concatenate(list(best.associations.values())), its_log.landmarks)
    assert np.array_equal(best.trajectory.map_T_bases, its_log.trajectory.map_T_bases)
    assert best.covariances.shape == (len(best.trajectory), 3, 3)
    assert {each.id for each in best.landmarks} <= set(its_log.landmarks.tolist())
    assert all("most probable" not in event for event in best.events)


def test_a_try_that_comes_to_nothing_is_said_and_loses_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tries, smoothed, log = ran(with_tries(2))
    monkeypatch.setattr("semgraph.tries.resighted", unsolvable)
    best, its_log = tries.best(smoothed, log, lambda _: None)
    said = [f"try {number} of 2 came to nothing: singular" for number in (1, 2)]
    assert best.events == (*smoothed.events, *said)
    assert best.trajectory is smoothed.trajectory
    assert its_log is log


def unsolvable(*_: object) -> Resighted:
    raise GraphError("singular")


@pytest.mark.parametrize(("num_trees", "seed"), [(2, 9), (1, 7)])
def test_where_the_pose_is_unsure_by_metres_the_map_stays(num_trees: int, seed: int) -> None:
    """To take all perceptions for nothing costs 330 and 700, as -2 ln, the map 40 and 140."""
    options = {"lap_s": 20.0, "seed": seed, "num_trees": num_trees, "odometry": True}
    recording = open_source("course:perceptions", options).recording
    settings = Settings(tracker=TrackerSettings(hypotheses=30, tries=1))
    result = run(recording, settings, Perceiver(recording, settings), Silence(), {})
    assert len(result.landmarks) == num_trees


def test_with_one_hypothesis_all_stays_as_it_is() -> None:
    settings = Settings(tracker=TrackerSettings(hypotheses=1))
    tries, smoothed, log = ran(settings)
    assert tries.best(smoothed, log, lambda _: None) == (smoothed, log)
