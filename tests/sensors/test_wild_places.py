"""The Wild-Places trees on the real data, and a forest of two frames."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from semgraph.errors import InputError
from semgraph.geometry import Pose2
from sensors.wild_places import WildPlacesOptions, read
from tests.sensors.sources import odometry_of, opened, perceptions_of, same, write_text

ROLL, PITCH, YAW = 0.10, -0.05, 0.7


@pytest.fixture
def by_hand(tmp_path: Path) -> Path:
    tilted = Rotation.from_euler("ZYX", [YAW, PITCH, ROLL])
    qx, qy, qz, qw = tilted.as_quat()
    x, y, z = tilted.inv().apply(Rotation.from_euler("Z", YAW).apply([3.0, 4.0, 1.0]))
    write_text(
        tmp_path,
        "trajectory.csv",
        f"t,x,y,z,qx,qy,qz,qw\n5.0,1,2,3,{qx},{qy},{qz},{qw}\n8.0,1,2,3,0,0,0,1\n",
    )
    write_text(tmp_path, "trees.csv", f"frame,x,y,z,dbh\n0,{x},{y},{z},0.3\n1,30,0,0,\n")
    return tmp_path


def test_trees_are_levelled(by_hand: Path) -> None:
    source = read(by_hand, WildPlacesOptions())
    first, _ = perceptions_of(source.recording)
    assert np.allclose(first.base_t_landmarks(), [[3.0, 4.0]])
    assert first.diameters_m.tolist() == [0.3]
    assert source.truth.path is not None
    assert source.truth.path.headings is not None
    assert np.allclose(source.truth.path.headings, [YAW, 0.0])


def test_far_trees_are_left_out_and_their_frame_stays(by_hand: Path) -> None:
    assert [len(p) for p in perceptions_of(read(by_hand, WildPlacesOptions()).recording)] == [1, 0]
    far = perceptions_of(read(by_hand, WildPlacesOptions(max_range_m=40.0)).recording)
    assert [len(p) for p in far] == [1, 1]
    assert np.isnan(far[1].diameters_m[0])


def test_thick_and_badly_fitted_trunks_weigh_less(by_hand: Path) -> None:
    trees = "frame,x,y,z,dbh,score\n0,9,0,0,0.3,1\n0,9,0,0,0.8,1\n0,9,0,0,0.3,0.25\n0,9,0,0,,1\n"
    write_text(by_hand, "trees.csv", trees)
    first, _ = perceptions_of(read(by_hand, WildPlacesOptions()).recording)
    thin, thick, bad, unknown = np.sqrt(first.covariances[:, 0, 0])
    assert thin < unknown < thick
    assert bad == pytest.approx(2.0 * thin)


@pytest.mark.shared_data
def test_levelled_frames_agree_with_each_other(shared_data: Path) -> None:
    """With the yaw alone they would differ by 20 to 37 cm."""
    source = opened(str(shared_data / "wild_v03"))
    sets, path = perceptions_of(source.recording), source.truth.path
    assert len(sets) == 2409
    assert 40 < np.mean([len(p) for p in sets]) < 46
    assert path is not None
    assert path.headings is not None
    poses = [
        Pose2(x, y, theta)
        for (x, y), theta in zip(path.world_t_reference, path.headings, strict=True)
    ]
    differences = []
    for k in range(100, 2400, 100):
        here = poses[k].transform(sets[k].base_t_landmarks())
        there = poses[k + 1].transform(sets[k + 1].base_t_landmarks())
        distances, _ = cKDTree(here).query(there)
        differences.append(np.median(distances[distances < 0.5]))
    assert np.median(differences) < 0.06


@pytest.mark.shared_data
def test_made_odometry_errs_by_two_percent(shared_data: Path) -> None:
    folder = shared_data / "wild_v03"
    truth = opened(str(folder)).truth.path
    assert truth is not None
    made = odometry_of(read(folder, WildPlacesOptions(odometry="noisy-truth")).recording)
    x_y = np.array([(m.odom_T_base.x, m.odom_T_base.y) for m in made])
    steps = np.linalg.norm(np.diff(x_y, axis=0), axis=1)
    true_steps = np.linalg.norm(np.diff(truth.world_t_reference, axis=0), axis=1)
    moving = true_steps > 0.5
    errors = steps[moving] / true_steps[moving] - 1.0
    assert 0.018 < errors.std() < 0.022


def test_made_odometry_is_seeded(by_hand: Path) -> None:
    first, again, other = (
        odometry_of(read(by_hand, WildPlacesOptions(odometry="noisy-truth", seed=seed)).recording)
        for seed in (3, 3, 4)
    )
    assert same(first, again)
    assert not same(first, other)


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("trees.csv", "\n1,30", "\n2,30", "line 3: frame: expected a row of trajectory.csv"),
        ("trees.csv", "\n1,30", "\n-1,30", "line 3: frame"),
        ("trees.csv", "\n1,30", "\n1,inf", "line 3: x"),
        ("trees.csv", "0.3", "-0.3", "line 2: dbh"),
        ("trees.csv", "frame,x", "frame,X", "unknown column 'X'"),
        ("trajectory.csv", "8.0,", "4.0,", "line 3: t: expected times that increase"),
        ("trajectory.csv", "0,0,0,1", "0,0,0,2", "line 3: qw: expected a unit quaternion"),
    ],
)
def test_bad_rows_are_refused_by_file_and_line(
    by_hand: Path, name: str, old: str, new: str, expected: str
) -> None:
    text = (by_hand / name).read_text(encoding="utf-8")
    assert old in text
    write_text(by_hand, name, text.replace(old, new))
    with pytest.raises(InputError, match=f"{name}: .*{expected}"):
        read(by_hand, WildPlacesOptions())
