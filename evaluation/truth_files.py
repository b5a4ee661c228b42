"""The truth beside a run's files, so that it can be judged again from them alone."""

import re
from pathlib import Path
from typing import Final

import numpy as np
import tomli_w
from pydantic import BaseModel, ValidationError

from semgraph.arrays import IntArray
from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.files.json_files import STRICT, first_fault
from semgraph.files.tables import (
    Row,
    column_floats,
    column_stamps_ns,
    read_csv_rows,
    stamp_text,
    write_text,
)
from semgraph.files.trajectory_files import read_tum, write_tum
from semgraph.landmarks import Kind
from semgraph.results import read_toml
from sensors.truth import TrueLandmarks, TruePath, Truth

TRUTH_TOML = "truth.toml"
TRUTH_TUM = "truth.tum"
TRUTH_LANDMARKS_CSV = "truth_landmarks.csv"
TRUTH_ASSOCIATIONS_CSV = "truth_associations.csv"
LANDMARK_COLUMNS = ("x_m", "y_m", "kind", "diameter_m")
_ASSOCIATION_COLUMNS = ("stamp_s", "landmarks")
_NOTE = "positions of the reference point, in the truth's own frame; the map's frame is another"
_MAX_LANDMARKS: Final = 10**9
_WHOLE_NUMBER: Final = re.compile(r"-1|0|[1-9][0-9]{0,8}")


class _Path(BaseModel):
    model_config = STRICT
    num_fixes: int
    headings_known: bool
    base_t_reference: list[float]
    has_outliers: bool
    sigma_m: float


class _Truth(BaseModel):
    model_config = STRICT
    frame: str
    num_landmarks: int | None = None
    num_associations: int | None = None
    path: _Path | None = None


def write_truth(folder: Path, truth: Truth) -> None:
    """Writes what is known of the truth into a folder that is there.

    Raises:
        SemgraphError: a file cannot be written.
    """
    path = truth.path
    contents = _Truth(
        frame=_NOTE,
        num_landmarks=None if truth.landmarks is None else len(truth.landmarks.kinds),
        num_associations=None if truth.associations is None else len(truth.associations),
        path=None if path is None else _path_entry(path),
    )
    if path is not None:
        headings = np.zeros(len(path.stamps_ns)) if path.headings is None else path.headings
        poses = np.column_stack([path.world_t_reference, headings])
        write_tum(folder / TRUTH_TUM, Trajectory(path.stamps_ns, poses))
    if truth.landmarks is not None:
        _write_landmarks(folder / TRUTH_LANDMARKS_CSV, truth.landmarks)
    if truth.associations is not None:
        _write_associations(folder / TRUTH_ASSOCIATIONS_CSV, truth.associations)
    write_text(folder / TRUTH_TOML, tomli_w.dumps(contents.model_dump(exclude_none=True)))


def read_truth(folder: Path) -> Truth:
    """What is known of the truth; nothing if there is no truth.toml, which tells what there is.

    Raises:
        InputError: a file is missing, cut short or malformed.
    """
    if not (folder / TRUTH_TOML).exists():
        return Truth()
    try:
        contents = _Truth.model_validate(read_toml(folder / TRUTH_TOML))
    except ValidationError as error:
        raise InputError(f"{folder / TRUTH_TOML}: {first_fault(error)}") from error
    path = landmarks = associations = None
    if contents.path is not None:
        path = _read_path(folder / TRUTH_TUM, contents.path)
    if contents.num_landmarks is not None:
        landmarks = read_true_landmarks(folder / TRUTH_LANDMARKS_CSV)
        _check_count(folder / TRUTH_LANDMARKS_CSV, contents.num_landmarks, len(landmarks.kinds))
    if contents.num_associations is not None:
        limit = contents.num_landmarks
        associations = _read_associations(folder / TRUTH_ASSOCIATIONS_CSV, limit)
        _check_count(folder / TRUTH_ASSOCIATIONS_CSV, contents.num_associations, len(associations))
    return Truth(path, landmarks, associations)


