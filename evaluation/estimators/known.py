"""What is possible: the batch optimum with the true associations."""

from dataclasses import replace

import numpy as np

from evaluation.estimators.driving import in_order
from evaluation.estimators.estimate import Estimate
from evaluation.oracle import oracle
from semgraph.errors import InputError
from semgraph.landmarks import Landmark
from semgraph.settings import Settings
from sensors.truth import Source


def estimate(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """The oracle's path, and of its map what was sighted often enough.

    Raises:
        InputError: without true poses and landmarks there are no true associations.
    """
    del rng
    recording = in_order(source.recording)
    best = oracle(replace(source, recording=recording), settings)
    if not len(best.trajectory):
        raise InputError(f"{recording.name}: expected scans or perceptions, there are none")
    landmarks = tuple(
        Landmark(
            row, known.semantics(), place, best.landmark_covariances[row], known.num_sightings, 1.0
        )
        for row, place in sorted(best.map_t_landmarks.items())
        if (known := best.known[row]).num_sightings >= settings.smoother.min_sightings
    )
    return Estimate(best.trajectory, best.covariances, landmarks, best.associations)
