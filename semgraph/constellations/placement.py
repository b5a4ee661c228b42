"""What speaks for a group of landmarks standing at a pose in a map, and what against it."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.spatial import Delaunay, QhullError

from semgraph.alignment import fuse_with_priors
from semgraph.arrays import BoolArray, FloatArray, IntArray, flattened
from semgraph.constellations.mapped_constellation import (
    Constellation,
    MappedConstellation,
    surrounding_density,
)
from semgraph.constellations.pairing import Pairs, Scene
from semgraph.geometry import Pose2, UncertainPose2, points_from, relative_poses, transform_points
from semgraph.measurement_model import CHI2_2DOF_999, diameter_log_likelihoods, mahalanobis2

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
        pairs: rows and columns together.
    """

    map_T_centre: UncertainPose2
    rows: IntArray
    columns: IntArray
    log_odds: float
    pairs: frozenset[tuple[int, int]] = field(init=False)

    def __post_init__(self) -> None:
        pairs = zip(self.rows.tolist(), self.columns.tolist(), strict=True)
        object.__setattr__(self, "pairs", frozenset(pairs))


class Likelihood:
    """Of what is seen, as a function of the pose of its centre in the map.

    Args:
        mapped: the map.
        seen: about its centre.
        gates_m: (n,) how far from a landmark seen a mapped one may be.
        prior: map_T_centre before anything is seen; None for anywhere in the map.
    """

    def __init__(
        self,
        mapped: MappedConstellation,
        seen: Constellation,
        gates_m: FloatArray,
        prior: UncertainPose2 | None = None,
    ) -> None:
        self._mapped, self._seen, self._gates_m = mapped, seen, gates_m
        self._prior = prior
        self._view = _view(seen.positions)
        self._radius_m = float(np.linalg.norm(seen.positions, axis=1).max())
        self._densities = _densities(mapped, seen)
        self._size_chances = self._chances()
        self._is_of_a_kind_seen = np.isin(mapped.landmarks.kinds, seen.kinds)

    def settle(self, map_T_centres: FloatArray, slack_m: float) -> list[Hypothesis | None]:
        """The best placement near each rough pose, or None where no two landmarks stay paired.

        Args:
            map_T_centres: (h, 3) of what is seen; its positions are about its centre.
            slack_m: how rough the poses are, where the landmarks are.
        """
        poses, covariances = map_T_centres, np.tile(_ANYWHERE, (len(map_T_centres), 1, 1))
        is_placed = np.full(len(poses), True)
        for variance in (slack_m**2, 0.0, 0.0):
            pairs = self._scene(poses, variance).best_pairs()
            is_placed &= np.bincount(pairs.owners, minlength=len(poses)) >= 2
            poses, covariances = self._fitted(poses, pairs)
        log_odds = self._scene(poses, 0.0).log_odds(pairs) + self._occam(poses, covariances)
        is_placed &= np.isfinite(log_odds)
        found: list[Hypothesis | None] = [None] * len(poses)
        for number in np.flatnonzero(is_placed).tolist():
            pose = UncertainPose2(Pose2.from_array(poses[number]), covariances[number])
            own = pairs.select(pairs.owners == number)
            found[number] = Hypothesis(pose, own.rows, own.columns, float(log_odds[number]))
        return found

    def _fitted(self, poses: FloatArray, pairs: Pairs) -> tuple[FloatArray, FloatArray]:
        return fuse_with_priors(
            poses,
            poses,
            _ANYWHERE,
            pairs.owners,
            self._seen.positions[pairs.rows],
            self._mapped.landmarks.positions[pairs.columns],
            self._covariances(poses, pairs),
        )

    def _occam(self, poses: FloatArray, covariances: FloatArray) -> FloatArray:
        """(h,) ln of the share of all poses before that the pairs leave: Laplace's method."""
        wide = _DOUBT * covariances
        log_left = 0.5 * np.linalg.slogdet(2.0 * np.pi * wide)[1]
        if self._prior is None:
            log_before = -np.log(2.0 * np.pi * self._mapped.area_m2)
        else:
            log_before = _log_density(self._prior, poses, wide)
        return np.asarray(np.minimum(0.0, log_left + log_before))

    def _covariances(self, poses: FloatArray, pairs: Pairs) -> FloatArray:
        """(k, 2, 2) of the pairs' differences, in the frame of what is seen."""
        c, s = np.cos(poses[pairs.owners, 2]), np.sin(poses[pairs.owners, 2])
        centre_R_map = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=1)
        of_map = self._mapped.landmarks.covariances[pairs.columns]
        of_map = centre_R_map @ of_map @ centre_R_map.transpose(0, 2, 1)
        covariances: FloatArray = self._seen.covariances[pairs.rows] + of_map
        return covariances

    def _scene(self, poses: FloatArray, slack_m2: float) -> Scene:
        """What there is to pair at poses (h, 3), and what is expected."""
        mapped, seen, n = self._mapped, self._seen, len(self._seen)
        owners = np.repeat(np.arange(len(poses)), n)
        places = transform_points(poses[owners], np.tile(seen.positions, (len(poses), 1)))
        near = mapped.tree.query_ball_point(
            places, np.tile(self._gates_m + slack_m2**0.5, len(poses))
        )
        lookers, columns = flattened(near)
        pairs = Pairs(lookers // n, lookers % n, columns)
        distances_m, nearest = mapped.tree.query(places)
        is_known = distances_m <= mapped.spacings_m[nearest]
        return Scene(
            pairs,
            self._gains(poses, pairs, slack_m2),
            is_known.reshape(len(poses), n),
            self._expected(poses),
            len(mapped.landmarks),
        )

    def _gains(self, poses: FloatArray, pairs: Pairs, slack_m2: float) -> FloatArray:
        """(k,) what pairs add to the log odds; -inf where they contradict."""
        mapped, seen, rows, columns = self._mapped.landmarks, self._seen, pairs.rows, pairs.columns
        covariances = self._covariances(poses, pairs) + slack_m2 * np.eye(2)
        in_centre = points_from(poses[pairs.owners], mapped.positions[columns])
        distances2 = mahalanobis2(in_centre - seen.positions[rows], covariances)
        log_likelihoods = -0.5 * distances2 / _DOUBT - 0.5 * np.log(np.linalg.det(covariances))
        gains = log_likelihoods - np.log(2.0 * np.pi * _DOUBT * self._densities[rows])
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

    def _expected(self, poses: FloatArray) -> IntArray:
        """(e,) of the map, what is in view and of a kind that is seen; as of `Scene`."""
        mapped = self._mapped
        owners, columns = flattened(mapped.tree.query_ball_point(poses[:, :2], self._radius_m))
        is_seen = self._is_of_a_kind_seen[columns]
        owners, columns = owners[is_seen], columns[is_seen]
        in_centre = points_from(poses[owners], mapped.landmarks.positions[columns])
        is_inside = _is_inside(self._view, in_centre)
        expected: IntArray = owners[is_inside] * len(mapped.landmarks) + columns[is_inside]
        return expected


def distances2(prior: UncertainPose2, poses: FloatArray, covariances: FloatArray) -> FloatArray:
    """(h,) squared Mahalanobis distances of poses (h, 3), each with (3, 3) of its own."""
    off = relative_poses(np.tile(prior.pose.as_array(), (len(poses), 1)), poses)
    return mahalanobis2(off, prior.covariance + covariances)


def _log_density(prior: UncertainPose2, poses: FloatArray, covariances: FloatArray) -> FloatArray:
    """(h,) ln of the prior where poses (h, 3) are, known to (h, 3, 3)."""
    log_size = np.linalg.slogdet(2.0 * np.pi * (prior.covariance + covariances))[1]
    return np.asarray(-0.5 * (distances2(prior, poses, covariances) + log_size))


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
