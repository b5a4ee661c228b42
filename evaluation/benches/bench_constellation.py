"""Figures of finding a constellation in a map without a prior of the pose."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from evaluation.benches.bench import Section
from evaluation.benches.bench_statistics import mean
from evaluation.benches.bench_table import Better, Row
from semgraph.arrays import FloatArray
from semgraph.constellations.constellation import Constellation, MapIndex
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind
from sensors.simulation.courses.stem_maps import MarkUnit, stand_from_stem_map

CONFIDENT: Final = float(np.log(100.0))
WRONG_M: Final = 1.0
ENOUGH: Final = 8
_NUM_TREES: Final = 584
_SIDE_M: Final = 200.0
_NUM_LARGE: Final = 20_000
_NUM_POSES: Final = 10
_NUM_POSES_IN_ROWS: Final = 2
_DIAMETER_SIGMA_M: Final = 0.03


@dataclass(frozen=True, slots=True)
class Stand:
    """True trees: positions (n, 2) and diameters (n,) in m."""

    positions: FloatArray
    diameters_m: FloatArray

    @property
    def sides_m(self) -> FloatArray:
        """(2,) of the box around."""
        sides: FloatArray = np.ptp(self.positions, axis=0)
        return sides


@dataclass(frozen=True, slots=True)
class Look:
    """How trees are seen and how well they are mapped."""

    within_m: float = 17.5
    sigma_m: float = 0.07
    map_sigma_m: float = 0.1
    missed: float = 0.15
    clutter: float = 0.1
    diameters: bool = True


WELL_MAPPED: Final = Look()
BADLY_MAPPED: Final = Look(within_m=20.0, map_sigma_m=0.5, missed=0.2)
Planting = Callable[[np.random.Generator], Stand]


@dataclass(frozen=True, slots=True)
class Outcome:
    """Of one place: how many were seen, how sure and how far off the best placement is."""

    num_seen: int
    log_odds: float
    error_m: float

    @property
    def confident(self) -> bool:
        """Sure enough to be used."""
        return self.log_odds > CONFIDENT

    @property
    def wrong(self) -> bool:
        """Confidently so."""
        return self.confident and self.error_m > WRONG_M


def forest(rng: np.random.Generator, num_trees: int = _NUM_TREES) -> Stand:
    """Trees anywhere, as dense as the longleaf stand; diameters from saplings to old trees."""
    side_m = _SIDE_M * (num_trees / _NUM_TREES) ** 0.5
    diameters_m = np.clip(rng.lognormal(np.log(0.25), 0.6, num_trees), 0.03, 0.9)
    return Stand(rng.uniform(0.0, side_m, (num_trees, 2)), diameters_m)


def orchard(rng: np.random.Generator, num_rows: int = 40, num_columns: int = 40) -> Stand:
    """Trees of one age in rows 4 m apart, 3 m apart in the row, planted within 5 cm."""
    grid = np.stack(np.meshgrid(np.arange(num_rows) * 4.0, np.arange(num_columns) * 3.0), axis=-1)
    positions = grid.reshape(-1, 2) + rng.normal(0.0, 0.05, (num_rows * num_columns, 2))
    return Stand(positions, rng.normal(0.15, 0.01, len(positions)))


def mapped(stand: Stand, look: Look, rng: np.random.Generator) -> Constellation:
    """The stand as it is mapped."""
    positions = stand.positions + rng.normal(0.0, look.map_sigma_m, stand.positions.shape)
    sigma_m = 0.5 * _DIAMETER_SIGMA_M
    return _constellation(positions, look.map_sigma_m, stand.diameters_m, sigma_m, look, rng)


def seen(stand: Stand, world_T_base: Pose2, look: Look, rng: np.random.Generator) -> Constellation:
    """What is seen of the stand from a pose, in base, in no order."""
    base_t_trees = world_T_base.inverse().transform(stand.positions)
    near = np.flatnonzero(np.linalg.norm(base_t_trees, axis=1) <= look.within_m)
    near = near[rng.uniform(size=len(near)) >= look.missed]
    num_false = rng.poisson(look.clutter * len(near))
    angles, shares = rng.uniform(0.0, 2.0 * np.pi, num_false), rng.uniform(size=num_false)
    false = (
        look.within_m * np.sqrt(shares)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    )
    positions = np.vstack([base_t_trees[near], false])
    positions += rng.normal(0.0, look.sigma_m, positions.shape)
    diameters_m = np.concatenate(
        [stand.diameters_m[near], rng.choice(stand.diameters_m, num_false)]
    )
    order = rng.permutation(len(positions))
    return _constellation(
        positions[order], look.sigma_m, diameters_m[order], _DIAMETER_SIGMA_M, look, rng
    )


def _constellation(
    positions: FloatArray,
    sigma_m: float,
    diameters_m: FloatArray,
    diameter_sigma_m: float,
    look: Look,
    rng: np.random.Generator,
) -> Constellation:
    n = len(positions)
    noisy_m = np.maximum(diameters_m + rng.normal(0.0, diameter_sigma_m, n), 0.01)
    return Constellation(
        positions,
        np.tile(sigma_m**2 * np.eye(2), (n, 1, 1)),
        np.full(n, int(Kind.TREE)),
        noisy_m if look.diameters else np.full(n, np.nan),
        np.full(n, diameter_sigma_m if look.diameters else np.nan),
        np.full(n, ""),
    )


def pose_within(stand: Stand, margin_m: float, rng: np.random.Generator) -> Pose2:
    """Anywhere in the stand but its margin."""
    low = stand.positions.min(axis=0) + margin_m
    x, y = low + rng.uniform(size=2) * (stand.sides_m - 2.0 * margin_m)
    return Pose2(float(x), float(y), float(rng.uniform(-np.pi, np.pi)))


def outcome(index: MapIndex, group: Constellation, world_T_base: Pose2) -> Outcome:
    """How the best placement of a group compares with where it is seen from."""
    placements = index.place(group)
    if not placements:
        return Outcome(len(group), -np.inf, np.inf)
    found = placements[0].map_T_local.pose
    middle = group.positions.mean(axis=0, keepdims=True)
    off = found.transform(middle) - world_T_base.transform(middle)
    return Outcome(len(group), placements[0].log_odds, float(np.linalg.norm(off)))


def looks_at(
    plant: Planting, look: Look, seeds: Sequence[int], num_poses: int, margin_m: float = 0.0
) -> list[Outcome]:
    """Outcomes at so many poses in a stand for each seed."""
    outcomes = []
    for seed in seeds:
        rng = np.random.default_rng([seed, 31])
        stand = plant(rng)
        index = MapIndex(mapped(stand, look, rng))
        for _ in range(num_poses):
            world_T_base = pose_within(stand, margin_m, rng)
            outcomes.append(outcome(index, seen(stand, world_T_base, look, rng), world_T_base))
    return outcomes


def found_again(plant: Planting, look: Look, name: str) -> Callable[[Sequence[int]], list[Row]]:
    """Figures of how often a pose is told, and told wrongly, with diameters and without."""

    def figures(seeds: Sequence[int]) -> list[Row]:
        rows = []
        for diameters, what in ((True, "diameters"), (False, "no diameters")):
            outcomes = looks_at(plant, replace(look, diameters=diameters), seeds, _NUM_POSES)
            right = [
                each.confident and not each.wrong for each in outcomes if each.num_seen >= ENOUGH
            ]
            named = f"{name}, {what}"
            rows += [
                _confidently_wrong(outcomes, named, 0.005),
                Row(
                    f"{named}: confident and right, {ENOUGH} or more seen",
                    mean(np.array(right)),
                    "",
                    Better.HIGHER,
                    0.9,
                ),
            ]
        return rows

    return figures


def rows_of_trees(seeds: Sequence[int]) -> list[Row]:
    """An orchard, its edge out of sight: nobody can be sure."""
    look, rows = Look(within_m=15.0), []
    for diameters, what in ((True, "diameters"), (False, "no diameters")):
        seeing = replace(look, diameters=diameters)
        outcomes = looks_at(orchard, seeing, seeds, _NUM_POSES_IN_ROWS, 20.0)
        rows.append(_confidently_wrong(outcomes, f"orchard, {what}", 0.0))
    return rows


def elsewhere(seeds: Sequence[int]) -> list[Row]:
    """What is seen of one forest, looked for in the map of another one."""
    sure = []
    for seed in seeds:
        rng = np.random.default_rng([seed, 32])
        here, there = forest(rng), forest(rng)
        index = MapIndex(mapped(there, WELL_MAPPED, rng))
        for _ in range(_NUM_POSES):
            world_T_base = pose_within(here, 0.0, rng)
            group = seen(here, world_T_base, WELL_MAPPED, rng)
            sure.append(outcome(index, group, world_T_base).confident)
    return [Row("elsewhere: confident", mean(np.array(sure)), "", Better.LOWER, 0.005)]


def large_map(seeds: Sequence[int]) -> list[Row]:
    """CPU time in a forest of 20,000 trees, well and badly mapped."""
    rows = []
    for look, what in ((WELL_MAPPED, "0.1 m"), (BADLY_MAPPED, "0.5 m")):
        rng = np.random.default_rng([seeds[0], 33])
        stand = forest(rng, _NUM_LARGE)
        landmarks = mapped(stand, look, rng)
        started = time.process_time()
        index = MapIndex(landmarks)
        build_s = time.process_time() - started
        poses = [pose_within(stand, 0.0, rng) for _ in range(_NUM_POSES)]
        groups = [seen(stand, pose, look, rng) for pose in poses]
        started = time.process_time()
        outcomes = [outcome(index, *each) for each in zip(groups, poses, strict=True)]
        place_s = (time.process_time() - started) / len(outcomes)
        name = f"{_NUM_LARGE} trees, mapped to {what}"
        rows += [
            Row(f"{name}: index, CPU", build_s, "s", Better.LOWER, 5.0),
            Row(f"{name}: a placement, CPU", place_s, "s", Better.LOWER, 0.5),
            _confidently_wrong(outcomes, name, 0.005),
        ]
    return rows


def _confidently_wrong(outcomes: Sequence[Outcome], name: str, target: float) -> Row:
    wrong = mean(np.array([each.wrong for each in outcomes]))
    return Row(f"{name}: confidently wrong", wrong, "", Better.LOWER, target)


SECTIONS: Final = (
    Section("forest of 584 trees", (found_again(forest, WELL_MAPPED, "0.1 m"),), 2.0),
    Section("the same, badly mapped", (found_again(forest, BADLY_MAPPED, "0.5 m"),), 4.0),
    Section("orchard", (rows_of_trees,), 3.0),
    Section("elsewhere", (elsewhere,), 1.0),
    Section("large map", (large_map,), 1.0),
)


def real_stand(stem_map: Path) -> Section:
    """The figures of the forest in a stand of real trees: a CSV file x,y,mark, diameters in cm."""

    def plant(rng: np.random.Generator) -> Stand:
        stems = stand_from_stem_map(stem_map, MarkUnit.CM, rng)
        return Stand(stems.world_t_things, 2.0 * stems.radii_m)

    name = stem_map.stem
    figures = tuple(
        found_again(plant, look, f"{name}, {what}")
        for look, what in ((WELL_MAPPED, "0.1 m"), (BADLY_MAPPED, "0.5 m"))
    )
    return Section(name, figures, 6.0)
