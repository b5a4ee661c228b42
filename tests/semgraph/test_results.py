import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from semgraph import results
from semgraph.errors import InputError, SemgraphError, SettingsError
from semgraph.estimates import Trajectory
from semgraph.files.yaw_rates import YawRates
from semgraph.landmarks import Kind, Landmark, semantic_object
from semgraph.results import RunResult

FILES = {
    "trajectory.tum",
    "trajectory_fast.tum",
    "trajectory_covariance.csv",
    "map.json",
    "map.csv",
    "map_fast.json",
    "settings.toml",
    "run.json",
    "events.log",
    "decisions.csv",
    "imu.csv",
}


def random_rates(rng: np.random.Generator, n: int) -> YawRates:
    stamps_ns = 1_600_000_000_123_456_789 + np.cumsum(rng.integers(1, 10**9, n))
    return YawRates(stamps_ns, rng.normal(0.0, 0.3, n))


def random_trajectory(rng: np.random.Generator, n: int) -> Trajectory:
    stamps_ns = 1_600_000_000_123_456_789 + np.cumsum(rng.integers(1, 10**9, n))
    headings = rng.uniform(-np.pi, np.pi, n)
    return Trajectory(stamps_ns, np.column_stack([rng.normal(0.0, 100.0, (n, 2)), headings]))


def random_landmark(rng: np.random.Generator, number: int) -> Landmark:
    kind = Kind(int(rng.integers(len(Kind))))
    diameter = rng.uniform(0.05, 1.0) if rng.random() < 0.5 else np.nan
    root = rng.normal(size=(2, 2))
    identity = 'a "quoted", name' if number % 2 else ""
    return Landmark(
        number,
        semantic_object(kind, diameter, 0.1 * diameter, identity),
        rng.normal(0.0, 50.0, 2),
        root @ root.T,
        int(rng.integers(1, 99)),
        float(rng.random()),
    )


def random_result(seed: int, n: int = 8) -> RunResult:
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(n, 3, 3))
    covariances = roots @ roots.transpose(0, 2, 1)
    covariances[: n // 3] = np.nan
    return RunResult(
        name=f"course {seed}",
        smoothed=random_trajectory(rng, n),
        smoothed_covariances=covariances,
        fast=random_trajectory(rng, n + 2),
        landmarks=tuple(random_landmark(rng, k) for k in range(5)),
        fast_seconds=rng.exponential(1e-3, n),
        wall_seconds=1.25,
        num_scans=n,
        events=("loop closed at 3.2 s", "graph rebuilt\nafter an error"),
        settings={"fast": {"radius_m": 0.1 + 0.2, "sweep": [1.0, 2.0]}, "seed": seed},
        imu=random_rates(rng, n),
    )


def assert_same(first: RunResult, second: RunResult) -> None:
    for name in ("name", "wall_seconds", "num_scans", "events", "settings"):
        assert getattr(first, name) == getattr(second, name)
    np.testing.assert_array_equal(first.fast_seconds, second.fast_seconds)
    np.testing.assert_array_equal(first.smoothed_covariances, second.smoothed_covariances)
    for a, b in ((first.smoothed, second.smoothed), (first.fast, second.fast)):
        np.testing.assert_array_equal(a.stamps_ns, b.stamps_ns)
        np.testing.assert_array_equal(a.map_T_bases[:, :2], b.map_T_bases[:, :2])
        np.testing.assert_allclose(a.map_T_bases[:, 2], b.map_T_bases[:, 2], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(first.imu.stamps_ns, second.imu.stamps_ns)
    np.testing.assert_array_equal(first.imu.rates, second.imu.rates)
    assert len(first.landmarks) == len(second.landmarks)
    for one, other in zip(first.landmarks, second.landmarks, strict=True):
        np.testing.assert_array_equal(one.map_t_landmark, other.map_t_landmark)
        np.testing.assert_array_equal(one.covariance, other.covariance)
        for name in ("id", "semantics", "num_sightings", "reliability"):
            assert getattr(one, name) == getattr(other, name)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_written_is_read_again_exactly(tmp_path: Path, seed: int) -> None:
    result = random_result(seed)
    results.write(result, tmp_path / "run")
    assert_same(results.read(tmp_path / "run"), result)
    assert {path.name for path in (tmp_path / "run").iterdir()} == FILES


def test_an_empty_run_is_read_again(tmp_path: Path) -> None:
    nothing = Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)))
    result = RunResult("", nothing, np.empty((0, 3, 3)), nothing, (), np.empty(0), 0.0, 0)
    results.write(result, tmp_path / "run")
    assert_same(results.read(tmp_path / "run"), result)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    values=arrays(np.float64, 3, elements=st.floats(-1e300, 1e300)),
    name=st.text(),
    events=st.lists(st.text()),
    stamp_ns=st.integers(-(10**18), 10**18),
)
def test_any_numbers_and_texts_are_read_again(
    tmp_path: Path, values: np.ndarray, name: str, events: list[str], stamp_ns: int
) -> None:
    pose = np.array([[values[0], values[1], 1.0]])
    result = replace(
        random_result(0),
        name=name,
        events=tuple(events),
        fast=Trajectory(np.array([stamp_ns]), pose),
        fast_seconds=np.abs(values),
    )
    results.write(result, tmp_path / "run")
    assert_same(results.read(tmp_path / "run"), result)


