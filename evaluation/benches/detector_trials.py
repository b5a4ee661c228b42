"""Simulated scans with their truth, and how a detector did on them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from detectors.detector import Detector
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import Pose2, wrap_angle
from semgraph.landmarks import Perceptions
from sensors.measurements import LaserScan, Raw
from sensors.simulation.lms151 import Lms151
from sensors.simulation.ray_casting import visible_arcs
from sensors.simulation.world import StandSettings, Thing, World, stand_of_trees
from sensors.simulation.world_3d import World3d

SCANS_PER_STAND = 4
MAX_MATCH_M = 0.3
RELIABLE = 0.7
Seen = TypeVar("Seen", bound=Raw)
_PLACES_M = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Trial(Generic[Seen]):
    """A scan and what there was to see; rows of `world`.

    Attributes:
        distances_m, bearings: (n,) of each thing's centre from the laser.
        num_beams: (n,) that each thing answers; of a cloud, rows of three and more.
        visible_shares: (n,) of its width that nothing nearer hides.
    """

    world: World | World3d
    scan: Seen
    distances_m: FloatArray
    bearings: FloatArray
    num_beams: IntArray
    visible_shares: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes:
    """All trials together: m things there were, n perceptions came.

    Attributes:
        thing_distances_m, thing_beams, thing_shares: (m,) as in `Trial`.
        found: (m,) a perception fell to it.
        ranges_m, reliabilities: (n,).
        matched: (n,) code of the thing that a perception fell to, -1 for none.
        errors: (n, 3) range m, bearing rad, diameter m; NaN where there is none.
        nees: (n,) of the three.
        visible: (n,) the thing had 3 beams or more and at most 40 % of it was hidden.
    """

    thing_distances_m: FloatArray
    thing_beams: IntArray
    thing_shares: FloatArray
    found: BoolArray
    ranges_m: FloatArray
    reliabilities: FloatArray
    matched: IntArray
    errors: FloatArray
    nees: FloatArray
    visible: BoolArray


def stand_trials(
    seeds: Sequence[int], device: Lms151, stands: Sequence[StandSettings]
) -> Iterator[Trial[LaserScan]]:
    """`SCANS_PER_STAND` scans from random places in one stand of each sort and seed."""
    for seed in seeds:
        for k, stand in enumerate(stands):
            rng = np.random.default_rng([seed, k])
            world = stand_of_trees(rng, stand)
            for _ in range(SCANS_PER_STAND):
                yield look(world, _free_place(world, rng), device, rng)


def look(
    world: World, world_T_laser: Pose2, device: Lms151, rng: np.random.Generator
) -> Trial[LaserScan]:
    """A scan from one place with its truth."""
    laser_t_things = world_T_laser.inverse().transform(world.world_t_things)
    distances_m = np.hypot(laser_t_things[:, 0], laser_t_things[:, 1])
    bearings = np.arctan2(laser_t_things[:, 1], laser_t_things[:, 0])
    sources = device.echoes(world, world_T_laser, rng).sources
    arcs = visible_arcs(distances_m, bearings, world.radii_m)
    widths = np.bincount(arcs.owners, arcs.ends - arcs.starts, len(world))
    return Trial(
        world,
        device.scan(world, world_T_laser, rng),
        distances_m,
        bearings,
        np.bincount(sources[sources >= 0], minlength=len(world)),
        widths / (2.0 * np.arcsin(world.radii_m / distances_m)),
    )


def judge_detector(
    trials: Sequence[Trial[Seen]],
    detector: Detector[Seen],
    things: Sequence[Thing],
    min_reliability: float,
) -> Outcomes:
    """What became of the first of `things`, and of every perception at least this reliable.

    A perception of any of `things` is right; recall and errors are of the first alone.
    """
    parts = [_judge(trial, detector, things, min_reliability) for trial in trials]
    return Outcomes(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in Outcomes.__slots__)
    )


def _judge(
    trial: Trial[Seen], detector: Detector[Seen], things: Sequence[Thing], min_reliability: float
) -> Outcomes:
    perceptions = detector.detect(trial.scan)
    perceptions = perceptions.select(perceptions.reliabilities >= min_reliability)
    rows = _match(perceptions, trial, things)
    has = rows >= 0
    matched = np.where(has, trial.world.things[rows], -1)
    errors = np.column_stack(
        [
            perceptions.ranges_m - trial.distances_m[rows],
            wrap_angle(perceptions.bearings - trial.bearings[rows]),
            perceptions.diameters_m - 2.0 * trial.world.radii_m[rows],
        ]
    )
    errors[~has] = np.nan
    polar = errors[:, :2]
    nees = np.einsum("ni,nij,nj->n", polar, np.linalg.inv(perceptions.covariances), polar)
    visible = (trial.num_beams >= 3) & (trial.visible_shares >= 0.6)
    first = np.flatnonzero(trial.world.things == things[0])
    return Outcomes(
        trial.distances_m[first],
        trial.num_beams[first],
        trial.visible_shares[first],
        np.isin(first, rows),
        perceptions.ranges_m,
        perceptions.reliabilities,
        matched,
        errors,
        nees + (errors[:, 2] / perceptions.diameter_sigmas_m) ** 2,
        visible[rows] & (matched == things[0]),
    )


def _match(perceptions: Perceptions, trial: Trial[Seen], things: Sequence[Thing]) -> IntArray:
    """(n,) rows of the world, -1 for none: one to one, nearest in sum, within `MAX_MATCH_M`."""
    laser_t_things = trial.distances_m[:, None] * np.column_stack(
        [np.cos(trial.bearings), np.sin(trial.bearings)]
    )
    differences = perceptions.base_t_landmarks()[:, None] - laser_t_things
    apart_m = np.linalg.norm(differences, axis=2)
    far = (apart_m > MAX_MATCH_M) | ~np.isin(trial.world.things, list(things))
    chosen, rows = linear_sum_assignment(np.where(far, 1e3, apart_m))
    matches = np.full(len(perceptions), -1)
    near = ~far[chosen, rows]
    matches[chosen[near]] = rows[near]
    return matches


def _free_place(world: World, rng: np.random.Generator) -> Pose2:
    """A pose near the middle with half a metre of room."""
    while True:
        x, y, theta = rng.uniform(-1.0, 1.0, 3) * (_PLACES_M, _PLACES_M, np.pi)
        apart_m = np.linalg.norm(world.world_t_things - (x, y), axis=1) - world.radii_m
        if apart_m.min(initial=np.inf) > 0.5:
            return Pose2(x, y, theta)
