"""Plain recording folders: written and read again, written by hand, and damaged."""

import io
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semgraph.errors import InputError, SemgraphError
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.dead_reckoning import in_order_of_time, with_odometry_at
from sensors.measurements import (
    GnssFix,
    ImuSample,
    LaserScan,
    OdometryNoise,
    Recording,
    ScannerGeometry,
    WheelOdometry,
)
from sensors.plain_folder import PlainOptions, read
from sensors.plain_writing import write
from sensors.truth import Source, TrueLandmarks, TruePath, Truth
from tests.sensors.sources import check_recording, opened, perceptions_of, same, write_text

HEADER = 'name = "by hand"\n'
PERCEPTIONS = (
    "stamp_s,kind,range_m,bearing_rad\n1.0,tree,5.0,0.5\n1.0,rock,6.0,-0.5\n2.5,tree,5,0\n"
)
LASER = """[laser]
angle_min_rad = -1.0
angle_increment_rad = 0.5
range_min_m = 0.1
range_max_m = 30.0
base_T_laser = [1.0, 0.5, 0.1]
"""

STAMPS_NS = st.integers(min_value=0, max_value=2**50)
COORDINATES = st.floats(min_value=-1e6, max_value=1e6)
SIGMAS = st.floats(min_value=1e-3, max_value=10.0)
NAMES = st.text(st.characters(codec="utf-8", categories=["L", "N", "P"]), max_size=8)


@st.composite
def perception_sets(draw: st.DrawFn) -> Perceptions:
    n = draw(st.integers(min_value=0, max_value=4))

    def column(values: st.SearchStrategy[float]) -> np.ndarray:
        return np.array(draw(st.lists(values, min_size=n, max_size=n)), dtype=np.float64)

    has_diameter = np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n)), dtype=np.bool_)
    return Perceptions.from_arrays(
        draw(STAMPS_NS),
        np.array(
            draw(st.lists(st.sampled_from([0, 1, 2]), min_size=n, max_size=n)), dtype=np.int64
        ),
        column(st.floats(min_value=0.01, max_value=1e3)),
        column(st.floats(min_value=-3.2, max_value=3.2)),
        polar_covariances(column(SIGMAS), column(SIGMAS)),
        diameters_m=np.where(has_diameter, column(SIGMAS), np.nan),
        diameter_sigmas_m=np.where(has_diameter, column(SIGMAS), np.nan),
        identities=np.array(draw(st.lists(NAMES, min_size=n, max_size=n)), dtype=np.str_),
        reliabilities=column(st.floats(min_value=0.0, max_value=1.0)),
    )


@st.composite
def laser_scans(draw: st.DrawFn, stamps: list[int]) -> list[LaserScan]:
    geometry = ScannerGeometry(-1.0, 0.1, 0.0, draw(st.floats(10.0, 90.0)), Pose2(1.0, 2.0, 0.5))
    ranges_m = st.one_of(st.floats(0.0, 80.0), st.sampled_from([np.inf, -np.inf, np.nan]))
    beams = st.lists(ranges_m, min_size=3, max_size=3)
    brightness = st.lists(st.floats(0.0, 255.0), min_size=3, max_size=3)
    has_intensities = draw(st.booleans())
    return [
        LaserScan(
            stamp_ns,
            geometry,
            np.array(draw(beams)),
            np.array(draw(brightness)) if has_intensities else None,
        )
        for stamp_ns in stamps
    ]


@st.composite
def sources(draw: st.DrawFn) -> Source:
    def stamps(min_size: int = 0) -> list[int]:
        return sorted(draw(st.lists(STAMPS_NS, unique=True, min_size=min_size, max_size=4)))

    def pose() -> Pose2:
        return Pose2(draw(COORDINATES), draw(COORDINATES), draw(st.floats(-3.1, 3.1)))

    sets = draw(st.lists(perception_sets(), max_size=3, unique_by=lambda p: p.stamp_ns))
    scans = draw(laser_scans(stamps(min_size=0 if sets else 1)))
    wheels = [WheelOdometry(stamp_ns, pose()) for stamp_ns in stamps()]
    at = np.unique([p.stamp_ns for p in sets] + [scan.stamp_ns for scan in scans])
    recording = Recording(
        name=draw(NAMES) or "unnamed",
        measurements=in_order_of_time(
            with_odometry_at(at, wheels),
            [ImuSample(stamp_ns, draw(st.floats(-9.0, 9.0))) for stamp_ns in stamps()],
            [
                GnssFix(stamp_ns, draw(COORDINATES), draw(COORDINATES), draw(SIGMAS))
                for stamp_ns in stamps()
            ],
            sets,
            scans,
        ),
        num_scans=len(sets) + len(scans),
        odometry_noise=OdometryNoise(draw(SIGMAS), draw(SIGMAS)) if wheels else None,
        detectors=draw(
            st.dictionaries(
                st.sampled_from(["reflectors", "trees-2d"]),
                st.dictionaries(st.sampled_from(["a", "b"]), SIGMAS),
                min_size=1,
            )
        ),
        map_T_start=pose(),
    )
    return Source(recording, draw(truths(stamps(min_size=1))))


