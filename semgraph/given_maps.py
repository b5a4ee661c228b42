"""Maps that are given, to localize in or to refine: what a run wrote, or a list of stems."""

from pathlib import Path
from typing import Final

import numpy as np

from semgraph.errors import InputError
from semgraph.files.map_files import CSV_COLUMNS, read_map_json
from semgraph.files.tables import Row, column_floats, read_csv_rows, read_text
from semgraph.landmarks import Kind, Landmark, semantic_object

LIST_COLUMNS: Final = ("x_m", "y_m", "kind", "diameter_m")
STEM_COLUMNS: Final = (("x", "y"), ("x", "y", "diameter"))
MARK_COLUMNS: Final = ("x", "y", "mark")
_MOST_LANDMARKS: Final = 1_000_000
# Marks are diameters: in cm if half of them are above this, for no stand has such trunks in m.
_LARGEST_MEDIAN_M: Final = 3.0
# A list says nothing of how its diameters were measured, nor at what height.
_LISTED_DIAMETER_SIGMA: Final = 0.1
_LARGEST_LISTED_M: Final = 100.0
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
    landmarks = read_map_json(path) if path.suffix == ".json" else _read_table(path, sigma_m)
    if not 0 < len(landmarks) <= _MOST_LANDMARKS:
        raise InputError(f"{path}: expected 1 to {_MOST_LANDMARKS} landmarks, got {len(landmarks)}")
    return landmarks


def _read_table(path: Path, sigma_m: float) -> tuple[Landmark, ...]:
    header = tuple(read_text(path).split("\n", 1)[0].strip().split(","))
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
        return Landmark(
            int(number),
            semantic_object(
                Kind.from_label(row.cells[_KIND]), diameter, sigma, row.cells[_IDENTITY]
            ),
            np.array([x, y]),
            np.array([[xx, xy], [yx, yy]]),
            int(sightings),
            reliability,
        )
    except InputError as error:
        raise InputError(f"{path} line {row.line}: {error}") from error


def _of_marks(path: Path, sigma_m: float) -> tuple[Landmark, ...]:
    rows = read_csv_rows(path, MARK_COLUMNS)
    values = column_floats(path, rows, slice(None)).reshape(-1, 3)
    is_cm = len(values) > 0 and float(np.median(values[:, 2])) > _LARGEST_MEDIAN_M
    diameters_m = values[:, 2] * (0.01 if is_cm else 1.0)
    return tuple(
        _listed(path, row, Kind.TREE, (x, y, diameter_m), sigma_m)
        for row, (x, y, _), diameter_m in zip(rows, values.tolist(), diameters_m, strict=True)
    )


def _of_list(path: Path, columns: tuple[str, ...], sigma_m: float) -> tuple[Landmark, ...]:
    landmarks = []
    for row in read_csv_rows(path, columns):
        x, y, *more = row.cells
        kind = more[0] if columns == LIST_COLUMNS else Kind.TREE.label
        diameter = more[-1] if more else ""
        numbers = column_floats(path, [Row(row.line, (x, y))], slice(None))[0].tolist()
        known = [Row(row.line, (diameter or "nan",))]
        diameter_m = float(column_floats(path, known, slice(None), finite=False)[0, 0])
        try:
            of_kind = Kind.from_label(kind)
        except InputError as error:
            raise InputError(f"{path} line {row.line}: {error}") from error
        landmarks.append(_listed(path, row, of_kind, (*numbers, diameter_m), sigma_m))
    return tuple(landmarks)


def _listed(
    path: Path, row: Row, kind: Kind, values: tuple[float, float, float], sigma_m: float
) -> Landmark:
    x, y, diameter_m = values
    try:
        if diameter_m > _LARGEST_LISTED_M:
            raise InputError(f"diameter: expected at most {_LARGEST_LISTED_M:g} m")
        return Landmark(
            row.line - 2,
            semantic_object(kind, diameter_m, _LISTED_DIAMETER_SIGMA * diameter_m),
            np.array([x, y]),
            sigma_m**2 * np.eye(2),
            1,
            1.0,
        )
    except InputError as error:
        raise InputError(f"{path} line {row.line}: {error}") from error
