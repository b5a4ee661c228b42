from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.truth_files import read_truth, write_truth
from semgraph.errors import InputError
from sensors.truth import TrueLandmarks, TruePath, Truth
from tests.evaluation.course import make_run


def full_truth(seed: int) -> Truth:
    rng = np.random.default_rng(seed)
    _, truth = make_run(seed)
    assert truth.path is not None
    assert truth.landmarks is not None
    diameters_m = np.where(rng.random(30) < 0.5, truth.landmarks.diameters_m, np.nan)
    return Truth(
        replace(truth.path, base_t_reference=rng.normal(size=2), sigma_m=0.1, has_outliers=True),
        replace(truth.landmarks, diameters_m=diameters_m),
        {int(stamp): rng.integers(-1, 30, rng.integers(0, 5)) for stamp in truth.path.stamps_ns},
    )


def assert_same_path(first: TruePath, second: TruePath) -> None:
    for name in ("stamps_ns", "world_t_reference", "base_t_reference"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    for name in ("has_outliers", "sigma_m"):
        assert getattr(first, name) == getattr(second, name)
    assert (first.headings is None) == (second.headings is None)
    if first.headings is not None and second.headings is not None:
        np.testing.assert_allclose(first.headings, second.headings, rtol=0.0, atol=1e-15)


def assert_same_landmarks(first: TrueLandmarks, second: TrueLandmarks) -> None:
    for name in ("world_t_landmarks", "kinds", "diameters_m"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


@pytest.mark.parametrize("seed", range(10))
def test_the_truth_is_read_again_exactly(tmp_path: Path, seed: int) -> None:
    truth = full_truth(seed)
    write_truth(tmp_path, truth)
    again = read_truth(tmp_path)
    assert truth.path is not None
    assert again.path is not None
    assert_same_path(again.path, truth.path)
    assert truth.landmarks is not None
    assert again.landmarks is not None
    assert_same_landmarks(again.landmarks, truth.landmarks)
    assert truth.associations is not None
    assert again.associations is not None
    assert again.associations.keys() == truth.associations.keys()
    for stamp_ns, rows in truth.associations.items():
        np.testing.assert_array_equal(again.associations[stamp_ns], rows)


def test_what_is_not_known_stays_unknown(tmp_path: Path) -> None:
    assert read_truth(tmp_path) == Truth()
    write_truth(tmp_path, Truth())
    assert read_truth(tmp_path) == Truth()
    assert [path.name for path in tmp_path.iterdir()] == ["truth.toml"]
    path = full_truth(0).path
    assert path is not None
    write_truth(tmp_path, Truth(path=replace(path, headings=None)))
    again = read_truth(tmp_path)
    assert again.path is not None
    assert again.path.headings is None
    assert again.landmarks is None


@pytest.mark.parametrize(
    ("name", "old", "new", "reason"),
    [
        ("truth.toml", "num_landmarks = 30", "num_landmarks = 31", "expected 31 entries"),
        ("truth.toml", "num_fixes = 200", "num_fixes = -1", "expected -1 entries"),
        ("truth.toml", "sigma_m = 0.1", "sigma_m = -0.1", "sigma_m of at least 0"),
        ("truth.toml", "sigma_m = 0.1", "sigma_m = true", "path sigma_m"),
        ("truth.toml", "has_outliers", "has_outlier", "path has_outlier"),
        ("truth.toml", "[path]", "[path", "expected TOML"),
        ("truth_landmarks.csv", "tree", "bush", "expected one of tree, rock, marker"),
        ("truth_landmarks.csv", "x_m,", "x,", "line 1: expected the header"),
        ("truth_associations.csv", "-1", "30", "expected rows from -1 to 29, got '30'"),
        ("truth_associations.csv", "-1", "one", "expected rows from -1 to 29"),
    ],
)
def test_a_bad_entry_is_named(tmp_path: Path, name: str, old: str, new: str, reason: str) -> None:
    write_truth(tmp_path, full_truth(0))
    text = (tmp_path / name).read_text()
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=reason):
        read_truth(tmp_path)


def test_spoilt_files_are_refused_in_one_line_or_read(tmp_path: Path) -> None:
    write_truth(tmp_path, full_truth(0))
    whole = {path: path.read_bytes() for path in sorted(tmp_path.iterdir())}
    rng = np.random.default_rng(6)
    refusals = []
    for trial in range(300):
        path = list(whole)[trial % len(whole)]
        data = whole[path]
        at, length = int(rng.integers(len(data))), int(rng.integers(1, 40))
        noise = bytes(rng.integers(0, 256, length, dtype=np.uint8))
        path.write_bytes([data[:at], data[:at] + noise + data[at + length :]][trial % 2])
        try:
            read_truth(tmp_path)
        except InputError as error:
            refusals.append(str(error))
        path.write_bytes(data)
    assert len(refusals) > 200
    assert all("\n" not in text and str(tmp_path) in text for text in refusals)
