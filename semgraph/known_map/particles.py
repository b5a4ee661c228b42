"""Weighed poses as a structure of arrays, and the Gaussian that stands for them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2, UncertainPose2, rotation, wrap_angle

_BIN_M: Final = 0.5
_BIN_RAD: Final = 0.1
# KLD sampling: the error that is allowed, and the normal quantile of how surely.
_KLD_ERROR: Final = 0.05
_KLD_QUANTILE: Final = 2.326
# A smaller share of the samples says little; then they are drawn anew, by so much nearer.
_ENOUGH_EFFECTIVE: Final = 0.1
_NARROWED: Final = 0.3
_LEAST_SIGMAS: Final = np.array([1e-4, 1e-4, 1e-5])


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """Of poses: mean (3,) and covariance (3, 3) of x, y in map and theta."""

    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def of_pose(cls, map_T_base: UncertainPose2) -> Self:
        """Of a pose whose covariance is in its own frame."""
        R = _turn(map_T_base.pose.theta)
        covariance = R @ map_T_base.covariance @ R.T + np.diag(_LEAST_SIGMAS**2)
        return cls(map_T_base.pose.as_array(), covariance)

    def pose(self) -> UncertainPose2:
        """The pose, its covariance in its own frame."""
        R = _turn(float(self.mean[2]))
        return UncertainPose2(Pose2.from_array(self.mean), R.T @ self.covariance @ R)

    def wider(self, factor: float) -> "Gaussian":
        """The same with larger sigmas."""
        return Gaussian(self.mean, factor**2 * self.covariance)

    def is_within(self, sigma_m: float, sigma_rad: float) -> bool:
        """Whether its sigmas are no larger."""
        (a, b, _), (_, d, _), (_, _, turned2) = self.covariance.tolist()
        largest2 = 0.5 * (a + d) + math.hypot(0.5 * (a - d), b)
        return bool(largest2 <= sigma_m**2 and turned2 <= sigma_rad**2)

    def draw(self, n: int, rng: np.random.Generator) -> FloatArray:
        """(n, 3) poses."""
        poses: FloatArray = self.mean + rng.standard_normal((n, 3)) @ self._root().T
        poses[:, 2] = wrap_angle(poses[:, 2])
        return poses

    def log_densities(self, poses: FloatArray) -> FloatArray:
        """(n,) of poses (n, 3), by m2 and rad."""
        root = self._root()
        offsets = poses - self.mean
        offsets[:, 2] = wrap_angle(offsets[:, 2])
        whitened = np.linalg.inv(root) @ offsets.T
        densities: FloatArray = _log_peak(root) - 0.5 * np.square(whitened).sum(axis=0)
        return densities

    def log_peak(self) -> float:
        """The largest log density."""
        return _log_peak(self._root())

    def _root(self) -> FloatArray:
        return np.linalg.cholesky(self.covariance)


@dataclass(frozen=True, slots=True, eq=False)
class Particles:
    """Poses (n, 3), map_T_base, and weights (n,) that sum up to 1."""

    poses: FloatArray
    weights: FloatArray

    @classmethod
    def alike(cls, poses: FloatArray) -> Self:
        """All of one weight."""
        return cls(poses, np.full(len(poses), 1.0 / len(poses)))

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def effective(self) -> float:
        """The number of equal weights that would tell as much."""
        return float(1.0 / np.square(self.weights).sum())

    def gaussian(self) -> Gaussian:
        """Mean and covariance."""
        x, y = self.weights @ self.poses[:, :2]
        s, c = self.weights @ np.sin(self.poses[:, 2]), self.weights @ np.cos(self.poses[:, 2])
        mean = np.array([x, y, np.arctan2(s, c)])
        offsets = self.poses - mean
        offsets[:, 2] = wrap_angle(offsets[:, 2])
        covariance = (offsets * self.weights[:, None]).T @ offsets + np.diag(_LEAST_SIGMAS**2)
        return Gaussian(mean, covariance)

    def likeliest(self, radius_m: float) -> tuple[Gaussian, float]:
        """The place that holds most weight within a radius, and how much."""
        whole = self.gaussian()
        if whole.is_within(0.3 * radius_m, _BIN_RAD):
            offsets = self.poses[:, :2] - whole.mean[:2]
            within = np.square(offsets).sum(axis=1) <= radius_m**2
            return whole, float(self.weights[within].sum())
        labels, _ = _bins(self.poses)
        heaviest = np.bincount(labels, self.weights).argmax()
        chosen = labels == heaviest
        for _ in range(3):
            place = self._of(chosen)
            offsets = self.poses[:, :2] - place.mean[:2]
            within = np.hypot(offsets[:, 0], offsets[:, 1]) <= radius_m
            turned = np.abs(wrap_angle(self.poses[:, 2] - place.mean[2]))
            chosen = within & (turned <= 5.0 * _BIN_RAD)
        return self._of(chosen), float(self.weights[within].sum())

    def _of(self, chosen: FloatArray) -> Gaussian:
        weights = self.weights[chosen]
        return Particles(self.poses[chosen], weights / weights.sum()).gaussian()


def evenly_within(
    point: tuple[float, float], radius_m: float, n: int, rng: np.random.Generator
) -> FloatArray:
    """(n, 3) poses within a radius of a point, headed anywhere."""
    angles, headings = rng.uniform(-np.pi, np.pi, (2, n))
    out_m = radius_m * np.sqrt(rng.uniform(0.0, 1.0, n))
    x, y = point
    return np.column_stack([x + out_m * np.cos(angles), y + out_m * np.sin(angles), headings])


def importance_samples(
    log_target: Callable[[FloatArray], FloatArray],
    drawn_from: Sequence[Gaussian],
    n: int,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Poses (n, 3), and (n,) log weights by whose sum the target exceeds what is drawn.

    Where hardly any carries weight, they are drawn once more about those that do: a spread of one
    pose looks sure, and its weight is chance.

    Args:
        log_target: (n,) log densities of poses (n, 3).
        drawn_from: in equal shares.
        n: how many.
        rng: of the draws.

    Source: population Monte Carlo, Cappe et al. 2004.
    """
    for last in (False, False, True):
        parts = np.array_split(np.arange(n), len(drawn_from))
        poses = np.concatenate(
            [each.draw(len(part), rng) for each, part in zip(drawn_from, parts, strict=True)]
        )
        log_densities = np.array([each.log_densities(poses) for each in drawn_from])
        log_drawn = np.logaddexp.reduce(log_densities, axis=0) - np.log(len(drawn_from))
        log_weights = log_target(poses) - log_drawn - np.log(n)
        weights = np.exp(log_weights - log_sum(log_weights))
        found = Particles(poses, weights)
        if last or found.effective >= _ENOUGH_EFFECTIVE * n:
            break
        best = found.gaussian()
        narrower = best.covariance + _NARROWED**2 * drawn_from[-1].covariance
        drawn_from = (*drawn_from[:1], Gaussian(best.mean, narrower))
    return poses, log_weights


