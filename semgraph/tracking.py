"""What follows objects for the graph: one hypothesis of the fast estimator's, or many."""

from typing import Protocol

import numpy as np

from semgraph.errors import InputError
from semgraph.fast_estimator import FastEstimator, FastStep
from semgraph.geometry import UncertainPose2
from semgraph.hypotheses import HypothesesTracker
from semgraph.landmarks import Perceptions
from semgraph.settings import TrackerSettings
from sensors.measurements import Recording


class Tracker(Protocol):
    """It numbers what is perceived, scan by scan."""

    def step(self, perceptions: Perceptions, odometry: UncertainPose2 | None) -> FastStep:
        """The object that each perception is of, and the movement to here."""
        ...


def num_hypotheses(recording: Recording, settings: TrackerSettings) -> int:
    """As many as the settings say; unless they do, as the recording asks for."""
    return settings.hypotheses or recording.num_hypotheses


def tracker_of(recording: Recording, settings: TrackerSettings) -> Tracker:
    """With as many hypotheses as `num_hypotheses` says.

    Raises:
        InputError: many hypotheses, and no odometry to move them.
    """
    hypotheses = num_hypotheses(recording, settings)
    if hypotheses == 1:
        return FastEstimator(settings, recording.map_T_start)
    if recording.odometry_noise is None:
        raise InputError(
            f"{recording.name}: expected wheel odometry for {hypotheses} hypotheses, there is "
            "none; set tracker.hypotheses=1"
        )
    rng = np.random.default_rng(settings.seed)
    return HypothesesTracker(hypotheses, settings.map_sigma_m, recording.map_T_start, rng)