def test_an_earlier_run_is_replaced(tmp_path: Path) -> None:
    for seed in (1, 2):
        results.write(random_result(seed), tmp_path / "run")
    assert results.read(tmp_path / "run").name == "course 2"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_failure_leaves_the_earlier_run_and_nothing_half_written(tmp_path: Path) -> None:
    results.write(random_result(1), tmp_path / "run")
    broken = replace(random_result(2), settings={"nothing": None})
    with pytest.raises(SettingsError, match="TOML"):
        results.write(broken, tmp_path / "run")
    assert results.read(tmp_path / "run").name == "course 1"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"fast_seconds": np.array([-1.0])}, "durations"),
        ({"wall_seconds": float("nan")}, "durations"),
        ({"num_scans": -1}, "number of scans"),
        ({"smoothed_covariances": np.zeros((3, 3, 3))}, "shape"),
        ({"smoothed_covariances": np.full((8, 3, 3), np.inf)}, "finite"),
        ({"smoothed_covariances": np.tile(np.arange(9.0).reshape(3, 3), (8, 1, 1))}, "symmetric"),
    ],
)
def test_impossible_results_are_refused(change: dict[str, object], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        replace(random_result(0), **change)  # type: ignore[arg-type]  # wrong values on purpose


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none here: expected the folder of a run"):
        results.read(tmp_path / "none here")


@pytest.mark.parametrize("missing", sorted(FILES - {"map.csv"}))
def test_a_missing_file_is_named(tmp_path: Path, missing: str) -> None:
    results.write(random_result(0), tmp_path / "run")
    (tmp_path / "run" / missing).unlink()
    with pytest.raises(InputError, match=missing):
        results.read(tmp_path / "run")


@pytest.mark.parametrize(
    ("name", "line", "reason"),
    [
        ("trajectory.tum", "1.0 2 3 4", "line 2: expected 8 values, got 4"),
        ("trajectory.tum", "x 2 3 0 0 0 0 1", "line 2: expected seconds, got 'x'"),
        ("trajectory.tum", "1e999999 2 3 0 0 0 0 1", "line 2: expected seconds within"),
        ("trajectory.tum", "1 nan 3 0 0 0 0 1", "line 2: expected finite numbers"),
        ("trajectory.tum", "1 2 3 0 0 0 0 7", "line 2: expected a unit quaternion"),
        ("trajectory.tum", "1 2 3 0 0 0 1e200 0", "line 2: expected a unit quaternion"),
        ("trajectory_fast.tum", "9999999999999 2 3 0 0 0 0 1", "line 2: expected seconds within"),
        ("trajectory_fast.tum", "5000000000 2 3 0 0 0 0 1", "line 3: expected increasing times"),
        ("trajectory_covariance.csv", "1,2", "line 2: expected 7 values, got 2"),
        ("trajectory_covariance.csv", "1,2,3,4,5,6,seven", "line 2: expected a number"),
        ("trajectory_covariance.csv", "1,2,3,4,5,6,7", "expected the times of the 8 smoothed"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, name: str, line: str, reason: str) -> None:
    results.write(random_result(0), tmp_path / "run")
    path = tmp_path / "run" / name
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], line, *lines[2:]]))
    with pytest.raises(InputError, match=reason) as caught:
        results.read(tmp_path / "run")
    assert name in str(caught.value)


def test_a_trajectory_cut_at_a_line_end_is_noticed(tmp_path: Path) -> None:
    results.write(random_result(0), tmp_path / "run")
    path = tmp_path / "run" / "trajectory_fast.tum"
    path.write_text("\n".join(path.read_text().splitlines()[:-2]))
    with pytest.raises(InputError, match="expected 10 entries as"):
        results.read(tmp_path / "run")


def test_spoilt_files_are_refused_in_one_line_or_read(tmp_path: Path) -> None:
    results.write(random_result(0), tmp_path / "whole")
    rng = np.random.default_rng(5)
    names = sorted(FILES - {"map.csv"})
    refusals = []
    for trial in range(400):
        folder = tmp_path / "spoilt"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(tmp_path / "whole", folder)
        path = folder / names[trial % len(names)]
        path.write_bytes(spoil(path.read_bytes(), rng))
        try:
            results.read(folder)
        except InputError as error:
            refusals.append(str(error))
    assert len(refusals) > 200
    assert all("\n" not in text and str(tmp_path / "spoilt") in text for text in refusals)


def spoil(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(data)))
    match rng.integers(5):
        case 0:
            return data[:at]
        case 1:
            return b""
        case 2:
            return data[:at] + bytes(rng.integers(0, 256, 8, dtype=np.uint8)) + data[at + 8 :]
        case 3:
            return data[:at] + b"[" * 100_000 + data[at:]
        case _:
            return data[:at] + b"9" * 5000 + data[at:]


def test_an_unwritable_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(SemgraphError, match="file: expected a folder, it is a file"):
        results.write(random_result(0), tmp_path / "file" / "run")
