"""A short course for all estimators: a loop of 23 s with wheels, twice the same with one seed."""

from functools import cache

import numpy as np

from evaluation.estimators.catalog import estimator
from evaluation.estimators.estimate import Estimate
from semgraph.settings import Settings
from sensors.catalog import open_source
from sensors.truth import Source

_OPTIONS = {
    "track_radius_m": 10.0,
    "num_trees": 40,
    "lap_s": 20.0,
    "overlap_s": 3.0,
    "scan_rate_hz": 6.0,
    "odometry": True,
}


@cache
def short_course(seed: int) -> Source:
    return open_source("course:perceptions", {"seed": seed, **_OPTIONS})


@cache
def estimated(name: str, seed: int) -> Estimate:
    return estimator(name)(short_course(seed), Settings(), np.random.default_rng(seed))
