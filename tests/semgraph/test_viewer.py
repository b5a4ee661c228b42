import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from semgraph import viewer
from semgraph.errors import InputError, SemgraphError
from semgraph.estimates import Trajectory
from semgraph.landmarks import Kind, Landmark, semantic_object
from semgraph.results import RunResult
from semgraph.viewer import open_viewer, write_recording
from tests.semgraph.rerun_files import Columns, array, read_back

START_NS = 1_600_000_000_123_456_789
NOTHING = Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)))


def circle(n: int, radius_m: float, first_ns: int) -> Trajectory:
    angles = np.linspace(0.0, 3.0, n)
    positions = radius_m * np.column_stack([np.cos(angles), np.sin(angles)])
    stamps_ns = first_ns + 40_000_001 * np.arange(n)
    return Trajectory(stamps_ns, np.column_stack([positions, angles]))


def landmark(number: int, kind: Kind, x: float, diameter_m: float = np.nan) -> Landmark:
    semantics = semantic_object(kind, diameter_m, 0.02)
    return Landmark(number, semantics, np.array([x, 2.0]), np.diag([0.04, 0.01]), 9, 0.9)


def example() -> RunResult:
    return RunResult(
        name="a course",
        smoothed=circle(40, 10.0, START_NS + 40_000_001),
        smoothed_covariances=np.full((40, 3, 3), np.nan),
        fast=circle(50, 10.5, START_NS),
        landmarks=(
            landmark(3, Kind.TREE, 1.0, 0.4),
            landmark(4, Kind.TREE, -7.0),
            landmark(5, Kind.ROCK, 5.0, 0.6),
            landmark(6, Kind.MARKER, 8.0),
        ),
        fast_seconds=np.zeros(50),
        wall_seconds=1.0,
        num_scans=50,
        events=("loop closed at scan 20: tree 3 is 1", "update failed, graph rebuilt: singular"),
    )


def written(result: RunResult, folder: Path) -> Columns:
    write_recording(result, folder / "run.rrd")
    return read_back(folder / "run.rrd")


def test_a_run_has_its_entities_and_no_others(tmp_path: Path) -> None:
    entities = written(example(), tmp_path)
    assert set(entities) == {
        "/__properties",
        "/events",
        "/map",
        *(f"/map/{name}/{part}" for name in ("smoothed", "fast") for part in ("path", "robot")),
        *(f"/map/{kind.label}s/{part}" for kind in Kind for part in ("positions", "ellipses")),
        "/map/trees/bodies",
        "/map/rocks/bodies",
    }
    assert entities["/__properties"]["name"] == [["a course"]]


@pytest.mark.parametrize(("name", "num_poses"), [("smoothed", 40), ("fast", 50)])
def test_the_robot_moves_along_its_whole_path(tmp_path: Path, name: str, num_poses: int) -> None:
    result = example()
    trajectory = {"smoothed": result.smoothed, "fast": result.fast}[name]
    entities = written(result, tmp_path)
    robot, path = entities[f"/map/{name}/robot"], entities[f"/map/{name}/path"]
    moving = [k for k, value in enumerate(robot["translation"]) if value is not None]
    assert len(moving) == num_poses
    positions = array(robot["translation"])[:, 0]
    np.testing.assert_allclose(positions[:, :2], trajectory.map_T_bases[:, :2], atol=1e-6)
    np.testing.assert_allclose(array(path["strips"])[0, 0], positions)
    x, y, z, w = array(robot["quaternion"])[:, 0].T
    assert not x.any()
    assert not y.any()
    np.testing.assert_allclose(2.0 * np.arctan2(z, w), trajectory.map_T_bases[:, 2], atol=1e-6)
    np.testing.assert_array_equal(robot["time"], trajectory.stamps_ns - START_NS)


def test_landmarks_have_their_place_label_and_colour(tmp_path: Path) -> None:
    entities = written(example(), tmp_path)
    trees = entities["/map/trees/positions"]
    np.testing.assert_allclose(array(trees["positions"])[0], [[1.0, 2.0, 0.0], [-7.0, 2.0, 0.0]])
    assert trees["labels"] == [["3: 9 sightings", "4: 9 sightings"]]
    assert entities["/map/markers/positions"]["labels"] == [["6: 9 sightings"]]
    colors = {str(entities[f"/map/{kind.label}s/positions"]["colors"]) for kind in Kind}
    assert len(colors) == len(Kind)


@pytest.mark.parametrize("turn", [0.0, 0.3, -1.2])
def test_ellipses_are_where_the_chi_square_reaches_95_percent(tmp_path: Path, turn: float) -> None:
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = replace(landmark(0, Kind.ROCK, 3.0), covariance=R @ np.diag([0.25, 0.01]) @ R.T)
    result = replace(example(), landmarks=(turned,))
    (outline,) = array(written(result, tmp_path)["/map/rocks/ellipses"]["strips"])[0]
    offsets = outline[:, :2] - turned.map_t_landmark
    squared = np.einsum("ki,ij,kj->k", offsets, np.linalg.inv(turned.covariance), offsets)
    np.testing.assert_allclose(squared, -2.0 * np.log(0.05), rtol=1e-3)
    np.testing.assert_allclose(outline[0], outline[-1], atol=1e-6)
    assert not outline[:, 2].any()


def test_known_diameters_have_bodies(tmp_path: Path) -> None:
    entities = written(example(), tmp_path)
    trunk, rock = entities["/map/trees/bodies"], entities["/map/rocks/bodies"]
    np.testing.assert_allclose(array(trunk["radii"]), [[0.2]])
    np.testing.assert_allclose(array(rock["half_sizes"]), [[[0.3, 0.3, 0.3]]])
    assert array(trunk["centers"])[0, 0, 2] == pytest.approx(0.5 * array(trunk["lengths"])[0, 0])
    assert array(rock["centers"])[0, 0, 2] == pytest.approx(0.3)


