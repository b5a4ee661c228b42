"""Which of the landmarks seen now are which of the map: joint compatibility with the odds counted.

Both sides are landmarks of the graph: those in sight now, and older ones around. What is known of
them together is one joint Gaussian, so drift of the pose moves all of them together and is no
excuse for a pair that contradicts the others.
"""

from dataclasses import dataclass

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.measurement_model import CHI2_2DOF_999, log_odds_of_pairs, mahalanobis2


@dataclass(frozen=True, slots=True)
class Pair:
    """Row `recent` of the landmarks in sight is row `old` of the map.

    `log_odds` says how sure: of the same object against a new one, given the other pairs, and
    against the best set of pairs that contradicts this one, whichever is less.
    """

    recent: int
    old: int
    log_odds: float


def associate(
    differences: FloatArray,
    covariance: FloatArray,
    allowed: BoolArray,
    density: float,
    same_place: FloatArray,
    ahead_by: float = 0.0,
) -> tuple[Pair, ...]:
    """The most probable pairs of landmarks in sight and landmarks of the map.

    Args:
        differences: (a, b, 2) m, recent minus old, in map.
        covariance: (2a + 2b, 2a + 2b) m2 joint of recent then old positions.
        allowed: (a, b) whether kinds, attributes and common sightings permit the pair.
        density: of landmarks, per m2: how easily an unknown one stands there by chance.
        same_place: (a, b) m2 > 0 how far the centres of one object seen from two sides may differ,
            a variance along each axis.
        ahead_by: the share of the log odds by which a pair's set must be ahead of what contradicts
            it. Trees in rows fit nearly as well one tree farther on: by how much less is the
            matter of where the rows end.

    Each pair adds ln N(difference; 0, S) - ln density, S given all pairs before it: by the chain
    rule the sum is the joint log likelihood ratio. Source: Neira and Tardos 2001 for joint
    compatibility; the odds and the margin are this project's.
    """
    space = _Differences(differences, covariance, same_place)
    distances2 = mahalanobis2(space.mean, space.covariances())
    candidates = np.argwhere(allowed & (distances2 <= CHI2_2DOF_999))
    if len(candidates) == 0:
        return ()
    # Every candidate is a seed: under a drift beyond the spacing none of the nearest is right.
    order = np.argsort(distances2[tuple(candidates.T)], kind="stable")
    grown = [_grow(space, tuple(candidates[k]), allowed, density) for k in order.tolist()]
    grown.sort(key=lambda hypothesis: -hypothesis[1])
    pairs, log_odds = grown[0]
    margins = ((pair, log_odds - _rival(pair, grown)) for pair in pairs)
    return tuple(
        Pair(*pair, min(_support(space, pairs, pair, density), margin))
        for pair, margin in margins
        if margin >= ahead_by * log_odds
    )


def _support(
    space: "_Differences", pairs: list[tuple[int, int]], pair: tuple[int, int], density: float
) -> float:
    """What this pair adds to the log odds, knowing all the others."""
    for other in pairs:
        if other != pair:
            space = space.given(*other)
    return float(_gains(space, density)[pair])


def _rival(pair: tuple[int, int], grown: list[tuple[list[tuple[int, int]], float]]) -> float:
    """Log odds of the best set of pairs in which one of the two is another object; 0: both new."""
    recent, old = pair
    return max(
        (
            log_odds
            for rivals, log_odds in grown
            if any((a == recent) != (b == old) for a, b in rivals)
        ),
        default=0.0,
    )


class _Differences:
    """The joint Gaussian over all differences recent minus old, to be conditioned step by step."""

    def __init__(self, differences: FloatArray, joint: FloatArray, same_place: FloatArray) -> None:
        self.mean = differences
        self._joint = joint
        self._same_place = same_place[:, :, None, None] * np.eye(2)
        self._split = 2 * differences.shape[0]

    def covariances(self) -> FloatArray:
        """(a, b, 2, 2) of each difference."""
        a, b = self.mean.shape[:2]
        k = self._split
        recent = self._joint[:k, :k].reshape(a, 2, a, 2)[np.arange(a), :, np.arange(a), :]
        old = self._joint[k:, k:].reshape(b, 2, b, 2)[np.arange(b), :, np.arange(b), :]
        cross = self._joint[:k, k:].reshape(a, 2, b, 2).transpose(0, 2, 1, 3)
        total: FloatArray = (
            recent[:, None] + old[None, :] - cross - cross.transpose(0, 1, 3, 2) + self._same_place
        )
        return total

    def given(self, recent: int, old: int) -> "_Differences":
        """The same, knowing that this pair is one object."""
        k = self._split
        rows, columns = slice(2 * recent, 2 * recent + 2), slice(k + 2 * old, k + 2 * old + 2)
        by_difference = self._joint[:, rows] - self._joint[:, columns]
        S = by_difference[rows] - by_difference[columns] + self._same_place[recent, old]
        gain = by_difference @ np.linalg.inv(S)
        shift = (gain @ -self.mean[recent, old]).reshape(-1, 2)
        num_recent = len(self.mean)
        return _Differences(
            self.mean + shift[:num_recent, None] - shift[None, num_recent:],
            self._joint - gain @ by_difference.T,
            self._same_place[:, :, 0, 0],
        )


def _grow(
    space: _Differences, seed: tuple[int, int], allowed: BoolArray, density: float
) -> tuple[list[tuple[int, int]], float]:
    """Pairs and log odds: the seed, then always the pair that adds most, while one adds any."""
    pairs: list[tuple[int, int]] = []
    log_odds = 0.0
    free = allowed.copy()
    best = seed
    while True:
        gains = np.where(free, _gains(space, density), -np.inf)
        if pairs:
            best = divmod(int(gains.argmax()), gains.shape[1])
            if not gains[best] > 0.0:
                return pairs, log_odds
        log_odds += float(gains[best])
        pairs.append((int(best[0]), int(best[1])))
        free[best[0], :] = False
        free[:, best[1]] = False
        space = space.given(*best)


def _gains(space: _Differences, density: float) -> FloatArray:
    """(a, b) what each pair would add to the log odds; outside its gate it adds nothing."""
    return log_odds_of_pairs(space.mean, space.covariances(), density)
