"""Localization in a given map: by particles alone, and by both estimators together.

The map is a condition of the study, not something that the estimators find: the true landmarks,
each moved by an error of the standard deviation that the map states (`localizer.listed_sigma_m`).
"""

from typing import Final

import numpy as np

from evaluation.estimators.driving import Step, drive, start_of
from evaluation.estimators.estimate import Estimate
from evaluation.trajectory import true_poses
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from semgraph.known_map.fixed_map import FixedMap
from semgraph.landmarks import Kind, Landmark, semantic_object
from semgraph.localizer import Localizer, Start, Use
from semgraph.moments import Moment
from semgraph.settings import Settings
from sensors.truth import Source

# Diameters in the map are as somebody with a tape measures them.
_DIAMETER_SIGMA: Final = 0.05
_LARGEST_SEED: Final = 2**31


def particles(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """The path in a given map by the particle filter alone (paper section 3.2).

    Raises:
        InputError: the truth has no landmarks or poses, so there is no map to give.
    """
    return _follow(source, settings, rng, Use.PARTICLES)


def combined(source: Source, settings: Settings, rng: np.random.Generator) -> Estimate:
    """The path in a given map by both estimators together (end of section 3.3).

    Raises:
        InputError: the truth has no landmarks or poses, so there is no map to give.
    """
    return _follow(source, settings, rng, Use.BOTH)


def given_map(source: Source, sigma_m: float, rng: np.random.Generator) -> tuple[Landmark, ...]:
    """The true landmarks in the recording's frame map, each off by sigma_m along each axis.

    Raises:
        InputError: the truth has no landmarks, poses or headings.
    """
    path, true = source.truth.path, source.truth.landmarks
    world_T_bases = None if path is None else true_poses(path)
    if world_T_bases is None or true is None or not len(true.kinds):
        raise InputError(
            f"{source.recording.name}: expected true poses and landmarks for a map to localize in"
        )
    world_T_start = Pose2.from_array(world_T_bases[0])
    map_T_world = source.recording.map_T_start @ world_T_start.inverse()
    places = map_T_world.transform(true.world_t_landmarks)
    places = places + sigma_m * rng.standard_normal(places.shape)
    factors = np.exp(_DIAMETER_SIGMA * rng.standard_normal(len(places)))
    covariance = sigma_m**2 * np.eye(2)
    return tuple(
        Landmark(
            row,
            semantic_object(Kind(kind), diameter_m, _DIAMETER_SIGMA * diameter_m),
            place,
            covariance,
            1,
            1.0,
        )
        for row, (kind, diameter_m, place) in enumerate(
            zip(true.kinds.tolist(), (true.diameters_m * factors).tolist(), places, strict=True)
        )
    )


def _follow(source: Source, settings: Settings, rng: np.random.Generator, use: Use) -> Estimate:
    chosen = settings.localizer
    landmarks = given_map(source, chosen.listed_sigma_m, rng)
    start = Start(start_of(source.recording, settings))
    with_seed = {"use": use, "seed": int(rng.integers(_LARGEST_SEED))}
    localizer = Localizer(
        FixedMap.of_landmarks(landmarks), chosen.model_copy(update=with_seed), start
    )

    def step(moment: Moment) -> Step:
        found = localizer.step(moment.perceptions, moment.odometry)
        return Step(found.map_T_base, np.full(len(moment.perceptions), -1, dtype=np.int64))

    return drive(source, settings, step).estimate()
