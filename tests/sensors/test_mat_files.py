"""MATLAB files, against scipy."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from semgraph.errors import InputError
from sensors.mat_files import load_mat, numbers, vector


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("name", "arrays"),
    [
        ("car_park/data_set.mat", ("Index", "Sensor", "Laser", "Intensity", "GPSLat")),
        ("victoria_park/VictoriaParkSinSincronizar.mat", ("zt", "TLsr", "u", "time")),
        ("victoria_park/aa3_gpsx.mat", ("Lo_m", "timeGps")),
    ],
)
def test_real_files_are_read_as_scipy_reads_them(
    shared_data: Path, name: str, arrays: tuple[str, ...]
) -> None:
    expected = loadmat(shared_data / name, variable_names=arrays)
    for key, array in load_mat(shared_data / name, arrays).items():
        if isinstance(array, tuple):
            cells = expected[key].ravel()
            assert len(cells) == len(array)
            assert all(np.array_equal(a, b) for a, b in zip(array, cells, strict=True))
        else:
            assert np.array_equal(array, expected[key])


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("dtype", ["u1", "i2", "i4", "u8", "f4", "f8"])
@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (0, 3), (4, 1), (2, 3, 4)])
def test_what_scipy_writes_is_read(
    tmp_path: Path, *, compress: bool, dtype: str, shape: tuple[int, ...]
) -> None:
    array = np.arange(np.prod(shape)).reshape(shape).astype(dtype)
    savemat(tmp_path / "a.mat", {"other": {"a": 1}, "x": array}, do_compression=compress)
    read = load_mat(tmp_path / "a.mat", ("x",))["x"]
    assert np.array_equal(np.asarray(read), array)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.array([1j]), "expected real numbers"),
        ("text", "expected real numbers"),
        ({"a": 1.0}, "expected real numbers"),
        (np.array([[1.0, np.nan]]), r"x: expected finite numbers up to 1e\+10, record 2 holds nan"),
        (np.array([[1e300]]), r"record 1 holds 1e\+300"),
        (np.ones((2, 3)), r"expected n numbers, got shape \(2, 3\)"),
        (np.array([["text"], [1.0]], dtype=object), "expected real"),
    ],
)
def test_what_is_no_vector_of_numbers_is_refused(
    tmp_path: Path, value: object, expected: str
) -> None:
    file = tmp_path / "a.mat"
    savemat(file, {"x": value})
    with pytest.raises(InputError, match=f"a.mat: .*(?:{expected})"):
        vector(file, "x", load_mat(file, ("x",))["x"])


def test_a_missing_array_and_a_wrong_shape_are_named(tmp_path: Path) -> None:
    file = tmp_path / "a.mat"
    savemat(file, {"x": np.ones((2, 3))})
    with pytest.raises(InputError, match="expected an array named y"):
        load_mat(file, ("y",))
    with pytest.raises(InputError, match=r"x: expected n x 2 numbers, got shape \(2, 3\)"):
        numbers(file, "x", load_mat(file, ("x",))["x"], (-1, 2))
