"""The graph as it must not be built: the closed form's movement as odometry between its poses.

The closed form has used the very sightings that enter the graph, which so count twice. Beside
`smoothed`, whose motions are independent of them, it shows what that costs: something in the path,
and covariances too small for the errors.
"""

from dataclasses import replace

import numpy as np

from evaluation.estimators.estimate import Estimate
from evaluation.estimators.graph import smoothed_with
from semgraph.fast_estimator import FastStep
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.settings import Settings
from sensors.truth import Source


def estimate(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """Path and map by that graph, all else as `smoothed`."""
    del rng
    return smoothed_with(source, settings, _counted_twice)


def _counted_twice(step: FastStep, map_T_last: Pose2) -> FastStep:
    """The step with its estimate as if wheels had measured it, as surely as it says."""
    last_T_current = map_T_last.between(step.map_T_base.pose)
    return replace(step, motion=UncertainPose2(last_T_current, step.map_T_base.covariance))
