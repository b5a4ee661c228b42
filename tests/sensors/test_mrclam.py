"""MRCLAM on the real data, and a data set written by hand."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from semgraph.errors import InputError
from sensors.catalog import open_source
from sensors.mrclam import MrclamOptions, read
from tests.sensors.sources import odometry_of, opened, perceptions_of, write_text

FILES = {
    "Barcodes.dat": "# subject barcode\n1 5\n6 63\n7 81\n",
    "Landmark_Groundtruth.dat": "6 1.0 2.0 0.001 0.001\n7 -1.0 2.0 0.001 0.001\n",
    "Robot1_Measurement.dat": "10.5 63 2.0 0.1\n10.5 5 3.0 0.2\n10.5 81 4.0 0.3\n11.0 99 1.0 0.0\n",
    "Robot1_Odometry.dat": "10.0 1.0 0.0\n10.0 2.0 0.0\n12.0 2.0 0.0\n",
    "Robot1_Groundtruth.dat": "10.0 0.0 0.0 0.5\n11.0 1.0 0.0 0.6\n",
}


@pytest.fixture
def by_hand(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        write_text(tmp_path, name, text)
    return tmp_path


@pytest.mark.shared_data
def test_robot_one_sees_all_landmarks_and_no_robots(shared_data: Path) -> None:
    source = opened(str(shared_data / "mrclam6"))
    sets = perceptions_of(source.recording)
    assert (len(sets), sum(map(len, sets))) == (1012, 1534)
    assert {str(name) for p in sets for name in p.identities} == {str(k) for k in range(6, 21)}
    assert source.truth.landmarks is not None
    assert source.truth.landmarks.world_t_landmarks.shape == (15, 2)
    assert source.truth.path is not None
    assert source.truth.path.headings is not None


@pytest.mark.shared_data
def test_sightings_agree_with_vicon(shared_data: Path) -> None:
    """The stated sigmas cover what is measured, and identities name the right landmark."""
    source = opened(str(shared_data / "mrclam6"))
    path, landmarks, associations = (
        source.truth.path,
        source.truth.landmarks,
        source.truth.associations,
    )
    assert path is not None
    assert path.headings is not None
    assert landmarks is not None
    assert associations is not None
    z_ranges = []
    for p in perceptions_of(source.recording):
        x, y = (np.interp(p.stamp_ns, path.stamps_ns, path.world_t_reference.T[k]) for k in (0, 1))
        delta = landmarks.world_t_landmarks[associations[p.stamp_ns]] - (x, y)
        z_ranges.append((p.ranges_m - np.hypot(*delta.T)) / np.sqrt(p.covariances[:, 0, 0]))
    z = np.concatenate(z_ranges)
    assert 0.4 < np.median(np.abs(z)) / 0.6745 < 1.2
    assert np.mean(np.abs(z) < 3.0) > 0.97


def test_sightings_of_one_stamp_form_one_set(by_hand: Path) -> None:
    source = read(by_hand, MrclamOptions())
    (perceptions,) = perceptions_of(source.recording)
    assert perceptions.stamp_ns == 10_500_000_000
    assert perceptions.ranges_m.tolist() == [2.0, 4.0]
    assert perceptions.identities.tolist() == ["6", "7"]
    assert source.truth.associations is not None
    assert source.truth.associations[10_500_000_000].tolist() == [0, 1]


def test_identities_can_be_left_out(by_hand: Path) -> None:
    (perceptions,) = perceptions_of(read(by_hand, MrclamOptions(identities=False)).recording)
    assert perceptions.identities.tolist() == ["", ""]


def test_of_odometry_at_one_time_the_last_counts(by_hand: Path) -> None:
    samples = odometry_of(read(by_hand, MrclamOptions(wheels_late_s=0.0)).recording)
    assert [m.stamp_ns for m in samples] == [10_000_000_000, 10_500_000_000, 12_000_000_000]
    assert [m.odom_T_base.x for m in samples] == [0.0, 1.0, 4.0]


def test_wheels_may_turn_later_than_they_are_told(by_hand: Path) -> None:
    samples = odometry_of(read(by_hand, MrclamOptions(wheels_late_s=0.25)).recording)
    assert [m.stamp_ns for m in samples] == [10_250_000_000, 10_500_000_000, 12_250_000_000]
    assert [m.odom_T_base.x for m in samples] == [0.0, 0.5, 4.0]


@pytest.mark.shared_data
def test_turns_follow_the_wheels_in_vicon_a_fifth_of_a_second_later(shared_data: Path) -> None:
    """Taken so late, the wheels turn when Vicon sees it; at once or twice as late they do not."""

    def agreement(late_s: float) -> float:
        source = open_source(str(shared_data / "mrclam6"), {"wheels_late_s": late_s})
        samples, path = odometry_of(source.recording), source.truth.path
        assert path is not None
        assert path.headings is not None
        stamps_ns = np.arange(path.stamps_ns[100], path.stamps_ns[-100], 50_000_000)
        wheels = np.unwrap([m.odom_T_base.theta for m in samples])
        told = np.interp(stamps_ns, [m.stamp_ns for m in samples], wheels)
        seen = np.interp(stamps_ns, path.stamps_ns, np.unwrap(path.headings))
        return float(np.corrcoef(np.diff(told), np.diff(seen))[0, 1])

    assert agreement(0.2) > agreement(0.0) + 0.05
    assert agreement(0.2) > agreement(0.4) + 0.05


def test_gzipped_files_are_read_as_plain_ones(by_hand: Path) -> None:
    for file in by_hand.glob("Robot1_*.dat"):
        (by_hand / f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes()))
        file.unlink()
    assert len(perceptions_of(read(by_hand, MrclamOptions()).recording)) == 1


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("Robot1_Measurement.dat", "10.5 63 -2.0 0.1", "line 1: range: expected .* got '-2.0'"),
        ("Robot1_Measurement.dat", "10 63 1 0\n9 63 1 0", "line 2: time: .*backwards"),
        ("Robot1_Measurement.dat", "10 63.5 1 0", "line 1: barcode: expected a whole number"),
        ("Robot1_Measurement.dat", "10 63 1", "line 1: expected 4 values, got 3"),
        ("Robot1_Measurement.dat", "# nothing\n", "expected at least one row"),
        ("Robot1_Measurement.dat", "10 5 1 0", "expected at least one landmark"),
        ("Robot1_Odometry.dat", "10 nan 0", "line 1: speed"),
        ("Robot1_Groundtruth.dat", "10 0 0 0\n10 0 0 0", "line 2: time: expected times that incr"),
        ("Landmark_Groundtruth.dat", "6 x 0 0 0", "line 1: x: expected a finite number"),
        ("Barcodes.dat", "6 inf", "line 1: barcode"),
    ],
)
def test_bad_rows_are_refused_by_file_and_line(
    by_hand: Path, name: str, text: str, expected: str
) -> None:
    write_text(by_hand, name, text)
    with pytest.raises(InputError, match=f"{name}: {expected}"):
        read(by_hand, MrclamOptions())
