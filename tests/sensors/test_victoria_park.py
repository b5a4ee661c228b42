"""Victoria Park on the real data."""

import math
from pathlib import Path

import numpy as np
import pytest

from semgraph.errors import InputError
from sensors.victoria_park import VictoriaParkOptions, read
from tests.sensors.sources import odometry_of, opened, perceptions_of


@pytest.fixture
def folder(shared_data: Path) -> Path:
    return shared_data / "victoria_park"


@pytest.mark.shared_data
def test_trees_are_seen_from_the_rear_axle(folder: Path) -> None:
    sets = perceptions_of(opened(str(folder)).recording)
    assert len(sets) == 7249
    assert sum(map(len, sets)) == 52_974 - 386
    range_m, bearing = 20.46202002, 0.8857546 - math.pi / 2
    expected = [3.78 + range_m * math.cos(bearing), 0.5 + range_m * math.sin(bearing)]
    assert np.allclose(sets[0].base_t_landmarks()[0], expected, atol=1e-9)
    assert sets[0].diameters_m[0] == pytest.approx(0.35404004)
    assert sets[0].diameter_sigmas_m[0] == pytest.approx(0.24 * 0.35404004)


@pytest.mark.shared_data
def test_covariance_across_the_beam_is_what_the_laser_errs(folder: Path) -> None:
    trees = perceptions_of(opened(str(folder)).recording)[0]
    variances = np.linalg.eigvalsh(trees.base_covariances()[0])
    across, along = 20.46 * math.radians(0.17), 0.078
    assert np.allclose(np.sqrt(variances), sorted([across, along]), rtol=0.01)


@pytest.mark.shared_data
def test_odometry_is_as_long_as_the_drive(folder: Path) -> None:
    poses = np.array([m.odom_T_base.as_array() for m in odometry_of(opened(str(folder)).recording)])
    length_m = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum()
    assert 3900.0 < length_m < 4300.0


@pytest.mark.shared_data
def test_truth_is_gps_that_jumps(folder: Path) -> None:
    path = opened(str(folder)).truth.path
    assert path is not None
    assert len(path.stamps_ns) == 4466
    assert path.has_outliers
    assert path.stamps_ns[0] == 20_967_000_000
    assert path.base_t_reference.tolist() == [3.9, 0.5]


@pytest.mark.shared_data
@pytest.mark.parametrize("name", ["VictoriaParkSinSincronizar.mat", "aa3_gpsx.mat"])
def test_a_missing_or_truncated_file_is_refused_by_name(
    folder: Path, tmp_path: Path, name: str
) -> None:
    for file in folder.glob("*.mat"):
        content = file.read_bytes()
        cut = len(content) // 2 if file.name == name else len(content)
        (tmp_path / file.name).write_bytes(content[:cut])
    with pytest.raises(InputError, match=name):
        read(tmp_path, VictoriaParkOptions())
