"""What speaks for a group of landmarks standing at a pose in a map, and what against it."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import Delaunay, QhullError

from semgraph.alignment import fuse_with_prior
from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.constellations.mapped_constellation import (
    Constellation,
    MappedConstellation,
    surrounding_density,
)
from semgraph.geometry import Pose2, UncertainPose2, rotation
from semgraph.measurement_model import CHI2_2DOF_999, diameter_log_likelihoods, mahalanobis2

# How many of the landmarks in sight are perceived, and how many of the perceived are not mapped.
_SEEN: Final = 0.85
_UNMAPPED: Final = 0.15
# That something elsewhere bears the same identity.
_NAMESAKE: Final = 1e-3
# By how much covariances of positions and diameters may be too small.
_DOUBT: Final = 2.0
# No prior for the pose: wider than any map, flat beside what two landmarks tell.
_ANYWHERE: Final = np.diag([1e8, 1e8, 1e2])


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A pose with its pairs.

    Attributes:
        map_T_centre: of what is seen.
        rows, columns: (k,) seen and mapped.
        log_odds: against chance, before any rival is heard.
    """

    map_T_centre: UncertainPose2
    rows: IntArray
    columns: IntArray
    log_odds: float

    def pairs(self) -> set[tuple[int, int]]:
        """Rows and columns together."""
        return set(zip(self.rows.tolist(), self.columns.tolist(), strict=True))