@st.composite
def truths(draw: st.DrawFn, stamps: list[int]) -> Truth:
    n = len(stamps)
    positions = np.array([[draw(COORDINATES), draw(COORDINATES)] for _ in stamps])
    headings = [draw(st.floats(-3.1, 3.1)) for _ in stamps] if draw(st.booleans()) else None
    path = TruePath(
        np.array(stamps),
        positions,
        None if headings is None else np.array(headings),
        np.array([draw(SIGMAS), draw(SIGMAS)]),
        draw(st.booleans()),
        draw(SIGMAS),
    )
    landmarks = TrueLandmarks(positions, np.full(n, Kind.ROCK), np.full(n, draw(SIGMAS)))
    return Truth(path, draw(st.sampled_from([landmarks, None])))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(source=sources())
def test_what_is_written_is_read_again(source: Source) -> None:
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "recording"
        write(source, folder)
        again = read(folder, PlainOptions())
    assert same(again.recording, source.recording)
    check_recording(again.recording)
    path, path_again = source.truth.path, again.truth.path
    assert path is not None
    assert path_again is not None
    assert same(again.truth.landmarks, source.truth.landmarks)
    for name in ("stamps_ns", "world_t_reference", "base_t_reference", "has_outliers", "sigma_m"):
        assert same(getattr(path_again, name), getattr(path, name))
    assert (path_again.headings is None) == (path.headings is None)
    if path.headings is not None and path_again.headings is not None:
        assert np.allclose(path_again.headings, path.headings, atol=1e-12)


@pytest.mark.shared_data
@pytest.mark.parametrize("source", ["car_park", "mrclam6"])
def test_a_real_recording_is_the_same_from_a_plain_folder(
    shared_data: Path, tmp_path: Path, source: str
) -> None:
    original = opened(str(shared_data / source))
    write(original, tmp_path / "copy")
    copy = read(tmp_path / "copy", PlainOptions())
    assert same(copy.recording, original.recording)
    assert same(copy.truth.landmarks, original.truth.landmarks)


def test_a_folder_by_hand(tmp_path: Path) -> None:
    write_text(tmp_path, "recording.toml", HEADER)
    write_text(tmp_path, "perceptions.csv", PERCEPTIONS)
    write_text(tmp_path, "odometry.csv", "yaw_rad,stamp_s,x_m,y_m\n0,0,0,0\n1,2,2,0\n")
    recording = read(tmp_path, PlainOptions()).recording
    first, second = perceptions_of(recording)
    assert (first.stamp_ns, second.stamp_ns) == (1_000_000_000, 2_500_000_000)
    assert first.kinds.tolist() == [Kind.TREE, Kind.ROCK]
    assert np.allclose(np.sqrt(first.covariances[0].diagonal()), [0.05, np.radians(0.25)])
    between = [m for m in recording.measurements if isinstance(m, WheelOdometry)][1]
    assert between == WheelOdometry(1_000_000_000, Pose2(1.0, 0.0, 0.5))
    assert recording.odometry_noise == OdometryNoise()


def test_a_time_alone_says_that_nothing_was_perceived(tmp_path: Path) -> None:
    write_text(tmp_path, "recording.toml", HEADER)
    write_text(tmp_path, "perceptions.csv", PERCEPTIONS + "3.0,,,\n")
    assert [len(p) for p in perceptions_of(read(tmp_path, PlainOptions()).recording)] == [2, 1, 0]


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("recording.toml", "", "recording.toml: name: Field required"),
        ("recording.toml", "name =", "recording.toml: expected TOML"),
        ("recording.toml", HEADER + "[lasr]", "unknown key 'lasr', did you mean 'laser'"),
        ("recording.toml", HEADER + "[vehicle]\nalong_per_m=1", "did you mean 'along_per_sqrt_m'"),
        ("recording.toml", HEADER + "[vehicle]\nalong_per_sqrt_m=nan", "finite number"),
        ("recording.toml", HEADER + "[start]\nmap_T_start=[1,2]", "start.map_T_start"),
        ("recording.toml", HEADER + "x=" + "[" * 5000, "recording.toml"),
        ("perceptions.csv", "", "line 1: expected a column stamp_s"),
        ("perceptions.csv", "stamp_s,kind,range_m,bearing\n", "did you mean 'bearing_rad'"),
        ("perceptions.csv", PERCEPTIONS.split("\n")[0], "nothing to run"),
        ("perceptions.csv", PERCEPTIONS.replace("rock", "rok"), "line 3: kind: .* got 'rok'"),
        ("perceptions.csv", PERCEPTIONS.replace("6.0", "-6.0"), "line 3: range_m"),
        ("perceptions.csv", PERCEPTIONS.replace("6.0", "nan"), "line 3: range_m"),
        ("perceptions.csv", PERCEPTIONS.replace("6.0", ""), "line 3: range_m"),
        ("perceptions.csv", PERCEPTIONS.replace("2.5", "0.5"), "line 4: stamp_s: .*backwards"),
        ("perceptions.csv", PERCEPTIONS.replace("2.5", "1e300"), "line 4: stamp_s"),
        ("perceptions.csv", PERCEPTIONS + "3,tree\n", "line 5: expected 4 values, got 2"),
        ("perceptions.csv", PERCEPTIONS + '3,"tree\n', "line 5: not CSV"),
        ("perceptions.csv", PERCEPTIONS + "3,tree,1\0,0\n", "NUL"),
        ("odometry.csv", "stamp_s,x_m,y_m,yaw_rad\n1,0,0,0\n1,0,0,0\n", "line 3: stamp_s"),
        ("odometry.csv", "stamp_s,x_m,y_m,yaw_rad\n1,inf,0,0\n", "line 2: x_m"),
        ("gnss.csv", "stamp_s,x_m,y_m,sigma_m\n1,0,0,0\n", "line 2: sigma_m"),
        ("imu.csv", "stamp_s,yaw_rate_rad_s\n1,x\n", "line 2: yaw_rate_rad_s"),
        ("truth.tum", "1 0 0 0 0 0 0 0.5\n", "line 1: qw: expected a unit quaternion"),
        ("truth.tum", "1 0 0\n", "line 1: expected 8 values, got 3"),
        ("truth_landmarks.csv", "x_m,y_m,kind\n0,0,\n", "line 2: kind"),
        ("scans.npz", "PK", r"expected \[laser\]"),
    ],
)
def test_a_damaged_folder_is_refused_by_file_and_line(
    tmp_path: Path, name: str, text: str, expected: str
) -> None:
    write_text(tmp_path, "recording.toml", HEADER)
    write_text(tmp_path, "perceptions.csv", PERCEPTIONS)
    write_text(tmp_path, name, text)
    with pytest.raises(InputError, match=expected) as refusal:
        read(tmp_path, PlainOptions())
    assert "\n" not in str(refusal.value)


