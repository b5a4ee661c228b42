"""What all perceptions of a run together most probably are of, given the map.

A run of sightings that is off by one of two things beside each other fits within the gates, and the
poses follow it: no perception alone says so. Here hypotheses of the whole path are followed through
the map, each a Gaussian pose with all associations so far. In a given map the future depends on the
past by the pose alone, so of two that stand at one place only the better one goes on, and a few
dozen are enough.

Source: Viterbi 1967 over the hypotheses of Reid 1979; the poses are Kalman filters'.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import composed_poses, points_from, relative_poses, wrap_angle
from semgraph.hypotheses import SLIP_FACTOR, SLIPS
from semgraph.measurement_model import CHI2_2DOF_999
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.reassociation import Appearances
from semgraph.offline.sight_habits import NEVER, SightHabits

_NONE: Final = -1
_HYPOTHESES: Final = 32
# What is less probable than the best by more than this, as -2 ln, does not come back.
_LEFT_BEHIND: Final = 40.0
# Hypotheses are of one place within this squared distance in their own sigmas.
_ONE_PLACE: Final = 0.1
_LOG_2PI: Final = 2.0 * float(np.log(2.0 * np.pi))


@dataclass(slots=True)
class _Hypotheses:
    """k of them, as structure of arrays.

    Attributes:
        poses: (k, 3) map_T_base.
        covariances: (k, 3, 3), each in its own frame.
        costs: (k,) -2 ln of how probable each is.
        parents: (k,) rows of those of the scan before.
        last: (k, c) the scan that each landmark was last in.
        taken: (k, j) the landmarks of this scan's perceptions so far.
    """

    poses: FloatArray
    covariances: FloatArray
    costs: FloatArray
    parents: IntArray
    last: IntArray
    taken: IntArray

    def select(self, rows: IntArray) -> None:
        """Only those go on, in this order."""
        for name in self.__slots__:
            setattr(self, name, getattr(self, name)[rows])


@dataclass(frozen=True, slots=True, eq=False)
class _Map:
    """The landmarks (c, 2), their habits, and what they look like."""

    places: FloatArray
    habits: SightHabits
    appearances: Appearances


def followed(batch: Batch, belief: Belief) -> IntArray:
    """(m,) the landmark of each perception of a batch of one session, -1 for none.

    Being of none costs as much as the 99.9 % gate.

    Args:
        batch: what was measured.
        belief: its landmarks are the map; its associations say how soon things are sighted again.
    """
    if not belief.map_t_landmarks:
        return np.full(len(batch.seen), _NONE)
    ids, columns = columns_of(belief)
    habits = SightHabits.of(batch, columns, len(ids))
    known = _Map(belief.places(ids), habits, Appearances.of(batch, belief, ids))
    found = _best(batch, known)
    return np.where(found >= 0, ids[found], _NONE)


def columns_of(belief: Belief) -> tuple[IntArray, IntArray]:
    """The landmarks (c,), sorted, and which of them each perception is of (m,), -1 for none."""
    ids = np.array(sorted(belief.map_t_landmarks), dtype=np.int64)
    columns = np.searchsorted(ids, belief.landmarks)
    return ids, np.where(belief.assigned(), columns, _NONE)


def _best(batch: Batch, known: _Map) -> IntArray:
    """(m,) the associations of the hypothesis that is the best in the end."""
    start = batch.starts[0]
    now = _Hypotheses(
        start.pose.as_array()[None],
        np.array(start.covariance)[None],
        np.zeros(1),
        np.zeros(1, dtype=np.int64),
        np.full((1, len(known.places)), NEVER),
        np.zeros((1, 0), dtype=np.int64),
    )
    ends = np.searchsorted(batch.scans, np.arange(len(batch) + 1))
    passed: list[tuple[IntArray, IntArray]] = []
    for scan in range(len(batch)):
        _move(now, batch, scan)
        surprises = known.habits.surprises(scan, now.last)
        for row in range(ends[scan], ends[scan + 1]):
            surprises = surprises[_sight(now, batch, known, row, surprises)]
        now.select(_apart(now))
        for taken in now.taken.T:
            rows = np.flatnonzero(taken >= 0)
            now.last[rows, taken[rows]] = scan
        passed.append((now.parents, now.taken))
    return _traced(passed, int(now.costs.argmin()))


def _traced(passed: list[tuple[IntArray, IntArray]], row: int) -> IntArray:
    """(m,) what a hypothesis of the last scan took all perceptions for."""
    found = []
    for parents, taken in reversed(passed):
        found.append(taken[row])
        row = int(parents[row])
    return np.concatenate(found[::-1])


def _move(now: _Hypotheses, batch: Batch, scan: int) -> None:
    """Each goes on by the wheels, and once more as if they had slipped."""
    motion = batch.motion(scan)
    k = len(now.poses)
    here_Ad_last = motion.pose.inverse().adjoint()
    moved = here_Ad_last @ now.covariances @ here_Ad_last.T
    poses = composed_poses(now.poses, np.tile(motion.pose.as_array(), (k, 1)))
    slipped = moved + SLIP_FACTOR**2 * motion.covariance
    now.poses = np.concatenate([poses, poses])
    now.covariances = np.concatenate([moved + motion.covariance, slipped])
    now.costs = np.concatenate([now.costs, now.costs - 2.0 * np.log(SLIPS)])
    now.parents = np.tile(np.arange(k), 2)
    now.last = np.concatenate([now.last, now.last])
    now.taken = np.zeros((2 * k, 0), dtype=np.int64)


def _sight(
    now: _Hypotheses, batch: Batch, known: _Map, row: int, surprises: FloatArray
) -> IntArray:
    """Each goes on with every landmark that a perception may be of, and with none.

    Args:
        now: gets what is probable enough.
        batch: what was measured.
        known: the map.
        row: of the perception.
        surprises: (k, c) of each landmark by habit.

    Returns:
        (l,) the row of `now`, as it was, that each goes on from.
    """
    R, c = batch.covariances[row], len(known.places)
    errors, J = _predicted(now.poses, known.places, batch, row)
    PJ = now.covariances[:, None] @ J.swapaxes(-1, -2)
    S = J @ PJ + R
    S_inverse, determinants = _inverted(S)
    weighed = (S_inverse @ errors[..., None])[..., 0]
    distances2 = (errors * weighed).sum(axis=-1)
    alike = known.appearances.may_be(batch, np.full(c, row), np.arange(c))
    can = (distances2 <= CHI2_2DOF_999) & alike
    if now.taken.shape[1]:
        can &= ~(now.taken[:, :, None] == np.arange(c)).any(axis=1)
    costs = distances2 + np.log(determinants) + _LOG_2PI + surprises
    none = CHI2_2DOF_999 + np.log(np.linalg.det(R)) + _LOG_2PI + known.habits.of_none(c)
    options = np.column_stack([np.where(can, costs, np.inf), np.full(len(costs), none)])
    totals = (now.costs[:, None] + options).ravel()
    kept = _probable(totals, 4 * _HYPOTHESES)
    rows, columns = np.divmod(kept, c + 1)
    is_known = columns < c
    now.select(rows)
    now.costs = totals[kept]
    now.taken = np.column_stack([now.taken, np.where(is_known, columns, _NONE)])
    hit, at = np.flatnonzero(is_known), (rows[is_known], columns[is_known])
    steps = (PJ[at] @ weighed[at][..., None])[..., 0]
    gains = PJ[at] @ S_inverse[at]
    now.poses[hit] = composed_poses(now.poses[hit], steps)
    now.covariances[hit] -= gains @ PJ[at].swapaxes(-1, -2)
    return rows


def _predicted(
    poses: FloatArray, places: FloatArray, batch: Batch, row: int
) -> tuple[FloatArray, FloatArray]:
    """(k, c, 2) range and bearing perceived minus predicted, and Jacobians by pose (k, c, 2, 3)."""
    k, c = len(poses), len(places)
    base_t = points_from(np.repeat(poses, c, axis=0), np.tile(places, (k, 1))).reshape(k, c, 2)
    x, y = np.moveaxis(base_t, -1, 0)
    r = np.maximum(np.hypot(x, y), 1e-3)
    bearings = wrap_angle(batch.seen.bearings[row] - np.arctan2(y, x))
    zero, one = np.zeros_like(r), np.ones_like(r)
    by_pose = np.stack([-x / r, -y / r, zero, y / r**2, -x / r**2, -one], axis=-1)
    errors = np.stack([batch.seen.ranges_m[row] - r, bearings], axis=-1)
    return errors, by_pose.reshape(k, c, 2, 3)


def _inverted(S: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(..., 2, 2) the inverses of symmetric matrices, and (...) their determinants."""
    a, b, d = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    determinants = a * d - b * b
    adjugates = np.stack([d, -b, -b, a], axis=-1).reshape(S.shape)
    return adjugates / determinants[..., None, None], determinants


def _probable(costs: FloatArray, most: int) -> IntArray:
    """Those that are not left behind, the most probable ones first."""
    order = np.argsort(costs, kind="stable")[:most]
    kept: IntArray = order[costs[order] < costs[order[0]] + _LEFT_BEHIND]
    return kept


def _apart(now: _Hypotheses) -> IntArray:
    """The most probable one of each place, the best first."""
    order = _probable(now.costs, 3 * _HYPOTHESES)
    poses = now.poses[order]
    variances = np.einsum("kii->ki", now.covariances[order])
    n = len(poses)
    differences = relative_poses(np.repeat(poses, n, axis=0), np.tile(poses, (n, 1)))
    differences = differences.reshape(n, n, 3)
    is_near = (differences**2 / variances[:, None]).sum(axis=-1) < _ONE_PLACE
    is_left = np.ones(len(order), dtype=np.bool_)
    kept: list[int] = []
    for row in range(len(order)):
        if is_left[row] and len(kept) < _HYPOTHESES:
            kept.append(row)
            is_left &= ~is_near[row]
    return np.asarray(order[kept])
