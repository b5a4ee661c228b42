"""Maps that are given: by a run, as a list, as stems, and what is refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from semgraph.errors import InputError
from semgraph.files.map_files import write_map_csv, write_map_json
from semgraph.given_maps import read_given_map
from semgraph.landmarks import Kind, Landmark, Tree, semantic_object
from semgraph.offline.prior_map import read_prior_map

LANDMARKS = (
    Landmark(3, semantic_object(Kind.TREE, 0.3, 0.02), np.array([1.0, 2.0]), np.eye(2), 5, 0.9),
    Landmark(7, Tree(identity="a"), np.array([-1.0, 2.5]), np.diag([0.1, 0.2]), 2, 0.8),
)


def same(one: Landmark, other: Landmark) -> bool:
    return (
        (one.id, one.semantics, one.num_sightings, one.reliability)
        == (other.id, other.semantics, other.num_sightings, other.reliability)
        and np.array_equal(one.map_t_landmark, other.map_t_landmark)
        and np.array_equal(one.covariance, other.covariance)
    )


def test_a_runs_map_comes_back_from_json_csv_and_folder(tmp_path: Path) -> None:
    write_map_json(tmp_path / "map.json", LANDMARKS)
    write_map_csv(tmp_path / "map.csv", LANDMARKS)
    for path in (tmp_path / "map.json", tmp_path / "map.csv", tmp_path):
        read = read_given_map(path, 0.1)
        assert all(same(*pair) for pair in zip(read, LANDMARKS, strict=True))


def test_what_a_spreadsheet_saves_is_read(tmp_path: Path) -> None:
    """A mark before the first cell, quoted cells, a name with a comma."""
    path = tmp_path / "list.csv"
    path.write_text('\ufeff"x", "y"\r\n"1","2"\r\n', encoding="utf-8")
    (stem,) = read_given_map(path, 0.1)
    assert stem.map_t_landmark.tolist() == [1.0, 2.0]
    named = replace(LANDMARKS[1], semantics=Tree(identity='=A0,"b"'))
    write_map_csv(tmp_path / "map.csv", [named])
    assert same(read_given_map(tmp_path / "map.csv", 0.1)[0], named)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"map_t_landmark": np.array([1e300, 0.0])}, "landmark 7: expected position within 1e"),
        ({"covariance": 1e300 * np.eye(2)}, "expected sigmas within"),
        ({"semantics": semantic_object(Kind.TREE, 1e200, 1e198)}, "expected diameter of at most"),
        ({"semantics": Tree(identity="a" * 65)}, "expected identity of at most 64"),
    ],
)
def test_what_is_out_of_all_measure_is_refused(
    tmp_path: Path, changed: dict[str, Any], reason: str
) -> None:
    landmark = replace(LANDMARKS[1], **changed)
    write_map_json(tmp_path / "map.json", [landmark])
    write_map_csv(tmp_path / "map.csv", [landmark])
    for name in ("map.json", "map.csv"):
        with pytest.raises(InputError, match=f"{name}.*{reason}"):
            read_given_map(tmp_path / name, 0.1)


def test_projected_coordinates_are_a_map(tmp_path: Path) -> None:
    path = tmp_path / "stems.csv"
    path.write_text("x,y\n500000,5400000\n")
    assert read_prior_map(path, 0.1).map_t_landmarks.tolist() == [[500_000.0, 5_400_000.0]]


def test_lists_have_kinds_and_diameters(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text("x_m,y_m,kind,diameter_m\n1,2,tree,0.3\n3,4,marker,\n")
    tree, marker = read_given_map(path, 0.2)
    assert tree.semantics.diameter is not None
    assert tree.semantics.diameter.mean_m == 0.3
    assert marker.semantics == semantic_object(Kind.MARKER)
    np.testing.assert_allclose(marker.covariance, 0.04 * np.eye(2))


@pytest.mark.parametrize(
    ("text", "diameter_m"), [("x,y\n1,2\n", None), ("x,y,diameter\n1,2,0.3\n", 0.3)]
)
def test_stems_are_trees(tmp_path: Path, text: str, diameter_m: float | None) -> None:
    """The same lists for `localize` and for `refine`."""
    path = tmp_path / "stems.csv"
    path.write_text(text)
    (tree,) = read_given_map(path, 0.2)
    assert tree.semantics.kind is Kind.TREE
    assert (tree.semantics.diameter and tree.semantics.diameter.mean_m) == diameter_m


@pytest.mark.parametrize(("marks", "diameter_m"), [("20\n30", 0.2), ("0.2\n0.3", 0.2)])
def test_stems_are_in_cm_or_m(tmp_path: Path, marks: str, diameter_m: float) -> None:
    path = tmp_path / "stems.csv"
    one, other = marks.split()
    path.write_text(f"x,y,mark\n1,2,{one}\n3,4,{other}\n")
    first = read_given_map(path, 0.1)[0]
    assert first.semantics.diameter is not None
    assert first.semantics.diameter.mean_m == pytest.approx(diameter_m)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "expected one of the headers"),
        ("a,b\n1,2\n", "expected one of the headers"),
        ("x,y,mark\n", "expected 1 to"),
        ("x,y,mark\n1,2,x\n", "line 2: expected a number"),
        ("x,y,mark\n1,nan,3\n", "line 2: expected finite"),
        ("x,y,mark\n1,2,-3\n", "line 2: diameter"),
        ("x,y,mark\n1,2\n", "line 2: expected 3 values"),
        ("x,y,diameter\n1,2,101\n", "line 2: landmark 0: expected diameter of at most"),
        ("x_m,y_m,kind,diameter_m\n1,2,bush,\n", "line 2: kind"),
        ("x_m,y_m,kind,diameter_m\n1,,tree,\n", "line 2: expected a number"),
    ],
)
def test_what_is_no_map_is_refused_by_line(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=reason):
        read_given_map(path, 0.1)


def test_a_runs_table_with_holes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    write_map_csv(path, LANDMARKS)
    text = path.read_text()
    for old, new in (("3,tree", ",tree"), ("tree", "bush"), (",1.0,2.0,", ",,2.0,")):
        path.write_text(text.replace(old, new, 1))
        with pytest.raises(InputError, match="line 2"):
            read_given_map(path, 0.1)
