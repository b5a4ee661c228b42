"""Where a group of landmarks stands in a map, also without any prior of the pose.

Triangles that are alike propose poses; those that most triangles agree on are settled against the
map, and the odds of each are counted against chance and against all the others.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray, frozen_ints
from semgraph.constellations.mapped_constellation import Constellation, MappedConstellation
from semgraph.constellations.placement import Hypothesis, Likelihood, distances2
from semgraph.constellations.triangles import TriangleIndex, triangles_of
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.measurement_model import CHI2_2DOF_999, CHI2_3DOF_999

__all__ = ["Constellation", "MapIndex", "Placement"]

_REACH_M: Final = 20.0
# Sides within two sigma: of the many triangles that are right enough remain.
_SIDE_SIGMAS: Final = 2.0
# Less certain landmarks of the map propose no poses, but pair with what is seen.
_SURE_SHARE: Final = 0.9
# Finer cells and gates would cost, and tell nothing more.
_LEAST_SIGMA_M: Final = 0.01
_MAX_TRIANGLES: Final = 300
_MAX_MATCHES: Final = 100_000
_MAX_POINTS: Final = 40_000
_MAX_SETTLED: Final = 64
_CELL_SIGMAS: Final = 4.0
# What is better than a rival with nearly as many pairs: half may be the map's errors and clutter.
_NEARLY_AS_MANY: Final = 0.8
_FEIGNED: Final = 0.5
# Two named landmarks say more than many triangles.
_NAMED_VOTES: Final = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A pose of what is seen in the map, by pairs of its landmarks with the map's.

    Attributes:
        map_T_local: with the covariance that the pairs leave.
        rows, columns: (k,) of the seen constellation and of the map.
        log_odds: ln of the odds of this placement against all that contradict it together: other
            placements, and what is seen being nowhere in the map, with pairs by chance.
    """

    map_T_local: UncertainPose2
    rows: IntArray
    columns: IntArray
    log_odds: float

    def __post_init__(self) -> None:
        for name in ("rows", "columns"):
            value = frozen_ints(name, getattr(self, name), (len(self.rows),))
            object.__setattr__(self, name, value)


