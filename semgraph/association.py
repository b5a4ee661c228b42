"""Which of the landmarks seen now are which of the map: joint compatibility with the odds counted.

Both sides are landmarks of the graph: those in sight now, and older ones around. What is known of
them together is one joint Gaussian, so drift of the pose moves all of them together and is no
excuse for a pair that contradicts the others.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray
from semgraph.measurement_model import CHI2_2DOF_999, mahalanobis2

# One object seen twice has one position; this is what its outline leaves open.
_SAME_PLACE_SIGMA_M: Final = 0.02
_MAX_SEEDS: Final = 24


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
) -> tuple[Pair, ...]:
    """The most probable pairs of landmarks in sight and landmarks of the map.

    Args:
        differences: (a, b, 2) m, recent minus old, in map.
        covariance: (2a + 2b, 2a + 2b) m2 joint of recent then old positions.
        allowed: (a, b) whether kinds, attributes and common sightings permit the pair.
        density: of landmarks, per m2: how easily an unknown one stands there by chance.

    Each pair adds ln N(difference; 0, S) - ln density, S given all pairs before it: by the chain
    rule the sum is the joint log likelihood ratio. Source: Neira and Tardos 2001 for joint
    compatibility; the odds and the margin are this project's.
    """
    space = _Differences(differences, covariance)
    distances2 = space.distances2()
    candidates = np.argwhere(allowed & (distances2 <= CHI2_2DOF_999))
    if len(candidates) == 0:
        return ()
    order = np.argsort(distances2[tuple(candidates.T)], kind="stable")[:_MAX_SEEDS]
    grown = [_grow(space, tuple(candidates[k]), allowed, density) for k in order.tolist()]
    grown.sort(key=lambda hypothesis: -hypothesis[1])
    pairs, log_odds = grown[0]
    return tuple(
        Pair(*pair, min(_support(space, pairs, pair, density), log_odds - _rival(pair, grown)))
        for pair in pairs
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

    def __init__(self, differences: FloatArray, covariance: FloatArray) -> None:
        num_recent, num_old = differences.shape[:2]
        self.mean = differences
        blocks = covariance.reshape(num_recent + num_old, 2, num_recent + num_old, 2)
        self._joint = blocks.transpose(0, 2, 1, 3)
        self._num_recent = num_recent

    def covariances(self) -> FloatArray:
        """(a, b, 2, 2) of each difference."""
        a = self._num_recent
        rows, columns = np.arange(a), np.arange(a, len(self._joint))
        recent = self._joint[rows, rows][:, None]
        old = self._joint[columns, columns][None, :]
        cross = self._joint[:a, a:]
        own = _SAME_PLACE_SIGMA_M**2 * np.eye(2)
        total: FloatArray = recent + old - cross - cross.transpose(0, 1, 3, 2) + own
        return total

    def distances2(self) -> FloatArray:
        """(a, b) squared Mahalanobis distances of each difference from zero."""
        return mahalanobis2(self.mean, self.covariances())

    def given(self, recent: int, old: int) -> "_Differences":
        """The same, knowing that this pair is one object."""
        a = self._num_recent
        column = self._joint[:, recent] - self._joint[:, a + old]
        S = column[recent] - column[a + old] + _SAME_PLACE_SIGMA_M**2 * np.eye(2)
        gain = np.einsum("nij,jk->nik", column, np.linalg.inv(S))
        shift = -gain @ self.mean[recent, old]
        conditioned = _Differences.__new__(_Differences)
        conditioned.mean = self.mean + shift[:a, None] - shift[None, a:]
        conditioned._joint = self._joint - np.einsum("nij,mkj->nmik", gain, column)
        conditioned._num_recent = a
        return conditioned


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
    covariances = space.covariances()
    distances2 = mahalanobis2(space.mean, covariances)
    log_likelihoods = -0.5 * distances2 - 0.5 * np.log(
        (2.0 * np.pi) ** 2 * np.linalg.det(covariances)
    )
    return np.where(distances2 <= CHI2_2DOF_999, log_likelihoods - np.log(density), -np.inf)
