"""The landmark map as map.json, which is read again, and map.csv, for a spreadsheet."""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from semgraph.errors import InputError
from semgraph.files.json_files import STRICT, read_json
from semgraph.files.tables import write_text
from semgraph.landmarks import Kind, Landmark, semantic_object

CSV_COLUMNS = (
    "id",
    "kind",
    "x_m",
    "y_m",
    "covariance_xx_m2",
    "covariance_xy_m2",
    "covariance_yx_m2",
    "covariance_yy_m2",
    "sightings",
    "diameter_m",
    "diameter_sigma_m",
    "identity",
    "reliability",
)


class _LandmarkEntry(BaseModel):
    model_config = STRICT
    id: int
    kind: str
    x_m: float
    y_m: float
    covariance_m2: list[list[float]]
    sightings: int
    diameter_m: float | None
    diameter_sigma_m: float | None
    identity: str
    reliability: float

    def landmark(self) -> Landmark:
        return Landmark(
            self.id,
            semantic_object(
                Kind.from_label(self.kind),
                np.nan if self.diameter_m is None else self.diameter_m,
                np.nan if self.diameter_sigma_m is None else self.diameter_sigma_m,
                self.identity,
            ),
            np.array([self.x_m, self.y_m]),
            np.array(_rectangular(self.covariance_m2)),
            self.sightings,
            self.reliability,
        )


class _Map(BaseModel):
    model_config = STRICT
    landmarks: list[_LandmarkEntry]


def write_map_json(path: Path, landmarks: Sequence[Landmark]) -> None:
    """Writes the map; every number comes back exactly.

    Raises:
        SemgraphError: the file cannot be written.
    """
    entries = ",\n".join(json.dumps(_entry(landmark)) for landmark in landmarks)
    write_text(path, f'{{"landmarks": [\n{entries}\n]}}\n')


def read_map_json(path: Path) -> tuple[Landmark, ...]:
    """The landmarks of a map.json.

    Raises:
        InputError: malformed, or a landmark with values it cannot have.
    """
    entries = read_json(path, _Map).landmarks
    landmarks = []
    for number, entry in enumerate(entries):
        try:
            landmarks.append(entry.landmark())
        except InputError as error:
            raise InputError(f"{path} landmark {number}: {error}") from error
    return tuple(landmarks)


def write_map_csv(path: Path, landmarks: Sequence[Landmark]) -> None:
    """Writes the map as a table; an unknown diameter is an empty cell.

    Raises:
        SemgraphError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for landmark in landmarks:
        entry = _entry(landmark)
        (xx, xy), (yx, yy) = entry.pop("covariance_m2")
        covariance = {"covariance_xx_m2": xx, "covariance_xy_m2": xy}
        covariance |= {"covariance_yx_m2": yx, "covariance_yy_m2": yy}
        cells = entry | covariance
        writer.writerow([cells[column] for column in CSV_COLUMNS])
    write_text(path, text.getvalue())


def _entry(landmark: Landmark) -> dict[str, Any]:
    diameter = landmark.semantics.diameter
    x, y = landmark.map_t_landmark.tolist()
    return {
        "id": int(landmark.id),
        "kind": landmark.semantics.kind.label,
        "x_m": x,
        "y_m": y,
        "covariance_m2": landmark.covariance.tolist(),
        "sightings": int(landmark.num_sightings),
        "diameter_m": diameter and diameter.mean_m,
        "diameter_sigma_m": diameter and diameter.sigma_m,
        "identity": landmark.semantics.identity,
        "reliability": float(landmark.reliability),
    }


def _rectangular(rows: list[list[float]]) -> list[list[float]]:
    if [len(row) for row in rows] != [2, 2]:
        raise InputError("landmark covariance: expected two rows of two numbers")
    return rows
