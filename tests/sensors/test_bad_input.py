"""Hostile files: whatever is in them, a reader reads or says one line, and soon."""

import gzip
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from semgraph.errors import InputError
from sensors.catalog import open_source
from sensors.plain_writing import write
from tests.sensors.sources import write_text
from tests.sensors.test_mrclam import FILES as MRCLAM_FILES
from tests.sensors.test_plain_folder import HEADER, LASER, PERCEPTIONS, npz
from tests.sensors.test_victoria_park_graph import GRAPH

SECONDS_FOR_ONE_FILE = 5.0
NUM_MUTANTS = 120


def plain(folder: Path) -> None:
    write_text(folder, "recording.toml", HEADER + "[vehicle]\nalong_per_sqrt_m = 0.1\n" + LASER)
    write_text(folder, "perceptions.csv", PERCEPTIONS)
    write_text(folder, "odometry.csv", "stamp_s,x_m,y_m,yaw_rad\n0,0,0,0\n2,1,0,0.5\n9,1,2,0.5\n")
    write_text(folder, "gnss.csv", "stamp_s,x_m,y_m,sigma_m\n0,0,0,0.5\n2,1,0,0.5\n")
    write_text(folder, "imu.csv", "stamp_s,yaw_rate_rad_s\n0,0.1\n2,-0.1\n")
    write_text(folder, "truth.tum", "# t x y z q\n0 0 0 0 0 0 0 1\n2 1 0 0 0 0 1 0\n")
    write_text(folder, "truth_landmarks.csv", "x_m,y_m,kind,diameter_m\n1,2,tree,0.4\n3,4,rock,\n")
    ranges_m = np.array([[1.0, np.inf, 3.0], [1.0, 2.0, np.nan]])
    content = npz(stamp_s=np.array([1.5, 3.0]), ranges_m=ranges_m, intensities=np.ones((2, 3)))
    (folder / "scans.npz").write_bytes(content)


def mrclam(folder: Path) -> None:
    for name, text in MRCLAM_FILES.items():
        write_text(folder, name, text)
    file = folder / "Robot1_Odometry.dat"
    (folder / "Robot1_Odometry.dat.gz").write_bytes(gzip.compress(file.read_bytes()))
    file.unlink()


def graph(folder: Path) -> None:
    write_text(folder, "victoria_park.txt", GRAPH)


def wild_places(folder: Path) -> None:
    poses = "5.0,1,2,3,0,0,0,1\n8.0,1,2,3,0,0,1,0\n"
    write_text(folder, "trajectory.csv", "t,x,y,z,qx,qy,qz,qw\n" + poses)
    write_text(folder, "trees.csv", "frame,x,y,z,dbh\n0,3,4,1,0.3\n1,3,4,1,\n")


def car_park(folder: Path, *, compress: bool = True) -> None:
    arrays = {
        "Laser": np.full((2, 361), 5.0),
        "Intensity": np.zeros((2, 361), dtype=np.uint16),
        "TimeLaser": np.array([1.0, 1.2]),
        "Time_VS": np.array([0.9, 1.1, 1.3]),
        "Velocity": np.ones(3),
        "Steering": np.full(3, 0.1),
        "TimeGPS": np.array([1.0, 1.2]),
        "GPSLon": np.zeros(2),
        "GPSLat": np.zeros(2),
    }
    savemat(folder / "data_set.mat", arrays, do_compression=compress)
    savemat(folder / "beac_juan3.mat", {"estbeac": np.ones((3, 2))}, do_compression=compress)


def car_park_unpacked(folder: Path) -> None:
    car_park(folder, compress=False)


def victoria_park(folder: Path) -> None:
    cells = np.empty((1, 2), dtype=object)
    cells[0, 0], cells[0, 1] = np.array([[5.0, 6.0], [1.0, 2.0], [0.3, 0.4]]), np.zeros((0, 0))
    times = {"TLsr": np.array([1.0, 1.2]), "time": np.array([0.9, 1.3])}
    arrays = {"zt": cells, "u": np.array([[1.0, 1.0], [0.1, 0.1]]), **times}
    savemat(folder / "VictoriaParkSinSincronizar.mat", arrays)
    fixes = {"timeGps": np.array([[900], [1200]], dtype=np.int32)}
    savemat(folder / "aa3_gpsx.mat", {**fixes, "Lo_m": np.zeros((2, 1)), "La_m": np.ones((2, 1))})


FOLDERS: list[Callable[[Path], None]] = [
    plain,
    mrclam,
    graph,
    wild_places,
    car_park,
    car_park_unpacked,
    victoria_park,
]
TOKENS = [b"nan", b"-inf", b"1e999", b"-1", b"", b"0", b'"', b"\n", b",", b"\0", b"\xff\xfe", b"["]


def mutant(rng: np.random.Generator, content: bytes) -> bytes:
    """The content with one fault: cut, flipped, overwritten, doubled, or with a token put in."""
    at, end = np.sort(rng.integers(0, len(content) + 1, size=2))
    fault = rng.integers(0, 6)
    if fault == 0:
        return content[:at]
    if fault == 1:
        flipped = np.frombuffer(content, dtype=np.uint8).copy()
        where = rng.integers(0, len(flipped), size=rng.integers(1, 4))
        flipped[where] ^= rng.integers(1, 256, size=len(where), dtype=np.uint8)
        return flipped.tobytes()
    if fault == 2:
        return content[:at] + content[end:]
    if fault == 3:
        return content[:end] + content[at:]
    token = TOKENS[rng.integers(0, len(TOKENS))]
    width = len(token) if fault == 4 else int(rng.integers(0, 4))
    return content[:at] + token + content[at + width :]


