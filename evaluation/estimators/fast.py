"""The fast estimator alone (paper section 3.3), in this project's version and as printed."""

from dataclasses import replace

import numpy as np

from evaluation.estimators.driving import Step, drive
from evaluation.estimators.estimate import Estimate
from semgraph.fast_estimator import FastEstimator, FastSettings, Rules
from semgraph.moments import Moment
from semgraph.settings import Settings
from sensors.truth import Source


def estimate(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """Path and map of the fast estimator.

    Its covariances are relative to the landmarks around and no claim about the path: none are
    given.
    """
    del rng
    return _follow(source, settings, settings.fast)


def paper(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """Path and map by the rules as they are printed.

    Nearest landmark within the radius, the rotation of the lowest mean deviation, four free
    unknowns with equal weights, the plain mean of all sightings. The proposed frame is the last
    movement once more: the paper uses no wheels, so neither does this.
    """
    del rng
    recording = replace(source.recording, odometry_noise=None)
    literal = settings.fast.model_copy(update={"rules": Rules.PAPER})
    return _follow(replace(source, recording=recording), settings, literal)


def _follow(source: Source, settings: Settings, chosen: FastSettings) -> Estimate:
    estimator = FastEstimator(chosen, source.recording.map_T_start)

    def step(moment: Moment) -> Step:
        now = estimator.step(moment.perceptions, moment.odometry)
        return Step(now.map_T_base, now.landmark_ids)

    said = drive(source, settings, step)
    return said.estimate(tuple(estimator.navigation_map), has_covariances=False)