def read_true_landmarks(path: Path) -> TrueLandmarks:
    """The true landmarks of a table `x_m,y_m,kind,diameter_m`; no diameter is an empty cell.

    Raises:
        InputError: malformed, or an unknown kind.
    """
    rows = read_csv_rows(path, LANDMARK_COLUMNS)
    kinds = [_kind(path, row) for row in rows]
    known = [Row(row.line, (row.cells[3] or "nan",)) for row in rows]
    return TrueLandmarks(
        column_floats(path, rows, slice(0, 2)).reshape(-1, 2),
        np.array(kinds, dtype=np.int64),
        column_floats(path, known, slice(0, 1), finite=False).reshape(-1),
    )


def _path_entry(path: TruePath) -> _Path:
    return _Path(
        num_fixes=len(path.stamps_ns),
        headings_known=path.headings is not None,
        base_t_reference=path.base_t_reference.tolist(),
        has_outliers=bool(path.has_outliers),
        sigma_m=float(path.sigma_m),
    )


def _read_path(file: Path, entry: _Path) -> TruePath:
    fixes = read_tum(file)
    _check_count(file, entry.num_fixes, len(fixes))
    try:
        return TruePath(
            fixes.stamps_ns,
            fixes.map_T_bases[:, :2],
            fixes.map_T_bases[:, 2] if entry.headings_known else None,
            np.array(entry.base_t_reference),
            entry.has_outliers,
            entry.sigma_m,
        )
    except InputError as error:
        raise InputError(f"{file.with_name(TRUTH_TOML)}: {error}") from error


def _write_landmarks(path: Path, landmarks: TrueLandmarks) -> None:
    lines = [",".join(LANDMARK_COLUMNS)]
    for (x, y), kind, diameter_m in zip(
        landmarks.world_t_landmarks.tolist(),
        landmarks.kinds,
        landmarks.diameters_m.tolist(),
        strict=True,
    ):
        known = "" if np.isnan(diameter_m) else repr(diameter_m)
        lines.append(f"{x!r},{y!r},{Kind(kind).label},{known}")
    write_text(path, "\n".join(lines) + "\n")


def _write_associations(path: Path, associations: dict[int, IntArray]) -> None:
    lines = [",".join(_ASSOCIATION_COLUMNS)]
    for stamp_ns in sorted(associations):
        rows = " ".join(str(row) for row in associations[stamp_ns].tolist())
        lines.append(f"{stamp_text(stamp_ns)},{rows}")
    write_text(path, "\n".join(lines) + "\n")


def _read_associations(path: Path, num_landmarks: int | None) -> dict[int, IntArray]:
    rows = read_csv_rows(path, _ASSOCIATION_COLUMNS)
    stamps_ns = column_stamps_ns(path, rows).tolist()
    return {
        stamp_ns: _landmark_rows(path, row, num_landmarks)
        for stamp_ns, row in zip(stamps_ns, rows, strict=True)
    }


def _landmark_rows(path: Path, row: Row, num_landmarks: int | None) -> IntArray:
    """The true landmark of each perception; where none are known, any number stands for one."""
    limit = _MAX_LANDMARKS if num_landmarks is None else num_landmarks
    rows: list[int] = []
    for cell in row.cells[1].split():
        number = int(cell) if _WHOLE_NUMBER.fullmatch(cell) else limit
        if not -1 <= number < limit:
            raise InputError(
                f"{path} line {row.line}: expected rows from -1 to {limit - 1}, got {cell[:40]!r}"
            )
        rows.append(number)
    return np.array(rows, dtype=np.int64)


def _kind(path: Path, row: Row) -> Kind:
    try:
        return Kind.from_label(row.cells[2])
    except InputError as error:
        raise InputError(f"{path} line {row.line}: {error}") from None


def _check_count(path: Path, promised: int, count: int) -> None:
    if promised != count:
        raise InputError(f"{path}: expected {promised} entries as {TRUTH_TOML} says, got {count}")
