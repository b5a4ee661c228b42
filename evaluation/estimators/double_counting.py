"""The graph as it must not be built: the closed form's movement as odometry between its poses.

The closed form has used the very sightings that enter the graph, which so count twice. Beside
`smoothed`, whose motions are independent of them, it shows what that costs: something in the path,
and covariances too small for the errors.
"""

from dataclasses import replace

import numpy as np

from evaluation.estimators.driving import Step, drive
from evaluation.estimators.estimate import Estimate
from semgraph.fast_estimator import FastEstimator, FastStep
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.graph_beside import GraphInProcess
from semgraph.pipeline import Moment
from semgraph.progress import Silence
from semgraph.settings import Settings
from sensors.truth import Source


def estimate(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """Path and map by that graph, all else as `smoothed`."""
    del rng
    map_T_last = source.recording.map_T_start
    tracker = FastEstimator(settings.tracker, map_T_last)
    graph = GraphInProcess(settings.smoother, map_T_last)

    def step(moment: Moment) -> Step:
        nonlocal map_T_last
        tracked = tracker.step(moment.perceptions, moment.odometry)
        graph.add(_counted_twice(tracked, map_T_last), moment.perceptions, moment.views)
        map_T_last = tracked.map_T_base.pose
        return Step(tracked.map_T_base, tracked.landmark_ids)

    said = drive(source, settings, step)
    made = graph.finish(Silence().note)
    return Estimate(
        made.trajectory,
        made.covariances,
        made.landmarks,
        made.associations,
        np.array(said.seconds),
    )


def _counted_twice(step: FastStep, map_T_last: Pose2) -> FastStep:
    """The step with its estimate as if wheels had measured it, as surely as it says."""
    last_T_current = map_T_last.between(step.map_T_base.pose)
    return replace(step, motion=UncertainPose2(last_T_current, step.map_T_base.covariance))
