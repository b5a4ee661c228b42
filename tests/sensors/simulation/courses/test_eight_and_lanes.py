"""A figure of eight in a stem map, and lanes whose perceptions are made when asked for."""

from pathlib import Path

import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.landmarks import Perceptions
from sensors.catalog import open_source
from sensors.recorded import Recorded
from sensors.truth import Source, TrueLandmarks, TruePath
from tests.sensors.sources import check_recording

LANES: dict[str, object] = {"seed": 1, "length_m": 300.0, "scan_rate_hz": 5.0}


@pytest.fixture
def stem_map(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    rows = [f"{x:.2f},{y:.2f},30" for x, y in rng.uniform(0.0, 60.0, (200, 2))]
    file = tmp_path / "stand.csv"
    file.write_text("\n".join(["x,y,mark", "0,0,30", "60,60,30", *rows]) + "\n")
    return file


def known(source: Source) -> tuple[TruePath, TrueLandmarks]:
    assert source.truth.path is not None
    assert source.truth.landmarks is not None
    return source.truth.path, source.truth.landmarks


def test_an_eight_fills_the_stand_crosses_itself_and_touches_no_tree(stem_map: Path) -> None:
    source = open_source("course:eight", {"seed": 3, "stem_map": stem_map, "length_m": 300.0})
    check_recording(source.recording)
    path, trees = known(source)
    steps_m = np.linalg.norm(np.diff(path.world_t_reference, axis=0), axis=1)
    assert steps_m.sum() == pytest.approx(300.0, rel=0.01)
    assert np.abs(path.world_t_reference).max(axis=0) == pytest.approx([22.0, 22.0], abs=0.5)
    gaps_m = np.linalg.norm(
        path.world_t_reference[:, None] - trees.world_t_landmarks[None], axis=2
    ) - (0.5 * trees.diameters_m)
    assert gaps_m.min() > 0.9
    assert 100 < len(trees.kinds) < 202
    turns = np.unwrap(path.headings if path.headings is not None else [])
    assert np.ptp(turns) > np.pi
    other = open_source("course:eight", {"seed": 4, "stem_map": stem_map, "length_m": 300.0})
    apart_m = np.linalg.norm(known(other)[0].world_t_reference[0] - path.world_t_reference[0])
    assert apart_m > 1.0


def test_an_eight_needs_a_stem_map_that_is_large_enough(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="stem_map=FILE"):
        open_source("course:eight", {})
    with pytest.raises(InputError, match="there is none"):
        open_source("course:eight", {"stem_map": tmp_path / "none.csv"})
    small = tmp_path / "small.csv"
    small.write_text("x,y,mark\n0,0,30\n30,30,30\n")
    with pytest.raises(InputError, match="36 m by 36 m"):
        open_source("course:eight", {"stem_map": small})


def test_lanes_go_there_and_back_without_a_jump() -> None:
    source = open_source("course:lanes", LANES)
    check_recording(source.recording)
    path, trees = known(source)
    assert path.headings is not None
    steps = np.diff(path.world_t_reference, axis=0)
    assert np.linalg.norm(steps, axis=1) == pytest.approx(0.4, abs=0.01)
    ahead = np.column_stack([np.cos(path.headings[:-1]), np.sin(path.headings[:-1])])
    assert (np.sum(steps * ahead, axis=1) > 0.39).all()
    assert len(trees.kinds) == 300
    turned = np.abs(np.diff(path.headings)).sum()
    assert turned > 2 * np.pi
    seen = np.array([len(m) for m in source.recording.measurements if isinstance(m, Perceptions)])
    assert 8.0 < seen.mean() < 16.0


def test_perceptions_on_lanes_are_of_the_trees_and_made_only_when_asked_for() -> None:
    source = open_source("course:lanes", {**LANES, "missed": 0.0})
    assert isinstance(source.recording.measurements, Recorded)
    assert not any(isinstance(m, Perceptions) for m in source.recording.measurements.samples)
    path, trees = known(source)
    assert path.headings is not None
    scan = source.recording.measurements.measure(50)
    assert isinstance(scan, Perceptions)
    turn = path.headings[50]
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    places = scan.base_t_landmarks() @ R.T + path.world_t_reference[50]
    gaps_m = np.linalg.norm(places[:, None] - trees.world_t_landmarks[None], axis=2).min(axis=1)
    assert len(scan) > 5
    assert gaps_m.max() < 0.3


def test_lanes_refuse_what_they_lack() -> None:
    with pytest.raises(InputError, match="num_blind"):
        open_source("course:lanes", {"num_blind": 1})
