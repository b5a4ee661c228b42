"""Sightings that count twice make covariances too small."""

import numpy as np

from evaluation.estimators.catalog import estimator
from evaluation.studies.judging import judge_estimate
from semgraph.settings import Settings
from sensors.catalog import open_source


def nees(name: str, seed: int) -> float:
    source = open_source("course:perceptions", {"lap_s": 12.0, "num_trees": 60, "seed": seed})
    estimate = estimator(name)(source, Settings(), np.random.default_rng(0))
    return {each.name: each.value for each in judge_estimate(estimate, source)}["nees_mean"]


def test_who_counts_twice_is_surer_than_right() -> None:
    seeds = range(1, 4)
    honest = [nees("smoothed", seed) for seed in seeds]
    twice = [nees("double-counting", seed) for seed in seeds]
    assert np.mean(twice) > 1.1 * np.mean(honest)