def log_sum(logs: FloatArray) -> float:
    """Log of the sum of what these (n,) are the logs of; n above 0, not all of nothing."""
    largest = float(logs.max())
    return largest + float(np.log(np.exp(logs - largest).sum()))


def systematic(weights: FloatArray, n: int, rng: np.random.Generator) -> IntArray:
    """(n,) rows drawn by weight with one random number.

    Source: Kitagawa 1996.
    """
    edges = np.cumsum(weights)
    places = (rng.uniform() + np.arange(n)) / n * edges[-1]
    rows: IntArray = np.minimum(np.searchsorted(edges, places), len(weights) - 1).astype(np.int64)
    return rows


def num_bins(poses: FloatArray) -> int:
    """How many cells of 0.5 m and 0.1 rad hold poses (n, 3)."""
    return _bins(poses)[1]


def volume_of_bins(count: int) -> float:
    """Of so many cells, m2 rad."""
    return count * _BIN_M**2 * _BIN_RAD


def kld_number(bins: int) -> int:
    """Particles that so many bins need.

    Source: Fox 2003, eq. 7 (Wilson-Hilferty).
    """
    if bins < 2:
        return 1
    a = 2.0 / (9.0 * (bins - 1))
    return int(
        np.ceil((bins - 1) / (2.0 * _KLD_ERROR) * (1.0 - a + np.sqrt(a) * _KLD_QUANTILE) ** 3)
    )


def _bins(poses: FloatArray) -> tuple[IntArray, int]:
    """(n,) number of each pose's cell, and how many cells there are."""
    cells = np.floor(poses / (_BIN_M, _BIN_M, _BIN_RAD)).astype(np.int64)
    cells -= cells.min(axis=0)
    _, rows, layers = (cells.max(axis=0) + 1).tolist()
    codes = (cells[:, 0] * rows + cells[:, 1]) * layers + cells[:, 2]
    known, labels = np.unique(codes, return_inverse=True)
    return labels, len(known)


def _log_peak(root: FloatArray) -> float:
    """Of a Gaussian whose covariance has this Cholesky factor (3, 3)."""
    a, b, c = np.diag(root).tolist()
    return -math.log(a * b * c) - 1.5 * math.log(2.0 * math.pi)


def _turn(theta: float) -> FloatArray:
    R = np.eye(3)
    R[:2, :2] = rotation(theta)
    return R
