"""The car park on the real data, and damaged copies of its files."""

import math
from pathlib import Path

import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.geometry import transform_points
from sensors.car_park import CarParkOptions, read
from sensors.measurements import GnssFix, LaserScan
from sensors.truth import TruePath
from tests.sensors.sources import odometry_of, opened, start_aligned


@pytest.fixture
def folder(shared_data: Path) -> Path:
    return shared_data / "car_park"


def dead_reckoning_errors(folder: Path, path: TruePath) -> tuple[np.ndarray, np.ndarray]:
    """Seconds since the first fix and the error of dead reckoning, aligned on the first 20 s."""
    samples = odometry_of(opened(str(folder)).recording)
    stamps = np.array([sample.stamp_ns for sample in samples])
    poses = np.array([sample.odom_T_base.as_array() for sample in samples])
    inside = (path.stamps_ns >= stamps[0]) & (path.stamps_ns <= stamps[-1])
    at = path.stamps_ns[inside]
    bases = np.column_stack([np.interp(at, stamps, poses[:, axis]) for axis in (0, 1)])
    bases = np.column_stack([bases, np.interp(at, stamps, np.unwrap(poses[:, 2]))])
    lasers = transform_points(bases, path.base_t_reference)
    times = (at - at[0]) * 1e-9
    world = path.world_t_reference[inside]
    moved = start_aligned(lasers, world, int((times < 20.0).sum()))
    return times, np.linalg.norm(moved - world, axis=1)


@pytest.mark.shared_data
def test_scans_are_as_the_laser_gave_them(folder: Path) -> None:
    scans = [m for m in opened(str(folder)).recording.measurements if isinstance(m, LaserScan)]
    first = scans[0]
    assert len(scans) == 586
    assert first.stamp_ns == 45_103_000_000
    assert first.ranges_m[:3].tolist() == [0.84, 0.85, 0.84]
    assert first.geometry.angle_min == -math.pi / 2
    assert first.geometry.base_T_laser.as_array().tolist() == [3.78, 0.5, 0.0]
    returns = np.concatenate([scan.ranges_m for scan in scans])
    assert np.isinf(returns).sum() > 1000
    assert returns[np.isfinite(returns)].max() < 60.0
    assert first.intensities is not None
    levels = np.unique(np.concatenate([scan.intensities for scan in scans]))
    assert levels.tolist() == [0.0, 8192.0, 16384.0, 24576.0, 32768.0]


@pytest.mark.shared_data
def test_truth_is_gps_at_the_laser_and_fifteen_beacons(folder: Path) -> None:
    truth = opened(str(folder)).truth
    assert truth.path is not None
    assert truth.landmarks is not None
    assert truth.path.world_t_reference.shape == (626, 2)
    assert truth.path.headings is None
    assert truth.path.base_t_reference.tolist() == [3.78, 0.5]
    assert truth.landmarks.world_t_landmarks.shape == (15, 2)


@pytest.mark.shared_data
def test_dead_reckoning_errs_as_is_known_of_this_recording(folder: Path) -> None:
    path = opened(str(folder)).truth.path
    assert path is not None
    times, errors = dead_reckoning_errors(folder, path)
    at_60, at_90, at_110 = (errors[np.searchsorted(times, seconds)] for seconds in (60, 90, 110))
    assert at_60 < 0.5
    assert 1.2 < at_90 < 1.9
    assert 7.0 < at_110 < 8.5


@pytest.mark.shared_data
def test_gps_is_measured_only_when_asked_for(folder: Path) -> None:
    recording = read(folder, CarParkOptions(gnss=True)).recording
    fixes = [m for m in recording.measurements if isinstance(m, GnssFix)]
    assert len(fixes) == 626
    assert (fixes[0].x_m, fixes[0].y_m) == pytest.approx((5.10475776, 4.20435697))


@pytest.mark.shared_data
@pytest.mark.parametrize("name", ["data_set.mat", "beac_juan3.mat"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.9, 0.999])
def test_a_truncated_file_is_refused_by_name(
    folder: Path, tmp_path: Path, name: str, share: float
) -> None:
    for file in folder.glob("*.mat"):
        content = file.read_bytes()
        size = int(len(content) * share) if file.name == name else len(content)
        (tmp_path / file.name).write_bytes(content[:size])
    with pytest.raises(InputError, match=name):
        read(tmp_path, CarParkOptions())


def test_missing_beacons_or_data_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"data_set\.mat: expected a file"):
        read(tmp_path, CarParkOptions())