def reads_or_says_one_line(folder: Path) -> bool:
    """Whether the folder could be read; anything but a source or one line fails the test."""
    start = time.monotonic()
    refusal = ""
    try:
        tuple(open_source(str(folder), {}).recording.measurements)
    except InputError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert not refusal or str(folder) in refusal
    assert time.monotonic() - start < SECONDS_FOR_ONE_FILE
    return not refusal


@pytest.mark.parametrize("fill", FOLDERS)
def test_mutated_files_are_read_or_refused(tmp_path: Path, fill: Callable[[Path], None]) -> None:
    fill(tmp_path)
    assert reads_or_says_one_line(tmp_path)
    rng = np.random.default_rng(2)
    files = sorted(tmp_path.iterdir())
    outcomes = []
    for _ in range(NUM_MUTANTS):
        file = files[rng.integers(0, len(files))]
        content = file.read_bytes()
        file.write_bytes(mutant(rng, content))
        outcomes.append(reads_or_says_one_line(tmp_path))
        file.write_bytes(content)
    assert 0 < sum(outcomes) < NUM_MUTANTS


@pytest.mark.parametrize("fill", FOLDERS)
@pytest.mark.parametrize("content", [b"", b"\0" * 4096, b"\x7fELF" + bytes(range(256)) * 8])
def test_files_of_something_else_are_refused(
    tmp_path: Path, fill: Callable[[Path], None], content: bytes
) -> None:
    fill(tmp_path)
    optional = {"gnss.csv", "imu.csv", "truth.tum"}
    for file in sorted(tmp_path.iterdir()):
        kept = file.read_bytes()
        file.write_bytes(content)
        is_read = reads_or_says_one_line(tmp_path)
        assert not is_read or (not content and file.name in optional), file.name
        file.write_bytes(kept)


@pytest.mark.parametrize("fill", FOLDERS)
def test_what_is_no_file_is_refused(tmp_path: Path, fill: Callable[[Path], None]) -> None:
    fill(tmp_path)
    for file in sorted(tmp_path.iterdir()):
        kept = file.read_bytes()
        file.unlink()
        file.mkdir()
        assert not reads_or_says_one_line(tmp_path)
        file.rmdir()
        file.symlink_to(file)
        assert not reads_or_says_one_line(tmp_path)
        file.unlink()
        os.mkfifo(file)
        assert not reads_or_says_one_line(tmp_path)
        file.unlink()
        file.write_bytes(kept)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
@pytest.mark.parametrize("fill", FOLDERS)
def test_unreadable_files_are_refused(tmp_path: Path, fill: Callable[[Path], None]) -> None:
    fill(tmp_path)
    for file in sorted(tmp_path.iterdir()):
        file.chmod(0)
        assert not reads_or_says_one_line(tmp_path)
        file.chmod(0o644)
    tmp_path.chmod(0)
    assert not reads_or_says_one_line(tmp_path)
    tmp_path.chmod(0o755)


def test_a_gzip_bomb_is_refused_before_it_expands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mrclam(tmp_path)
    monkeypatch.setattr("sensors.text_table.MAX_TABLE_BYTES", 2**20)
    (tmp_path / "Robot1_Odometry.dat.gz").write_bytes(gzip.compress(b" " * 2**22))
    with pytest.raises(InputError, match=r"Robot1_Odometry\.dat\.gz: expected at most 1 MiB"):
        open_source(str(tmp_path), {})


def test_a_matlab_bomb_is_refused_before_it_expands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    car_park(tmp_path)
    monkeypatch.setattr("sensors.mat_files.MAX_EXPANDED_BYTES", 4096)
    with pytest.raises(InputError, match=r"data_set\.mat: expected at most .* when exp"):
        open_source(str(tmp_path), {})


def test_too_many_rows_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain(tmp_path)
    monkeypatch.setattr("sensors.text_table.MAX_ROWS", 2)
    with pytest.raises(InputError, match="expected at most 2 lines, got 4"):
        open_source(str(tmp_path), {})


@pytest.mark.parametrize("depth", [2, 50])
def test_cells_within_cells_are_refused(tmp_path: Path, depth: int) -> None:
    victoria_park(tmp_path)
    inner: object = np.ones(1)
    for _ in range(depth):
        outer = np.empty((1, 1), dtype=object)
        outer[0, 0] = inner
        inner = outer
    savemat(tmp_path / "VictoriaParkSinSincronizar.mat", {"zt": inner})
    with pytest.raises(InputError, match="expected real numbers, or cells of them"):
        open_source(str(tmp_path), {})


def test_every_small_folder_is_the_same_from_a_plain_one(tmp_path: Path) -> None:
    for fill in FOLDERS:
        folder = tmp_path / fill.__name__
        folder.mkdir()
        fill(folder)
        original = open_source(str(folder), {})
        write(original, tmp_path / f"{fill.__name__}-copy")
        copy = open_source(str(tmp_path / f"{fill.__name__}-copy"), {})
        assert copy.recording.num_scans == original.recording.num_scans
