"""Reads the Victoria Park graph that the gtsam wheel carries, without importing gtsam.

A text file: `ODOMETRY i j x y theta` and six numbers of covariance, `LANDMARK i l x y` and three.
"""

import importlib.util
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from semgraph.arrays import IntArray
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors import utility_car
from sensors.dead_reckoning import in_order_of_time
from sensors.files import is_there, read_text
from sensors.measurements import Recording, WheelOdometry
from sensors.truth import Source, Truth

GRAPH_FILE = "victoria_park.txt"
MAX_GRAPH_BYTES = 64 * 2**20

SECONDS_A_POSE = 0.2
"""The file has no times: the k-th pose is stamped k times this, about the laser's rate."""
RANGE_SIGMA_M = 0.10
BEARING_SIGMA = 0.010
"""Of the sightings, stated in place of the file's (0.63 m in x and y at any range).

About the optimum with known identities their residuals have a robust sd of 0.05 m and 0.004 rad,
with tails (rms 0.19 m and 0.023 rad); twice the core covers most of them."""

_NUM_FIELDS = {"ODOMETRY": 12, "LANDMARK": 8}


class VictoriaParkGraphOptions(BaseModel, extra="forbid", frozen=True):
    """What a user may set: `identities` gives the estimator the landmarks' identities."""

    identities: bool = False


@dataclass(frozen=True, slots=True)
class _Graph:
    """Poses of dead reckoning by key, in order, and the sightings (landmark, x, y) of each."""

    poses: dict[int, Pose2] = field(default_factory=lambda: {0: Pose2()})
    sightings: dict[int, list[tuple[int, float, float]]] = field(default_factory=dict)


def recognises(folder: Path) -> bool:
    """Whether the graph's file lies in the folder."""
    return is_there(folder / GRAPH_FILE)


def gtsam_data() -> Path:
    """The folder of examples in the installed gtsam.

    Raises:
        InputError: gtsam is not installed.
    """
    spec = importlib.util.find_spec("gtsam")
    if spec is None or not spec.submodule_search_locations:
        raise InputError("victoria-park-graph: expected gtsam to be installed, it is not")
    return Path(spec.submodule_search_locations[0]) / "Data"


def read(path: Path, options: VictoriaParkGraphOptions) -> Source:
    """The graph's odometry and sightings from base, the rear axle; its identities as truth.

    Only poses that sight something count as scans. Landmark identities are rows of no table: their
    positions are not known.

    Raises:
        InputError: the file is missing, damaged, or no chain of poses.
    """
    graph = _graph(path / GRAPH_FILE)
    if not graph.sightings:
        raise InputError(f"{path / GRAPH_FILE}: expected at least one LANDMARK, there is none")
    stamps = {key: _stamp_ns(k) for k, key in enumerate(graph.poses)}
    sets = [
        _perceptions(stamps[key], seen, identities=options.identities)
        for key, seen in sorted(graph.sightings.items(), key=lambda item: stamps[item[0]])
    ]
    odometry = [WheelOdometry(stamps[key], pose) for key, pose in graph.poses.items()]
    recording = Recording(
        name="victoria-park-graph",
        measurements=in_order_of_time(odometry, sets),
        num_scans=len(sets),
        odometry_noise=utility_car.ODOMETRY_NOISE,
    )
    return Source(recording, Truth(associations=_associations(graph, stamps)))


def _stamp_ns(k: int) -> int:
    return round(k * SECONDS_A_POSE * 1e9)


def _perceptions(
    stamp_ns: int, seen: list[tuple[int, float, float]], *, identities: bool
) -> Perceptions:
    keys, x, y = zip(*seen, strict=True)
    n = len(seen)
    return Perceptions.from_arrays(
        stamp_ns,
        Kind.TREE,
        np.hypot(x, y),
        np.arctan2(y, x),
        polar_covariances(np.full(n, RANGE_SIGMA_M), np.full(n, BEARING_SIGMA)),
        identities=np.array(keys).astype(np.str_) if identities else None,
    )


def _associations(graph: _Graph, stamps: dict[int, int]) -> dict[int, IntArray]:
    """Rows count the landmarks in the order of their keys."""
    keys = np.unique([key for seen in graph.sightings.values() for key, _, _ in seen])
    return {
        stamps[pose]: np.searchsorted(keys, [key for key, _, _ in seen])
        for pose, seen in graph.sightings.items()
    }


def _graph(file: Path) -> _Graph:
    graph = _Graph()
    last = 0
    for line, kind, i, j, values in _records(file):
        if i not in graph.poses:
            raise InputError(f"{file}: line {line}: expected a pose met before, got {i}")
        if kind == "LANDMARK":
            graph.sightings.setdefault(i, []).append((j, values[0], values[1]))
            continue
        if i != last or j in graph.poses:
            raise InputError(f"{file}: line {line}: expected a chain of poses, got {i} to {j}")
        graph.poses[j] = graph.poses[i] @ Pose2(*values[:3])
        last = j
    return graph


def _records(file: Path) -> Iterator[tuple[int, str, int, int, list[float]]]:
    """Line number, kind, the two keys and the numbers of each line."""
    for line, text in enumerate(read_text(file, MAX_GRAPH_BYTES).splitlines(), start=1):
        kind, *fields = text.split() or [""]
        if len(fields) + 1 != _NUM_FIELDS.get(kind):
            raise InputError(
                f"{file}: line {line}: expected ODOMETRY with 11 or LANDMARK with 7 numbers, "
                f"got {text[:40]!r}"
            )
        try:
            i, j = int(fields[0]), int(fields[1])
            values = [float(number) for number in fields[2:]]
        except ValueError as error:
            raise InputError(f"{file}: line {line}: expected numbers: {error}") from error
        if not all(abs(number) < 1e9 for number in (*values, i, j)):
            raise InputError(f"{file}: line {line}: expected finite numbers below 1e9")
        if kind == "LANDMARK" and math.hypot(values[0], values[1]) <= 0.0:
            raise InputError(f"{file}: line {line}: expected a landmark apart from the pose")
        yield line, kind, i, j, values
