"""Where in a fixed map the robot may be, by what it sees now alone: seeds for particles."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from semgraph.alignment import fuse_with_prior
from semgraph.arrays import FloatArray, IntArray
from semgraph.constellations.constellation import Constellation, MapIndex, Placement
from semgraph.geometry import Pose2, UncertainPose2, rotation, wrap_angle
from semgraph.known_map.fixed_map import FixedMap
from semgraph.known_map.likelihood_field import Seen
from semgraph.known_map.pose_likelihood import PoseLikelihood
from semgraph.landmarks import Perceptions
from semgraph.measurement_model import CHI2_2DOF_99

# Shorter pairs say little of the heading; longer ones no sensor sees, and they are too many.
_SHORTEST_M: Final = 0.5
_LONGEST_M: Final = 28.0
_MOST_PAIRS: Final = 1_000_000
_MOST_PAIRS_SEEN: Final = 16
_MOST_PER_PAIR: Final = 20_000
_MOST_PROPOSED: Final = 30
# Log odds of a placement above which pairs are not asked.
_BEYOND_DOUBT: Final = 5.0
# How far a pose by two landmarks may be turned, for scoring and matching the others.
_TURNED: Final = 0.03
# Proposals nearer than this are one.
_SAME_M: Final = 0.5
_SAME_RAD: Final = 0.1
# A proposed pose says nearly nothing beside the landmarks that it matches.
_LOOSE: Final = np.diag([5.0, 5.0, 0.5]) ** 2
# A place that its landmarks leave as open as this is none.
_OPEN_M: Final = 2.0


BySights = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Ordered pairs of landmarks of the map (p,), by length."""

    firsts: IntArray
    seconds: IntArray
    lengths_m: FloatArray


class PoseProposals:
    """Poses by what perceptions and landmarks have in common: constellations, and pairs."""

    def __init__(self, likelihood: PoseLikelihood) -> None:
        self._likelihood = likelihood
        self._index = MapIndex(likelihood.fixed_map.constellation())
        self._longest_m = _longest_m(likelihood.fixed_map)
        self._pairs: _Pairs | None = None

    def propose(
        self, perceptions: Perceptions, seen: Seen, by_sights: BySights
    ) -> list[UncertainPose2]:
        """Places apart from each other that explain best what is seen.

        By constellations of three and more; where these leave doubt, also by pairs.

        Args:
            perceptions: relative to base.
            seen: the same.
            by_sights: (n,) how much better places (n, 3) explain what is not seen than others do.
        """
        placements = self._placements(perceptions)
        found = [each.map_T_local for each in placements]
        if not placements or placements[0].log_odds < _BEYOND_DOUBT:
            found += self._by_pairs(seen, by_sights)
        means = np.array([each.pose.as_array() for each in found]).reshape(-1, 3)
        return [found[row] for row in _apart(means)]

    def _placements(self, perceptions: Perceptions) -> tuple[Placement, ...]:
        seen = Constellation(
            perceptions.base_t_landmarks(),
            perceptions.base_covariances(),
            perceptions.kinds,
            perceptions.diameters_m,
            perceptions.diameter_sigmas_m,
            perceptions.identities,
        )
        return self._index.place(seen, _MOST_PROPOSED)

    def _by_pairs(self, seen: Seen, by_sights: BySights) -> list[UncertainPose2]:
        """At most 30 places, refined."""
        if self._pairs is None:
            self._pairs = _pairs(self._likelihood.fixed_map.map_t_landmarks, self._longest_m)
        poses = self._candidates(seen, self._pairs)
        if not len(poses):
            return []
        sigma_m = float(np.sqrt(seen.variances.mean()))
        scores = self._likelihood.log_likelihoods(seen.blurred(sigma_m, _TURNED), poses)
        best = np.argsort(-scores, kind="stable")[: 10 * _MOST_PROPOSED]
        best = best[_apart(poses[best])]
        scores = scores[best] + by_sights(poses[best])
        best = best[np.argsort(-scores, kind="stable")[:_MOST_PROPOSED]]
        blur = (2.0 * sigma_m, _TURNED)
        refined = [
            self.refine(seen, UncertainPose2(Pose2.from_array(pose), _LOOSE), blur)
            for pose in poses[best]
        ]
        return [each for each in refined if np.trace(each.covariance[:2, :2]) < _OPEN_M**2]

    def refine(
        self, seen: Seen, prior: UncertainPose2, blur: tuple[float, float] | None = None
    ) -> UncertainPose2:
        """The pose that a prior and the landmarks that fit it best agree on.

        Args:
            seen: what is perceived.
            prior: the pose, and how surely.
            blur: sigmas in m and rad within which landmarks are sought; the prior's if None.
        """
        pose = prior.pose
        if blur is None:
            loose = np.sqrt(np.diag(prior.covariance))
            blur = (float(loose[:2].max()), float(loose[2]))
        refined = prior
        for sigma_m, sigma_rad in (blur, (0.0, 0.0)):
            rows, columns = self._matches(seen.blurred(sigma_m, sigma_rad), pose)
            mapped = self._likelihood.fixed_map
            base_R_map = rotation(-pose.theta)
            covariances = seen.covariances[rows] + (
                base_R_map @ mapped.covariances[columns] @ base_R_map.T
            )
            refined = fuse_with_prior(
                pose, prior, seen.base_t[rows], mapped.map_t_landmarks[columns], covariances
            )
            pose = refined.pose
        return refined

    def _matches(self, seen: Seen, pose: Pose2) -> tuple[IntArray, IntArray]:
        """The likeliest landmark of each perception that is rather one than clutter."""
        at = pose.as_array()
        columns = self._likelihood.candidates(seen, at, 0.0, 0.0)
        if columns.size == 0:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        logs = self._likelihood.pair_log_likelihoods(seen, at[None], columns, pose.theta)[0]
        best = logs.argmax(axis=1)
        rows = np.flatnonzero(logs.max(axis=1) > seen.log_clutter)
        return rows, columns[rows, best[rows]]

    def _candidates(self, seen: Seen, pairs: _Pairs) -> FloatArray:
        """(n, 3) poses that lay two perceptions onto two landmarks that they may be."""
        found = [
            self._of_pair(seen, pairs, first, second)
            for first, second in _pairs_seen(seen, self._longest_m)
        ]
        return np.concatenate([np.zeros((0, 3)), *found])

    def _of_pair(self, seen: Seen, pairs: _Pairs, first: int, second: int) -> FloatArray:
        between = seen.base_t[second] - seen.base_t[first]
        length_m = float(np.hypot(*between))
        tolerance_m = float(np.sqrt(CHI2_2DOF_99 * seen.variances[[first, second]].sum()))
        low, high = np.searchsorted(
            pairs.lengths_m, [length_m - tolerance_m, length_m + tolerance_m]
        )
        i, j = pairs.firsts[low:high], pairs.seconds[low:high]
        one_of, other_of = (np.full(len(i), row) for row in (first, second))
        odds = self._likelihood.log_weights(seen, one_of, i)
        odds = odds + self._likelihood.log_weights(seen, other_of, j)
        kept = np.flatnonzero(np.isfinite(odds))
        kept = kept[np.argsort(-odds[kept], kind="stable")[:_MOST_PER_PAIR]]
        landmarks = self._likelihood.fixed_map.map_t_landmarks
        one, other = landmarks[i[kept]], landmarks[j[kept]]
        along = other - one
        theta = np.arctan2(along[:, 1], along[:, 0]) - np.arctan2(between[1], between[0])
        base_t_middle = 0.5 * (seen.base_t[first] + seen.base_t[second])
        c, s = np.cos(theta), np.sin(theta)
        turned = np.column_stack(
            [
                c * base_t_middle[0] - s * base_t_middle[1],
                s * base_t_middle[0] + c * base_t_middle[1],
            ]
        )
        return np.column_stack([0.5 * (one + other) - turned, wrap_angle(theta)])