class Likelihood:
    """Of what is seen, as a function of the pose of its centre in the map.

    Args:
        mapped: the map.
        seen: about its centre.
        gates_m: (n,) how far from a landmark seen a mapped one may be.
    """

    def __init__(
        self, mapped: MappedConstellation, seen: Constellation, gates_m: FloatArray
    ) -> None:
        self._mapped, self._seen, self._gates_m = mapped, seen, gates_m
        self._view = _view(seen.positions)
        self._radius_m = float(np.linalg.norm(seen.positions, axis=1).max())
        self._densities = _densities(mapped, seen)
        self._size_chances = self._chances()

    def settle(self, map_T_centre: Pose2, slack_m: float) -> Hypothesis | None:
        """The best placement near a rough pose, or None where no two landmarks stay paired.

        Args:
            map_T_centre: of what is seen; its positions are about its centre.
            slack_m: how rough the pose is, where the landmarks are.
        """
        pose = UncertainPose2(map_T_centre, _ANYWHERE)
        for variance in (slack_m**2, 0.0, 0.0):
            scene = self._scene(pose.pose, variance)
            rows, columns = scene.best_pairs()
            if len(rows) < 2:
                return None
            pose = self._fitted(pose, rows, columns)
        log_odds = self._scene(pose.pose, 0.0).log_odds(rows, columns) + self._occam(pose)
        return Hypothesis(pose, rows, columns, log_odds) if np.isfinite(log_odds) else None

    def _distances2(
        self, pose: Pose2, rows: IntArray, columns: IntArray, covariances: FloatArray
    ) -> FloatArray:
        in_centre = pose.inverse().transform(self._mapped.landmarks.positions[columns])
        return mahalanobis2(in_centre - self._seen.positions[rows], covariances)

    def _fitted(self, pose: UncertainPose2, rows: IntArray, columns: IntArray) -> UncertainPose2:
        return fuse_with_prior(
            pose.pose,
            UncertainPose2(pose.pose, _ANYWHERE),
            self._seen.positions[rows],
            self._mapped.landmarks.positions[columns],
            self._covariances(pose.pose, rows, columns),
        )

    def _occam(self, pose: UncertainPose2) -> float:
        """Ln of the share of all poses of the map that the pairs leave: Laplace's method."""
        log_left = 0.5 * np.linalg.slogdet(2.0 * np.pi * _DOUBT * pose.covariance)[1]
        return min(0.0, float(log_left - np.log(2.0 * np.pi * self._mapped.area_m2)))

    def _covariances(self, pose: Pose2, rows: IntArray, columns: IntArray) -> FloatArray:
        """(k, 2, 2) of the pairs' differences, in the frame of what is seen."""
        centre_R_map = rotation(-pose.theta)
        of_map = centre_R_map @ self._mapped.landmarks.covariances[columns] @ centre_R_map.T
        return self._seen.covariances[rows] + of_map

    def _scene(self, pose: Pose2, slack_m2: float) -> "_Scene":
        """What there is to pair at a pose, and what it costs not to."""
        mapped, seen = self._mapped, self._seen
        places = pose.transform(seen.positions)
        near = mapped.tree.query_ball_point(places, self._gates_m + slack_m2**0.5)
        rows = np.repeat(np.arange(len(seen)), [len(each) for each in near])
        columns = np.concatenate([np.asarray(each, dtype=np.int64) for each in near])
        gains = self._gains(pose, rows, columns, slack_m2)
        distances_m, nearest = mapped.tree.query(places)
        is_mapped = distances_m <= mapped.spacings_m[nearest]
        return _Scene(
            rows,
            columns,
            gains,
            np.where(is_mapped, np.log(_UNMAPPED), 0.0),
            self._expected(pose),
        )

    def _gains(self, pose: Pose2, rows: IntArray, columns: IntArray, slack_m2: float) -> FloatArray:
        """(k,) what pairs add to the log odds; -inf where they contradict."""
        mapped, seen = self._mapped.landmarks, self._seen
        covariances = self._covariances(pose, rows, columns) + slack_m2 * np.eye(2)
        distances2 = self._distances2(pose, rows, columns, covariances)
        log_likelihoods = -0.5 * distances2 / _DOUBT - 0.5 * np.log(np.linalg.det(covariances))
        gains = log_likelihoods - np.log(2.0 * np.pi * _DOUBT * self._densities[rows] / _SEEN)
        gains += self._size_gains(rows, columns)
        named = seen.identities[rows] != ""
        same = seen.identities[rows] == mapped.identities[columns]
        gains -= np.where(named & same, np.log(_NAMESAKE), 0.0)
        allowed = (distances2 <= CHI2_2DOF_999) & (seen.kinds[rows] == mapped.kinds[columns])
        return np.where(allowed & (same | ~named), gains, -np.inf)

    def _size_gains(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """(k,) ln how much rather the diameters are of one object than of any two."""
        mapped, seen = self._mapped.landmarks, self._seen
        gains = (
            diameter_log_likelihoods(
                seen.diameters_m[rows],
                _DOUBT**0.5 * seen.diameter_sigmas_m[rows],
                mapped.diameters_m[columns],
                _DOUBT**0.5 * mapped.diameter_sigmas_m[columns],
            )
            - self._size_chances[rows]
        )
        return np.nan_to_num(gains, nan=0.0)

    def _chances(self) -> FloatArray:
        """(n,) ln density of each diameter seen among those of its kind in the map."""
        seen, chances = self._seen, np.full(len(self._seen), np.nan)
        for kind, (quantiles_m, sigma_m) in self._mapped.sizes.items():
            rows = np.flatnonzero(seen.kinds == kind)
            each = diameter_log_likelihoods(
                seen.diameters_m[rows, None],
                _DOUBT**0.5 * seen.diameter_sigmas_m[rows, None],
                quantiles_m[None],
                np.full((1, len(quantiles_m)), _DOUBT**0.5 * sigma_m),
            )
            if len(quantiles_m):
                # Without a diameter there is none: NaN, which the gains leave out.
                with np.errstate(invalid="ignore"):
                    chances[rows] = np.logaddexp.reduce(each, axis=1) - np.log(len(quantiles_m))
        return chances

    def _expected(self, pose: Pose2) -> IntArray:
        """Columns of the map that are in view and of a kind that is seen."""
        mapped = self._mapped
        near = mapped.tree.query_ball_point((pose.x, pose.y), self._radius_m)
        columns = np.array(near, dtype=np.int64)
        in_centre = pose.inverse().transform(mapped.landmarks.positions[columns])
        is_seen = np.isin(mapped.landmarks.kinds[columns], self._seen.kinds)
        return columns[is_seen & _is_inside(self._view, in_centre)]


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Pairs (k,) with their gains, what each seen one costs unpaired, and who is expected."""

    rows: IntArray
    columns: IntArray
    gains: FloatArray
    unpaired: FloatArray
    expected: IntArray

    def best_pairs(self) -> tuple[IntArray, IntArray]:
        """One to one, the most probable together."""
        missed = np.where(np.isin(self.columns, self.expected), np.log(1.0 - _SEEN), 0.0)
        worth = np.maximum(self.gains - self.unpaired[self.rows] - missed, 0.0)
        mapped, index = np.unique(self.columns, return_inverse=True)
        table = np.zeros((len(self.unpaired), len(mapped)))
        table[self.rows, index] = worth
        rows, columns = linear_sum_assignment(table, maximize=True)
        paired = table[rows, columns] > 0.0
        return rows[paired], mapped[columns[paired]]

    def log_odds(self, rows: IntArray, columns: IntArray) -> float:
        """Of these pairs, all others unmapped or missed, against nothing of it being mapped."""
        unpaired = np.delete(self.unpaired, rows).sum()
        num_missed = len(np.setdiff1d(self.expected, columns))
        is_paired = np.isin(self.rows + 1j * self.columns, rows + 1j * columns)
        if is_paired.sum() < len(rows):
            return -np.inf
        pairs = self.gains[is_paired].sum()
        return float(pairs + unpaired + num_missed * np.log(1.0 - _SEEN))


def _densities(mapped: MappedConstellation, seen: Constellation) -> FloatArray:
    """(n,) per m2, of each kind seen, where it is not the map: as in the map, or as it looks here.

    Whichever is more: it explains better what is seen without the map.
    """
    same_kind = seen.kinds[:, None] == seen.kinds[None]
    here = surrounding_density(seen.positions) * same_kind.mean(axis=1)
    in_map = np.array([mapped.densities.get(kind, 0.0) for kind in seen.kinds.tolist()])
    densities: FloatArray = np.maximum(here, in_map)
    return densities


def _view(positions: FloatArray) -> FloatArray:
    """(t, 3, 3) the surely seen area: triangles between neighbours; none where all stand in line.

    Each has a row for each corner: the coordinate of that corner that a point (x, y, 1) has.
    """
    nothing = np.zeros((0, 3, 3))
    if len(positions) < 3:
        return nothing
    try:
        corners = Delaunay(positions).simplices
    except QhullError:
        return nothing
    a, b, c = positions[corners].transpose(1, 0, 2) @ (1.0, 1.0j)
    areas = 0.5 * np.abs(np.imag(np.conj(b - a) * (c - a)))
    radii_m = np.abs(b - a) * np.abs(c - b) * np.abs(a - c) / np.maximum(4.0 * areas, 1e-12)
    is_seen = (radii_m <= 2.0 * np.median(radii_m)) & (areas > 0.0)
    columns = np.stack([positions[corners[is_seen]][:, :, axis] for axis in (0, 1)], axis=1)
    return np.linalg.inv(np.concatenate([columns, np.ones_like(columns[:, :1])], axis=1))


def _is_inside(view: FloatArray, points: FloatArray) -> BoolArray:
    """(n,) whether a point lies in a triangle of the view.

    A triangulation can tell too, but the first answer takes as long as all else about a placement:
    it solves a system for each triangle, one by one.
    """
    by_corners = view @ np.vstack([points.T, np.ones(len(points))])
    return np.asarray((by_corners >= 0.0).all(axis=1).any(axis=0))
