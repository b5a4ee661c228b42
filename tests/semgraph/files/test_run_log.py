"""What a run measured, written and read again; and files that no run has written."""

import time
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from evaluation.benches.bench_runs import run_course
from semgraph import results
from semgraph.errors import InputError
from semgraph.files.run_log import LOG_NPZ, RunLog, read_log, write_log
from semgraph.landmarks import Perceptions
from tests.semgraph.logs import log

SHORT: dict[str, object] = {
    "seed": 4,
    "track_radius_m": 10.0,
    "num_trees": 40,
    "lap_s": 20.0,
    "scan_rate_hz": 5.0,
}
NUM_MUTANTS = 300


def assert_same(one: RunLog, other: RunLog) -> None:
    for name in ("motions", "motion_covariances", "scans", "landmarks"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in Perceptions.__slots__[1:]:
        np.testing.assert_array_equal(getattr(one.seen, name), getattr(other.seen, name))
    np.testing.assert_array_equal(one.trajectory.stamps_ns, other.trajectory.stamps_ns)
    np.testing.assert_array_equal(one.trajectory.map_T_bases, other.trajectory.map_T_bases)
    assert one.start.pose == other.start.pose
    np.testing.assert_array_equal(one.start.covariance, other.start.covariance)
    assert [scan for scan, _ in one.views] == [scan for scan, _ in other.views]
    for (_, a), (_, b) in zip(one.views, other.views, strict=True):
        assert (a.base_T_sensor, a.first, a.increment) == (b.base_T_sensor, b.first, b.increment)
        np.testing.assert_allclose(a.clear_m, b.clear_m, rtol=1e-6)


def test_a_log_comes_back_as_it_was(tmp_path: Path) -> None:
    for made in (log(), log(1, sighted_from=()), replace(log(), views=())):
        write_log(tmp_path / LOG_NPZ, made)
        assert_same(made, read_log(tmp_path / LOG_NPZ))


def test_every_run_writes_one(tmp_path: Path) -> None:
    source, result = run_course("course:perceptions", **SHORT)
    results.write(result, tmp_path / "run")
    kept = read_log(tmp_path / "run" / LOG_NPZ)
    np.testing.assert_array_equal(kept.trajectory.map_T_bases, result.smoothed.map_T_bases)
    truly = source.truth.associations
    assert truly is not None
    assert len(kept.seen) == sum(len(rows) for rows in truly.values())
    assert kept.start.pose == source.recording.map_T_start
    for scan, stamp_ns in enumerate(kept.trajectory.stamps_ns.tolist()):
        np.testing.assert_array_equal(
            kept.landmarks[kept.scans == scan], result.associations[stamp_ns]
        )


def test_views_are_kept_apart() -> None:
    _, result = run_course("course:paper", seed=1, lap_s=5.0, overlap_s=0.0, track_radius_m=5.0)
    assert result.log is not None
    scans = [scan for scan, _ in result.log.views]
    places = result.smoothed.map_T_bases[scans, :2]
    steps_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert len(scans) > 20
    assert steps_m.min() > 0.2


@pytest.fixture
def arrays(tmp_path: Path) -> dict[str, NDArray[Any]]:
    write_log(tmp_path / LOG_NPZ, log())
    with np.load(tmp_path / LOG_NPZ) as file:
        return dict(file)


Change = Callable[[NDArray[Any]], NDArray[Any]]


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("stamps_ns", lambda a: a[::-1]),
        ("stamps_ns", lambda a: a[:-1]),
        ("motions", lambda a: a[:, :2]),
        ("motions", lambda a: a * np.nan),
        ("motion_covariances", lambda a: -a),
        ("motion_covariances", lambda a: a + np.triu(np.ones((3, 3)), 1) * 1e-5),
        ("start", lambda a: a[:2]),
        ("start_covariance", lambda a: 0.0 * a),
        ("scans", lambda a: a + 7),
        ("scans", lambda a: a[::-1]),
        ("landmarks", lambda a: a - 2),
        ("landmarks", lambda a: a.astype(np.float64)),
        ("kinds", lambda a: a + 5),
        ("ranges_m", lambda a: -a),
        ("ranges_m", lambda a: a[:-1]),
        ("covariances", lambda a: -a),
        ("reliabilities", lambda a: a + 1.0),
        ("identities", lambda a: a + 1),
        ("identity_names", lambda a: a[:-1]),
        ("identity_names", lambda _: np.frombuffer(b"[1]", dtype=np.uint8)),
        ("view_scans", lambda a: a + 99),
        ("view_num_beams", lambda a: a + 1),
        ("view_num_beams", lambda a: a - 2**40),
        ("view_beams", lambda a: -a),
        ("view_clear_m", lambda a: a * np.nan),
        ("view_sensors", lambda a: a[:, :2]),
    ],
)
def test_what_no_run_measured_is_refused(
    tmp_path: Path, arrays: dict[str, NDArray[Any]], name: str, change: Change
) -> None:
    file = tmp_path / "bad.npz"
    np.savez(file, **{**arrays, name: change(arrays[name])})  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"bad\.npz: ."):
        read_log(file)


def test_missing_unknown_and_pickled_arrays_are_refused(
    tmp_path: Path, arrays: dict[str, NDArray[Any]]
) -> None:
    file = tmp_path / "bad.npz"
    rest = {name: array for name, array in arrays.items() if name != "scans"}
    for content in (rest, {**arrays, "more": np.zeros(1)}):
        np.savez(file, **content)  # type: ignore[arg-type]
        with pytest.raises(InputError, match=r"bad\.npz: .*array"):
            read_log(file)
    pickled = np.array([{"a": 1}], dtype=object)
    np.savez(file, **{**rest, "scans": pickled})  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"bad\.npz"):
        read_log(file)
    with pytest.raises(InputError, match="there is none"):
        read_log(tmp_path / "none.npz")


def refused(file: Path) -> str:
    """Why it is; empty where it is read."""
    try:
        read_log(file)
    except InputError as error:
        return str(error)
    return ""


def test_damaged_files_are_read_or_refused_soon(tmp_path: Path) -> None:
    file = tmp_path / LOG_NPZ
    write_log(file, log())
    with zipfile.ZipFile(file) as archive, zipfile.ZipFile(tmp_path / "plain", "w") as plain:
        for member in archive.infolist():
            plain.writestr(member.filename, archive.read(member))
    # Stored as they are, damaged numbers pass no checksum of deflate.
    contents = [file.read_bytes(), (tmp_path / "plain").read_bytes()]
    rng = np.random.default_rng(7)
    num_refused = 0
    for number in range(NUM_MUTANTS):
        content = bytearray(contents[number % 2])
        for place in rng.integers(0, len(content), rng.integers(1, 12)).tolist():
            content[place] = int(rng.integers(0, 256))
        if number % 5 == 0:
            del content[int(rng.integers(0, len(content))) :]
        file.write_bytes(content)
        started = time.perf_counter()
        refusal = refused(file)
        num_refused += bool(refusal)
        assert not refusal or str(file) in refusal
        assert time.perf_counter() - started < 5.0
    assert num_refused > NUM_MUTANTS // 2
