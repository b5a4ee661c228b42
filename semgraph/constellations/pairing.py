"""Who of those seen is who of a map, at several poses at once."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import betaln

from semgraph.arrays import BoolArray, FloatArray, IntArray

# Of the landmarks in sight so many are perceived, and of what is perceived so much is mapped, as a
# rule. How many it is here, the scene itself tells: what hides one tree hides its neighbours, and
# a detector that finds nine of ten in one wood finds every second in another.
_USUAL_SHARE: Final = 0.85
# The rule counts like so many landmarks.
_RULE_COUNTS: Final = 8.0
_LOG_MISSED: Final = float(np.log(1.0 - _USUAL_SHARE))


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Whose of several poses each pair is, its row seen and its column mapped, (k,) each."""

    owners: IntArray
    rows: IntArray
    columns: IntArray

    def select(self, chosen: BoolArray | IntArray) -> "Pairs":
        """Those of a mask or of numbers."""
        return Pairs(self.owners[chosen], self.rows[chosen], self.columns[chosen])

    def sums(self, values: FloatArray, num_poses: int) -> FloatArray:
        """(h,) of values (k,) by pose."""
        return np.asarray(np.bincount(self.owners, values, num_poses), dtype=np.float64)

    def one_to_one(self, worth: FloatArray) -> "Pairs":
        """At each pose those that are worth most together, (k,) each above 0."""
        of_rows, of_columns = (self._are_alone(ends) for ends in (self.rows, self.columns))
        chosen: BoolArray = of_rows & of_columns
        rivals = np.flatnonzero(~chosen)
        for owner in np.unique(self.owners[rivals]).tolist():
            own = rivals[self.owners[rivals] == owner]
            chosen[own[_assigned(self.rows[own], self.columns[own], worth[own])]] = True
        return self.select(chosen)

    def _are_alone(self, ends: IntArray) -> BoolArray:
        """(k,) whether no other pair of that pose has the same end (k,)."""
        keys = self.owners * (int(ends.max(initial=0)) + 1) + ends
        _, index, counts = np.unique(keys, return_inverse=True, return_counts=True)
        return np.asarray(counts[index] == 1)


def _assigned(rows: IntArray, columns: IntArray, worth: FloatArray) -> IntArray:
    """Numbers of the pairs (k,), each above 0, that are worth most one to one."""
    seen, row = np.unique(rows, return_inverse=True)
    mapped, column = np.unique(columns, return_inverse=True)
    numbers = np.full((len(seen), len(mapped)), -1)
    numbers[row, column] = np.arange(len(rows))
    table = np.where(numbers >= 0, worth[numbers], 0.0)
    chosen = numbers[linear_sum_assignment(table, maximize=True)]
    found: IntArray = chosen[chosen >= 0]
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What there is to pair at h poses, and what is expected.

    Attributes:
        pairs: all that may be.
        gains: (k,) what they add to the log odds; -inf where they contradict.
        is_known: (h, n) whether each one seen stands where there is a map.
        expected: (e,) who is expected in sight: pose times `num_mapped` plus column.
        num_mapped: how many landmarks the map has.
    """

    pairs: Pairs
    gains: FloatArray
    is_known: BoolArray
    expected: IntArray
    num_mapped: int

    def best_pairs(self) -> Pairs:
        """One to one, the most probable together."""
        missed = np.where(self._are_expected(self.pairs), _LOG_MISSED, 0.0)
        unmapped = np.where(self.is_known[self.pairs.owners, self.pairs.rows], _LOG_MISSED, 0.0)
        worth = self.gains - unmapped - missed
        useful = worth > 0.0
        return self.pairs.select(useful).one_to_one(worth[useful])

    def log_odds(self, pairs: Pairs) -> FloatArray:
        """(h,) of these, all others unmapped or missed, against nothing of it being mapped.

        The shares that are perceived and mapped are not known: all that they may be count.
        """
        num_poses = len(self.is_known)
        num_expected = np.bincount(self.expected // self.num_mapped, minlength=num_poses)
        num_seen = pairs.sums(1.0 * self._are_expected(pairs), num_poses)
        num_mapped = pairs.sums(1.0 * self.is_known[pairs.owners, pairs.rows], num_poses)
        log_odds: FloatArray = (
            pairs.sums(self._gains_of(pairs), num_poses)
            + log_share(num_seen, num_expected - num_seen)
            + log_share(num_mapped, self.is_known.sum(axis=1) - num_mapped)
        )
        return log_odds

    def _gains_of(self, pairs: Pairs) -> FloatArray:
        """(k,) of some of the pairs; -inf of others."""
        there, wanted = self._keys(self.pairs), self._keys(pairs)
        order = np.argsort(there)
        at = order[np.searchsorted(there, wanted, sorter=order) % max(len(there), 1)]
        gains: FloatArray = np.where(there[at] == wanted, self.gains[at], -np.inf)
        return gains

    def _keys(self, pairs: Pairs) -> IntArray:
        """(k,) a number for each pair."""
        num_seen = self.is_known.shape[1]
        keys: IntArray = (pairs.owners * num_seen + pairs.rows) * self.num_mapped + pairs.columns
        return keys

    def _are_expected(self, pairs: Pairs) -> BoolArray:
        return np.isin(pairs.owners * self.num_mapped + pairs.columns, self.expected)


def log_share(num_in: FloatArray | IntArray, num_out: FloatArray | IntArray) -> FloatArray:
    """(h,) ln probability that of landmarks in a row just these are in and those out.

    Source: the beta-binomial distribution.
    """
    often, seldom = _RULE_COUNTS * _USUAL_SHARE, _RULE_COUNTS * (1.0 - _USUAL_SHARE)
    log_share: FloatArray = betaln(often + num_in, seldom + num_out) - betaln(often, seldom)
    return log_share