def npz(**arrays: object) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]  # whatever a stranger may save
    return buffer.getvalue()


def lying_npz() -> bytes:
    """A header that promises 8 EiB."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        array = io.BytesIO()
        np.lib.format.write_array(array, np.zeros(2))
        lie = array.getvalue().replace(b"(2,), }" + b" " * 20, b"(1000000000000000000,), }  ")
        archive.writestr("stamp_s.npy", lie)
        archive.writestr("ranges_m.npy", lie)
    return buffer.getvalue()


def bomb_npz() -> bytes:
    """Two GiB of zeros in two MiB."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("ranges_m.npy", "w", force_zip64=True) as member:
            for _ in range(66):
                member.write(bytes(2**24))
        archive.writestr("stamp_s.npy", b"")
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "damaged or no .npz"),
        (b"PK\x03\x04 garbage", "damaged or no .npz"),
        (npz(stamp_s=[1.0]), "expected an array ranges_m"),
        (npz(stamp_s=[1.0], ranges_m=[[1.0]], colours=[1]), "unknown array 'colours'"),
        (npz(stamp_s=[1.0], ranges_m=[1.0]), r"expected stamp_s \(n,\) and ranges_m \(n, m\)"),
        (npz(stamp_s=[1.0], ranges_m=[[1.0, -1.0]]), "ranges_m: record 1 holds -1.0"),
        (npz(stamp_s=[1.0], ranges_m=[["a"]]), "expected numbers"),
        (npz(stamp_s=[1.0], ranges_m=np.array([[None]])), "expected numbers"),
        (npz(stamp_s=[np.nan], ranges_m=[[1.0]]), "stamp_s: expected times"),
        (npz(stamp_s=[2.0, 1.0], ranges_m=[[1.0], [1.0]]), "record 2 has 1 s after 2 s"),
        (npz(stamp_s=[1.0], ranges_m=[[1.0]], intensities=[[1.0, 2.0]]), "expected intensities"),
        (npz(stamp_s=[1.0], ranges_m=[[1.0]], intensities=[[np.inf]]), "intensities: record 1"),
        (lying_npz(), "damaged or no .npz"),
        (bomb_npz(), "at most 1024 MiB when expanded"),
    ],
)
def test_damaged_scans_are_refused(tmp_path: Path, content: bytes, expected: str) -> None:
    write_text(tmp_path, "recording.toml", HEADER + LASER)
    (tmp_path / "scans.npz").write_bytes(content)
    with pytest.raises(InputError, match=f"scans.npz: .*{expected}"):
        read(tmp_path, PlainOptions())


def test_an_existing_folder_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "recording.toml").write_text("kept")
    with pytest.raises(InputError, match="it is there already"):
        write(opened("victoria-park-graph"), tmp_path)
    assert (tmp_path / "recording.toml").read_text() == "kept"


def test_nothing_is_left_of_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    scans = [
        LaserScan(k, ScannerGeometry(0.0, 0.1, 0.0, 10.0 + k), np.array([1.0])) for k in (0, 1)
    ]
    source = Source(Recording("two lasers", scans, 2), Truth())
    with pytest.raises(InputError, match="one geometry"):
        write(source, tmp_path / "copy")
    assert list(tmp_path.iterdir()) == []
    write_text(tmp_path, "file", "in the way")
    with pytest.raises(SemgraphError, match="choose another"):
        write(source, tmp_path / "file" / "copy")