class MapIndex:
    """A map made ready to find constellations in it.

    Args:
        mapped: the landmarks of the map.
        reach_m: how far apart the corners of its triangles may be.
    """

    def __init__(self, mapped: Constellation, reach_m: float = _REACH_M) -> None:
        self._reach_m = reach_m
        self._mapped = MappedConstellation.of(mapped)
        typical = float(np.quantile(mapped.variances, _SURE_SHARE)) if len(mapped) else 0.0
        self._variance = max(typical, _LEAST_SIGMA_M**2)
        self._sure = np.flatnonzero(mapped.variances <= self._variance)
        self._triangles = TriangleIndex(
            mapped.positions[self._sure], mapped.kinds[self._sure], reach_m
        )

    def place(
        self,
        seen: Constellation,
        max_placements: int = 10,
        prior: UncertainPose2 | None = None,
    ) -> tuple[Placement, ...]:
        """The placements of `seen`, the most probable first.

        None where fewer than three landmarks (two that are named) fit the map.

        Args:
            seen: in a frame of its own.
            max_placements: so many at most.
            prior: map_T_local as it is believed; places beyond its 99.9 % are none. Without it all
                of the map is as probable.
        """
        if min(len(self._mapped.landmarks), len(seen)) < 2:
            return ()
        middle = seen.positions.mean(axis=0)
        centred = replace(seen, positions=seen.positions - middle)
        sigma_m = (self._variance + float(np.median(seen.variances))) ** 0.5
        local_T_centre = UncertainPose2(Pose2(*middle.tolist()), np.zeros((3, 3)))
        map_T_centre = prior @ local_T_centre if prior is not None else None
        poses, num_left_out = self._shortlist(centred, sigma_m, map_T_centre)
        # The trace: no axis has a larger variance.
        gates_m = (CHI2_2DOF_999 * 2.0 * (self._variance + seen.variances)) ** 0.5
        likelihood = Likelihood(self._mapped, centred, gates_m, map_T_centre)
        settled = likelihood.settle(poses, 2.0 * sigma_m)
        found = [each for each in settled if each is not None and _is_a_shape(each, seen)]
        distinct = _distinct(found)
        if not distinct:
            return ()
        left_out = _left_out(distinct[0], settled, num_left_out)
        log_odds = _against_all_others(distinct, left_out)
        centre_T_local = local_T_centre.inverse()
        placements = [
            Placement(each.map_T_centre @ centre_T_local, each.rows, each.columns, odds)
            for each, odds in zip(distinct, log_odds, strict=True)
        ]
        return tuple(placements[:max_placements])

    def _shortlist(
        self, seen: Constellation, sigma_m: float, prior: UncertainPose2 | None
    ) -> tuple[FloatArray, int]:
        """(s, 3) rough poses, the best first, and how many poses as good as the last are left out.

        Poses are those of the centre of what is seen.
        """
        poses, votes = self._proposals(seen)
        radius_m = float(np.sqrt(np.mean(np.sum(seen.positions**2, axis=1))))
        cell_m = _CELL_SIGMAS * sigma_m
        cells = np.array([cell_m, cell_m, cell_m / max(radius_m, cell_m)])
        if prior is not None:
            rough = np.diag(cells**2)
            is_possible = distances2(prior, poses, rough) <= CHI2_3DOF_999
            poses, votes = poses[is_possible], votes[is_possible]
        poses, votes = _agreed(poses, votes, cells)
        order = np.argsort(-votes, kind="stable")
        kept = order[: max(_MAX_POINTS // len(seen), _MAX_SETTLED)]
        poses = poses[kept]
        fits = self._fits(poses, seen.positions, cell_m) + 1e-3 * votes[kept]
        chosen, num_left = _apart(poses, fits, 2.0 * cells)
        return poses[chosen], len(order) - len(kept) + num_left

    def _proposals(self, seen: Constellation) -> tuple[FloatArray, FloatArray]:
        """(c, 3) poses and their votes (c,), of triangles and of named pairs."""
        mapped = self._mapped.landmarks
        triangles = triangles_of(seen.positions, seen.kinds, self._reach_m)
        triangles = triangles.select(triangles.spread(_MAX_TRIANGLES))
        worst = 2.0 * (self._variance + seen.variances[triangles.corners].max(axis=1, initial=0.0))
        rows, columns = self._triangles.matches(
            triangles, _SIDE_SIGMAS * np.sqrt(worst), _MAX_MATCHES
        )
        by_triangles = _fitted(seen, mapped, rows, self._sure[columns])
        by_names = _fitted(seen, mapped, *_named_pairs(seen, mapped))
        votes = np.repeat([1.0, _NAMED_VOTES], [len(by_triangles), len(by_names)])
        return np.vstack([by_triangles, by_names]), votes

    def _fits(self, poses: FloatArray, points: FloatArray, gate_m: float) -> FloatArray:
        """(s,) how many points lie on landmarks of the map, the nearer the more."""
        turned = np.exp(1j * poses[:, 2])[:, None] * (points @ (1.0, 1.0j))
        places = (poses[:, :2] @ (1.0, 1.0j))[:, None] + turned
        distances_m, _ = self._mapped.tree.query(
            np.stack([places.real, places.imag], axis=2), distance_upper_bound=gate_m
        )
        fits: FloatArray = np.maximum(1.0 - (distances_m / gate_m) ** 2, 0.0).sum(axis=1)
        return fits


def _is_a_shape(hypothesis: Hypothesis, seen: Constellation) -> bool:
    """Three landmarks make one; two that are alike are everywhere."""
    num_named = int((seen.identities[hypothesis.rows] != "").sum())
    return len(hypothesis.rows) >= 3 or num_named >= 2


def _named_pairs(seen: Constellation, mapped: Constellation) -> tuple[IntArray, IntArray]:
    """(c, 2) pairs of rows and of columns that bear the same names, names of the map borne once."""
    names, first, counts = np.unique(mapped.identities, return_index=True, return_counts=True)
    unique = dict(zip(names[counts == 1].tolist(), first[counts == 1].tolist(), strict=True))
    borne = [(row, unique.get(name)) for row, name in enumerate(seen.identities.tolist()) if name]
    same = np.array(
        [(row, column) for row, column in borne if column is not None], dtype=np.int64
    ).reshape(-1, 2)
    same = same[seen.kinds[same[:, 0]] == mapped.kinds[same[:, 1]]]
    one, other = np.triu_indices(len(same), 1)
    pairs = np.stack([same[one], same[other]], axis=2)
    return pairs[:, 0], pairs[:, 1]


def _fitted(
    seen: Constellation, mapped: Constellation, rows: IntArray, columns: IntArray
) -> FloatArray:
    """(c, 3) rigid fits of k corners each, (c, k) rows onto (c, k) columns, if they may be."""
    named = seen.identities[rows] != ""
    same = (seen.identities[rows] == mapped.identities[columns]) | ~named
    rows, columns = rows[same.all(axis=1)], columns[same.all(axis=1)]
    p, q = (each @ (1.0, 1.0j) for each in (seen.positions[rows], mapped.positions[columns]))
    p_mean, q_mean = p.mean(axis=1, keepdims=True), q.mean(axis=1, keepdims=True)
    product = (np.conj(p - p_mean) * (q - q_mean)).sum(axis=1, keepdims=True)
    turn = product / np.maximum(np.abs(product), 1e-300)
    variances = seen.variances[rows] + mapped.variances[columns]
    residuals2 = (np.abs(q - q_mean - turn * (p - p_mean)) ** 2 / variances).sum(axis=1)
    places = q_mean - turn * p_mean
    poses = np.column_stack([places.real, places.imag, np.angle(turn)])
    fitted: FloatArray = poses[(residuals2 <= CHI2_2DOF_999) & (np.abs(product[:, 0]) > 0.0)]
    return fitted


def _agreed(
    poses: FloatArray, votes: FloatArray, cells: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The mean pose of each occupied cell, and its votes."""
    if len(poses) == 0:
        return poses, votes
    keys = np.floor((poses - poses.min(axis=0)) / cells).astype(np.int64)
    sizes = keys.max(axis=0) + 1
    flat = (keys[:, 0] * sizes[1] + keys[:, 1]) * sizes[2] + keys[:, 2]
    occupied, index = np.unique(flat, return_inverse=True)
    sums: FloatArray = np.bincount(index, votes, len(occupied)).astype(np.float64)
    means = [np.bincount(index, votes * axis, len(occupied)) / sums for axis in poses.T]
    return np.column_stack(means), sums


def _apart(poses: FloatArray, fits: FloatArray, radii: FloatArray) -> tuple[IntArray, int]:
    """Rows of the best, the best first, each apart from all better ones; how many are left."""
    left = fits.copy()
    chosen: list[int] = []
    while len(chosen) < _MAX_SETTLED and len(left) and np.isfinite(left.max()):
        best = int(left.argmax())
        chosen.append(best)
        offsets = poses - poses[best]
        offsets[:, 2] = (offsets[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        left[(np.abs(offsets) <= radii).all(axis=1)] = -np.inf
    return np.array(chosen, dtype=np.int64), int(np.isfinite(left).sum())


def _is_repeated(hypothesis: Hypothesis, others: Iterable[Hypothesis]) -> bool:
    """Whether most of its pairs are those of another one."""
    pairs = hypothesis.pairs
    return any(2 * len(pairs & other.pairs) > len(pairs) for other in others)


def _distinct(found: Iterable[Hypothesis]) -> list[Hypothesis]:
    """The best first, without those that mostly repeat the pairs of a better one."""
    kept: list[Hypothesis] = []
    for each in sorted(found, key=lambda hypothesis: -hypothesis.log_odds):
        if not _is_repeated(each, kept):
            kept.append(each)
    return kept


def _rival(hypothesis: Hypothesis, best: Hypothesis) -> float:
    """Its log odds in the face of a better one, which may be better by chance alone."""
    looks_alike = len(hypothesis.rows) >= _NEARLY_AS_MANY * len(best.rows)
    behind = max(best.log_odds - hypothesis.log_odds, 0.0)
    return hypothesis.log_odds + (_FEIGNED * behind if looks_alike else 0.0)


def _left_out(best: Hypothesis, settled: Sequence[Hypothesis | None], num_left_out: int) -> float:
    """The log odds to fear of poses that were not settled: of the best of so many draws.

    They are taken to be drawn as the worse half of the settled, where the best of n draws is
    sqrt(2 ln n) sigma above the middle.
    """
    half = len(settled) // 2
    better = [each for each in settled[:half] if each is not None]
    worse = [each for each in settled[half:] if each is not None]
    log_odds = [_rival(each, best) for each in worse if not _is_repeated(each, better)]
    num_draws = num_left_out * len(log_odds) / max(len(settled) - half, 1)
    if num_draws < 1.0:
        return -np.inf
    middle, most = np.median(log_odds), max(log_odds)
    sigmas_more = (np.log(1.0 + num_draws) / np.log(1.0 + len(log_odds))) ** 0.5
    return float(middle + (most - middle) * max(sigmas_more, 1.0))


def _against_all_others(distinct: Sequence[Hypothesis], left_out: float) -> list[float]:
    """Log odds of each against all others, being nowhere, and what was left out."""
    rivals = [[_rival(other, each) for other in distinct if other is not each] for each in distinct]
    return [
        float(each.log_odds - np.logaddexp.reduce([0.0, left_out, *others]))
        for each, others in zip(distinct, rivals, strict=True)
    ]