def test_events_stand_at_the_scan_they_name_or_at_the_end(tmp_path: Path) -> None:
    result = example()
    events = written(result, tmp_path)["/events"]
    assert events["text"] == [[event] for event in result.events]
    assert events["time"] == [20 * 40_000_001, 49 * 40_000_001]


def test_the_map_is_seen_from_above(tmp_path: Path) -> None:
    write_recording(example(), tmp_path / "run.rrd")
    entities = read_back(tmp_path / "run.rrd", blueprint=True)
    (eye,) = (columns for columns in entities.values() if "look_target" in columns)
    (position,), (target,) = array(eye["position"])[0], array(eye["look_target"])[0]
    np.testing.assert_allclose(position[:2], target[:2])
    assert position[2] > 10.0
    np.testing.assert_allclose(array(eye["eye_up"])[0, 0], [0.0, 1.0, 0.0])


def test_two_runs_of_one_recording_stay_two(tmp_path: Path) -> None:
    import rerun as rr

    for name in ("a.rrd", "b.rrd"):
        write_recording(example(), tmp_path / name)
    stores = [rr.chunk.RrdReader(str(tmp_path / n)).recordings()[0] for n in ("a.rrd", "b.rrd")]
    assert stores[0].recording_id != stores[1].recording_id


def test_an_empty_run_is_written(tmp_path: Path) -> None:
    empty = RunResult("", NOTHING, np.empty((0, 3, 3)), NOTHING, (), np.empty(0), 0.0, 0)
    assert set(written(empty, tmp_path)) == {"/__properties", "/map"}
    told = written(replace(empty, events=("nothing",)), tmp_path)
    assert told["/events"]["text"] == [["nothing"]]


def test_texts_that_utf_8_cannot_carry_are_escaped(tmp_path: Path) -> None:
    entities = written(replace(example(), name="\udcff", events=("\ud800 lost",)), tmp_path)
    assert entities["/__properties"]["name"] == [["\\udcff"]]
    assert entities["/events"]["text"] == [["\\ud800 lost"]]


@pytest.mark.parametrize("place", ["missing/run.rrd", "."])
def test_an_unwritable_place_is_refused_in_one_line(tmp_path: Path, place: str) -> None:
    with pytest.raises(SemgraphError, match="cannot be written: ") as caught:
        write_recording(example(), tmp_path / place)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_disk_is_refused_in_one_line() -> None:
    with pytest.raises(SemgraphError, match="No space left") as caught:
        write_recording(example(), Path("/dev/full"))
    assert "\n" not in str(caught.value)


def test_numbers_beyond_rerun_are_refused(tmp_path: Path) -> None:
    far = Trajectory(np.array([0, 1]), np.array([[0.0, 0.0, 0.0], [1e300, 0.0, 0.0]]))
    with pytest.raises(SemgraphError, match=r"cannot be written: .*overflow"):
        write_recording(replace(example(), fast=far), tmp_path / "run.rrd")


@pytest.mark.parametrize(
    ("name", "wrong", "reason"),
    [
        ("LINE_WIDTH", "thick", "could not convert"),
        ("_since_start", lambda *_: np.arange(3), "same length"),
    ],
)
def test_what_rerun_only_warns_of_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, wrong: object, reason: str
) -> None:
    monkeypatch.setattr(viewer, name, wrong)
    with pytest.raises(SemgraphError, match=f"cannot be written: .*{reason}"):
        write_recording(example(), tmp_path / "run.rrd")


def test_the_viewer_module_does_not_load_rerun() -> None:
    program = "import sys, semgraph.viewer; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


class Launcher:
    """Stands for subprocess.run: keeps the commands, gives back what a viewer would."""

    def __init__(self, *returncodes: int) -> None:
        self.commands: list[list[str]] = []
        self._returncodes = iter(returncodes)

    def __call__(self, command: list[str], **options: bool) -> subprocess.CompletedProcess[bytes]:
        assert options == {"capture_output": True, "check": False}
        self.commands.append(command)
        return subprocess.CompletedProcess(
            command, next(self._returncodes), b"", b"INFO chatter\nError: no graphics \xff\n"
        )


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DISPLAY", ":0")
    path = tmp_path / "a run.rrd"
    path.write_bytes(b"RRF2")
    return path


def test_the_viewer_listens_on_loopback(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    launcher = Launcher(0)
    monkeypatch.setattr(subprocess, "run", launcher)
    open_viewer(recording)
    (show,) = (command[3:] for command in launcher.commands)
    assert show == ["--bind", "127.0.0.1", "--port", "auto", str(recording)]
    assert all(command[:3] == [sys.executable, "-m", "rerun"] for command in launcher.commands)


def test_a_viewer_that_fails_is_told_with_its_last_words(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subprocess, "run", Launcher(1))
    with pytest.raises(
        SemgraphError, match=r"Error: no graphics .*; view it in a browser"
    ) as caught:
        open_viewer(recording)
    assert "\n" not in str(caught.value)


def test_a_missing_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.rrd: expected the recording of a run"):
        open_viewer(tmp_path / "none.rrd")


def test_without_a_viewer_it_says_how_to_get_one(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", {}.get)
    with pytest.raises(SemgraphError, match="pip install rerun-sdk"):
        open_viewer(recording)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_without_a_display_it_says_how_to_view(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    launcher = Launcher()
    monkeypatch.setattr(subprocess, "run", launcher)
    with pytest.raises(
        SemgraphError, match=r"rerun --serve-web --bind 127\.0\.0\.1 '.*a run\.rrd'"
    ):
        open_viewer(recording)
    assert not launcher.commands
