"""Maps that are given, to localize in or to refine: what a run wrote, or a list of stems."""

from pathlib import Path
from typing import Final

import numpy as np

from semgraph.errors import InputError
from semgraph.files.map_files import CSV_COLUMNS, read_map_json
from semgraph.files.tables import Row, column_floats, read_csv_header, read_csv_rows
from semgraph.landmarks import Kind, Landmark, semantic_object
from sensors.plain_perceptions import LARGEST_M, LONGEST_IDENTITY

LIST_COLUMNS: Final = ("x_m", "y_m", "kind", "diameter_m")
STEM_COLUMNS: Final = (("x", "y"), ("x", "y", "diameter"))
MARK_COLUMNS: Final = ("x", "y", "mark")
MOST_LANDMARKS: Final = 200_000
# Marks are diameters: in cm if half of them are above this, for no stand has such trunks in m.
LARGEST_MEDIAN_M: Final = 3.0
# A list says nothing of how its diameters were measured, nor at what height.
_LISTED_DIAMETER_SIGMA: Final = 0.1
_LARGEST_DIAMETER_M: Final = 100.0
_IDENTITY, _KIND = CSV_COLUMNS.index("identity"), CSV_COLUMNS.index("kind")


def read_given_map(path: Path, sigma_m: float) -> tuple[Landmark, ...]:
    """The landmarks of a map.json, a map.csv, or a list.

    A list has `x_m,y_m,kind,diameter_m`; of trees alone `x,y`, `x,y,diameter`, or `x,y,mark`.

    Args:
        path: the file; of a folder its map.json.
        sigma_m: of the positions in a list, which tells none.

    Raises:
        InputError: none of these, malformed, without a landmark, or too large.
    """
    path = path / "map.json" if path.is_dir() else path
    landmarks = _read_json(path) if path.suffix == ".json" else _read_table(path, sigma_m)
    _check_number(path, len(landmarks))
    return landmarks


def _read_json(path: Path) -> tuple[Landmark, ...]:
    try:
        return tuple(map(_checked, read_map_json(path)))
    except InputError as error:
        raise InputError(error if str(path) in str(error) else f"{path}: {error}") from error


def _check_number(path: Path, count: int) -> None:
    if not 0 < count <= MOST_LANDMARKS:
        raise InputError(f"{path}: expected 1 to {MOST_LANDMARKS} landmarks, got {count}")


def _checked(landmark: Landmark) -> Landmark:
    """The same, if nothing of it is out of all measure."""
    semantics = landmark.semantics
    diameter_m = semantics.diameter.mean_m if semantics.diameter else 0.0
    rules = {
        f"position within {LARGEST_M:g} m": (np.abs(landmark.map_t_landmark) <= LARGEST_M).all(),
        f"sigmas within {LARGEST_M:g} m": (np.abs(landmark.covariance) <= LARGEST_M**2).all(),
        f"diameter of at most {_LARGEST_DIAMETER_M:g} m": diameter_m <= _LARGEST_DIAMETER_M,
        f"identity of at most {LONGEST_IDENTITY} characters": len(semantics.identity)
        <= LONGEST_IDENTITY,
    }
    for rule, holds in rules.items():
        if not holds:
            raise InputError(f"landmark {landmark.id}: expected {rule}")
    return landmark


def _read_table(path: Path, sigma_m: float) -> tuple[Landmark, ...]:
    header = read_csv_header(path)
    if header == CSV_COLUMNS:
        return _of_run(path)
    if header == MARK_COLUMNS:
        return _of_marks(path, sigma_m)
    lists = (LIST_COLUMNS, *STEM_COLUMNS)
    if header in lists:
        return _of_list(path, header, sigma_m)
    known = "; ".join(",".join(columns) for columns in (*lists, MARK_COLUMNS, CSV_COLUMNS))
    raise InputError(f"{path} line 1: expected one of the headers {known}; or a map.json")


def _of_run(path: Path) -> tuple[Landmark, ...]:
    rows = read_csv_rows(path, CSV_COLUMNS)
    numbers = column_floats(path, [_numbers_only(row) for row in rows], slice(None), finite=False)
    return tuple(_landmark(path, row, values) for row, values in zip(rows, numbers, strict=True))


def _numbers_only(row: Row) -> Row:
    """Empty cells are unknown numbers; kind and identity are none."""
    cells = [cell or "nan" for cell in row.cells]
    cells[_KIND] = cells[_IDENTITY] = "0"
    return Row(row.line, tuple(cells))


def _landmark(path: Path, row: Row, values: np.ndarray) -> Landmark:
    number, _, x, y, xx, xy, yx, yy, sightings, diameter, sigma, _, reliability = values.tolist()
    try:
        if not np.isfinite([number, sightings]).all():
            raise InputError("expected a number for id and sightings")
        landmark = Landmark(
            int(number),
            semantic_object(
                Kind.from_label(row.cells[_KIND]), diameter, sigma, row.cells[_IDENTITY]
            ),
            np.array([x, y]),
            np.array([[xx, xy], [yx, yy]]),
            int(sightings),
            reliability,
        )
        return _checked(landmark)
    except InputError as error:
        raise InputError(f"{path} line {row.line}: {error}") from error


def _of_marks(path: Path, sigma_m: float) -> tuple[Landmark, ...]:
    rows = read_csv_rows(path, MARK_COLUMNS)
    values = column_floats(path, rows, slice(None)).reshape(-1, 3)
    is_cm = len(values) > 0 and float(np.median(values[:, 2])) > LARGEST_MEDIAN_M
    diameters_m = values[:, 2] * (0.01 if is_cm else 1.0)
    return tuple(
        _listed(path, row, Kind.TREE, (x, y, diameter_m), sigma_m)
        for row, (x, y, _), diameter_m in zip(rows, values.tolist(), diameters_m, strict=True)
    )


def _of_list(path: Path, columns: tuple[str, ...], sigma_m: float) -> tuple[Landmark, ...]:
    rows = read_csv_rows(path, columns)
    _check_number(path, len(rows))
    places = column_floats(path, rows, slice(0, 2)).tolist()
    has_diameters = columns[-1].startswith("diameter")
    known = [Row(row.line, (row.cells[-1] or "nan" if has_diameters else "nan",)) for row in rows]
    diameters_m = column_floats(path, known, slice(None), finite=False)[:, 0].tolist()
    landmarks = []
    for row, place, diameter_m in zip(rows, places, diameters_m, strict=True):
        kind = row.cells[2] if columns == LIST_COLUMNS else Kind.TREE.label
        try:
            of_kind = Kind.from_label(kind)
        except InputError as error:
            raise InputError(f"{path} line {row.line}: {error}") from error
        landmarks.append(_listed(path, row, of_kind, (*place, diameter_m), sigma_m))
    return tuple(landmarks)


def _listed(
    path: Path, row: Row, kind: Kind, values: tuple[float, float, float], sigma_m: float
) -> Landmark:
    x, y, diameter_m = values
    try:
        landmark = Landmark(
            row.line - 2,
            semantic_object(kind, diameter_m, _LISTED_DIAMETER_SIGMA * diameter_m),
            np.array([x, y]),
            sigma_m**2 * np.eye(2),
            1,
            1.0,
        )
        return _checked(landmark)
    except InputError as error:
        raise InputError(f"{path} line {row.line}: {error}") from error