def _longest_m(fixed_map: FixedMap) -> float:
    """Of pairs of landmarks, so that there are not too many of them."""
    share = 2.0 * _MOST_PAIRS / len(fixed_map) ** 2
    return float(min(_LONGEST_M, np.sqrt(share * fixed_map.area_m2 / np.pi)))


def _pairs(map_t_landmarks: FloatArray, longest_m: float) -> _Pairs:
    pairs = KDTree(map_t_landmarks).query_pairs(longest_m, output_type="ndarray")
    lengths_m = np.hypot(*(map_t_landmarks[pairs[:, 0]] - map_t_landmarks[pairs[:, 1]]).T)
    order = np.argsort(lengths_m, kind="stable")
    order = order[lengths_m[order] >= _SHORTEST_M]
    both = np.repeat(pairs[order], 2, axis=0)
    both[1::2] = both[1::2, ::-1]
    return _Pairs(
        both[:, 0].astype(np.int64), both[:, 1].astype(np.int64), np.repeat(lengths_m[order], 2)
    )


def _pairs_seen(seen: Seen, longest_m: float) -> list[tuple[int, int]]:
    """Pairs of perceptions, reliable ones first and then long ones, each perception in few."""
    first, second = np.triu_indices(len(seen), 1)
    lengths_m = np.hypot(*(seen.base_t[first] - seen.base_t[second]).T)
    useful = np.flatnonzero((lengths_m >= _SHORTEST_M) & (lengths_m <= 0.95 * longest_m))
    doubts = seen.log_clutter[first] + seen.log_clutter[second]
    order = useful[np.lexsort((-lengths_m[useful], doubts[useful].round(1)))]
    chosen: list[tuple[int, int]] = []
    uses = np.zeros(len(seen), dtype=np.int64)
    most = max(3, 2 * _MOST_PAIRS_SEEN // max(len(seen), 1) + 1)
    for row in order:
        a, b = int(first[row]), int(second[row])
        if uses[a] < most and uses[b] < most:
            chosen.append((a, b))
            uses[[a, b]] += 1
        if len(chosen) == _MOST_PAIRS_SEEN:
            break
    return chosen


def _apart(map_T_bases: FloatArray) -> IntArray:
    """Rows, in order, of poses (n, 3) that are not the same as an earlier one."""
    kept: list[int] = []
    for row, pose in enumerate(map_T_bases):
        offsets = map_T_bases[kept] - pose
        near = np.hypot(offsets[:, 0], offsets[:, 1]) < _SAME_M
        if not (near & (np.abs(wrap_angle(offsets[:, 2])) < _SAME_RAD)).any():
            kept.append(row)
    return np.array(kept, dtype=np.int64)
