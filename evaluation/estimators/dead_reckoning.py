"""Dead reckoning: the wheels' motions one after the other, and nothing that is perceived."""

import numpy as np

from evaluation.estimators.driving import Step, drive, start_of
from evaluation.estimators.estimate import Estimate
from semgraph.errors import InputError
from semgraph.moments import Moment
from semgraph.settings import Settings
from sensors.truth import Source


def estimate(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """The path by the wheels alone, with the covariance that their noise adds up to.

    Raises:
        InputError: the recording has no wheels.
    """
    del rng
    recording = source.recording
    if recording.odometry_noise is None:
        raise InputError(f"{recording.name}: expected wheels for dead reckoning, there are none")
    pose = start_of(recording, settings)

    def step(moment: Moment) -> Step:
        nonlocal pose
        if moment.odometry is not None:
            pose = pose @ moment.odometry
        return Step(pose, np.full(len(moment.perceptions), -1, dtype=np.int64))

    return drive(source, settings, step).estimate()
