"""Estimators by name; each is imported only when it is asked for."""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, cast

from evaluation.estimators.estimate import Estimator
from semgraph.errors import InputError, known_names


@dataclass(frozen=True, slots=True)
class Entry:
    """Where an estimator is, and what it is in one line.

    `maps` is false of those that localize in a given map.
    """

    module: str
    function: str
    what: str
    maps: bool = True

    def load(self) -> Estimator:
        """The estimator itself."""
        module = importlib.import_module(f"evaluation.estimators.{self.module}")
        return cast(Estimator, getattr(module, self.function))


ESTIMATORS: Final[Mapping[str, Entry]] = {
    "dead-reckoning": Entry(
        "dead_reckoning", "estimate", "the wheels alone, no landmark", maps=False
    ),
    "paper": Entry("fast", "paper", "the paper's rules as printed, constant motion, no wheels"),
    "fast": Entry("fast", "estimate", "the fast estimator: the paper's three steps, mended"),
    "particle-filter": Entry(
        "localizing", "particles", "the particle filter alone in a given map", maps=False
    ),
    "combined": Entry(
        "localizing", "combined", "particles and fast estimator in a given map", maps=False
    ),
    "smoothed": Entry("graph", "smoothed", "online iSAM2 with joint compatibility and odds"),
    "refined": Entry("graph", "refined", "all of it in one batch, associations decided anew"),
    "double-counting": Entry(
        "double_counting", "estimate", "the graph with the closed form as odometry: a warning"
    ),
    "ekf-slam": Entry("ekf_slam", "estimate", "EKF-SLAM, maximum likelihood under joint gates"),
    "plain-isam2": Entry("plain_isam2", "estimate", "iSAM2 as it comes, nearest neighbours"),
    "oracle": Entry("known", "estimate", "the batch optimum with true associations: the limit"),
}


def estimator(name: str) -> Estimator:
    """The estimator of that name.

    Raises:
        InputError: there is none.
    """
    entry = ESTIMATORS.get(name)
    if entry is None:
        raise InputError(f"unknown estimator {name!r}, {known_names(name, ESTIMATORS)}")
    return entry.load()
