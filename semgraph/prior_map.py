"""A map from before: an earlier run's, or a list of stems with one sigma for all."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from semgraph.errors import InputError
from semgraph.landmarks import Kind, Landmark
from semgraph.map_files import CSV_COLUMNS, read_map_json
from semgraph.tables import read_text
from sensors.text_table import TextTable

_MAX_LANDMARKS: Final = 200_000
_LARGEST_M: Final = 1e6
# A list says nothing of how its diameters were measured, nor at what height.
_DIAMETER_SIGMA: Final = 0.1
_COVARIANCE: Final = CSV_COLUMNS[4:8]
# What lies in a run's folder.
_RUN_MAP: Final = "map.json"


@dataclass(frozen=True, slots=True, eq=False)
class PriorMap:
    """Landmarks as somebody had them before, each by itself.

    Attributes:
        names: (k) what the file calls each.
        kinds: (k,) codes of `Kind`.
        map_t_landmarks: (k, 2) m.
        covariances: (k, 2, 2) m2, positive definite.
        diameters_m, diameter_sigmas_m: (k,) NaN where unknown.
        identities: (k) text, empty where there is none.

    Raises:
        InputError: shapes disagree, or a value is out of its domain.
    """

    names: tuple[str, ...]
    kinds: IntArray
    map_t_landmarks: FloatArray
    covariances: FloatArray
    diameters_m: FloatArray
    diameter_sigmas_m: FloatArray
    identities: tuple[str, ...]

    def __post_init__(self) -> None:
        k = len(self.names)
        checked = {
            "kinds": frozen_ints("kinds", self.kinds, (k,)),
            "map_t_landmarks": frozen_floats("positions", self.map_t_landmarks, (k, 2)),
            "covariances": frozen_floats("covariances", self.covariances, (k, 2, 2)),
            "diameters_m": frozen_floats("diameters", self.diameters_m, (k,), finite=False),
            "diameter_sigmas_m": frozen_floats(
                "diameter sigmas", self.diameter_sigmas_m, (k,), finite=False
            ),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if not 0 < k <= _MAX_LANDMARKS:
            raise InputError(f"expected 1 to {_MAX_LANDMARKS} landmarks, got {k}")
        try:
            np.linalg.cholesky(self.covariances)
        except np.linalg.LinAlgError:
            raise InputError("expected positive definite covariances") from None

    def __len__(self) -> int:
        return len(self.names)

    def select(self, rows: IntArray) -> "PriorMap":
        """Some of the landmarks."""
        return PriorMap(
            tuple(self.names[row] for row in rows.tolist()),
            self.kinds[rows],
            self.map_t_landmarks[rows],
            self.covariances[rows],
            self.diameters_m[rows],
            self.diameter_sigmas_m[rows],
            tuple(self.identities[row] for row in rows.tolist()),
        )

    @classmethod
    def of_landmarks(cls, landmarks: Sequence[Landmark]) -> Self:
        """The landmarks of a run."""
        diameters = [each.semantics.diameter for each in landmarks]
        return cls(
            tuple(str(each.id) for each in landmarks),
            np.array([each.semantics.kind for each in landmarks], dtype=np.int64),
            np.array([each.map_t_landmark for each in landmarks]).reshape(-1, 2),
            np.array([each.covariance for each in landmarks]).reshape(-1, 2, 2),
            np.array([each.mean_m if each else np.nan for each in diameters]),
            np.array([each.sigma_m if each else np.nan for each in diameters]),
            tuple(each.semantics.identity for each in landmarks),
        )


def read_prior_map(path: Path, sigma_m: float) -> PriorMap:
    """The map of a run's folder, a map.json, a map.csv, or a table x,y with or without diameter.

    Args:
        path: a file or folder.
        sigma_m: of one axis, of all landmarks of a table that says nothing of it.

    Raises:
        InputError: unreadable, or nothing that a map may be.
    """
    file = path / _RUN_MAP if path.is_dir() else path
    try:
        if file.suffix == ".json":
            return PriorMap.of_landmarks(read_map_json(file))
        header = read_text(file).partition("\n")[0]
        return _of_run(file) if "covariance" in header else _of_stems(file, sigma_m)
    except InputError as error:
        raise InputError(error if str(file) in str(error) else f"{file}: {error}") from error


def _of_run(file: Path) -> PriorMap:
    table = TextTable.of_csv(file, CSV_COLUMNS)
    xx, xy, yx, yy = (table.numbers(name) for name in _COVARIANCE)
    covariances = np.stack([xx, 0.5 * (xy + yx), 0.5 * (xy + yx), yy], axis=1).reshape(-1, 2, 2)
    return PriorMap(
        tuple(table.text("id")),
        np.array([Kind.from_label(label) for label in table.text("kind")], dtype=np.int64),
        _positions(table, "x_m", "y_m"),
        covariances,
        table.numbers("diameter_m", above=0.0, or_none=True),
        table.numbers("diameter_sigma_m", above=0.0, or_none=True),
        tuple(table.text("identity")),
    )


def _of_stems(file: Path, sigma_m: float) -> PriorMap:
    table = TextTable.of_csv(file, ("x", "y"), ("diameter",))
    k = len(table)
    diameters_m = np.full(k, np.nan)
    if "diameter" in table.columns:
        diameters_m = table.numbers("diameter", above=0.0, at_most=100.0, or_none=True)
    return PriorMap(
        tuple(str(line) for line in table.lines.tolist()),
        np.full(k, Kind.TREE),
        _positions(table, "x", "y"),
        np.broadcast_to(sigma_m**2 * np.eye(2), (k, 2, 2)),
        diameters_m,
        _DIAMETER_SIGMA * diameters_m,
        ("",) * k,
    )


def _positions(table: TextTable, x: str, y: str) -> FloatArray:
    return np.column_stack(
        [table.numbers(name, above=-_LARGEST_M, at_most=_LARGEST_M) for name in (x, y)]
    )
