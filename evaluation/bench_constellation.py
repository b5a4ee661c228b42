"""Figures of finding a constellation in a map without a prior of the pose."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.constellation import Constellation, MapIndex
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind

CONFIDENT: Final = float(np.log(100.0))
WRONG_M: Final = 1.0
ENOUGH: Final = 8
_NUM_TREES: Final = 584
_SIDE_M: Final = 200.0
_NUM_LARGE: Final = 20_000
_NUM_POSES: Final = 10
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
