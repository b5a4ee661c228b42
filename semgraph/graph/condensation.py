"""Stretches of poses condensed into one factor each, between their ends and what they sighted.

The poses between are marginalized out where they are now: exact but for what the linearization
leaves. The factor is relative to the first pose, so that the whole stretch may turn and move with
the graph. What is given up: robust weights stay what they were, and poses between are only
followed, no longer estimated. Source: Grisetti, Kuemmerle and Ni 2012 (condensed measurements);
unlike theirs all that is said of the ends and landmarks together is kept, with its correlations.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solveh_banded

from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import GraphError
from semgraph.geometry import composed_poses, relative_poses, wrap_angle
from semgraph.measurement_model import CHI2_2DOF_999


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """What was measured from a pose on, and where everything is now.

    Attributes:
        map_T_bases: (m + 1, 3) of its poses.
        motions, motion_covariances: (m, 3) and (m, 3, 3) between them.
        poses: (s,) of each sighting, 1 to m.
        things: (s,) what each is of, 0 to n - 1.
        polar, covariances: (s, 2) range and bearing, (s, 2, 2).
        map_t_things: (n, 2).
    """

    map_T_bases: FloatArray
    motions: FloatArray
    motion_covariances: FloatArray
    poses: IntArray
    things: IntArray
    polar: FloatArray
    covariances: FloatArray
    map_t_things: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Condensed:
    """A Gaussian over the last pose and the things of a stretch, seen from its first pose.

    Attributes:
        first_T_last: (3,) mean.
        first_t_things: (n, 2) mean.
        triangle: rows of `root` from the diagonal on. In 32 bit: rounding is 1e-4 sigma.
        first_T_between: (m - 1, 3) the poses given up.
    """

    first_T_last: FloatArray
    first_t_things: FloatArray
    triangle: NDArray[np.float32]
    first_T_between: NDArray[np.float32]

    @property
    def size(self) -> int:
        """Of the errors."""
        return 3 + 2 * len(self.first_t_things)

    def root(self) -> FloatArray:
        """(3 + 2n, 3 + 2n) root^T root is the information of their errors.

        Of the last pose in its own frame, of things in the first's.
        """
        root = np.zeros((self.size, self.size))
        root[~np.tri(self.size, k=-1, dtype=np.bool_)] = self.triangle
        return root


def condense(stretch: Stretch) -> Condensed:
    """All that a stretch says, without the poses between its ends.

    Raises:
        GraphError: it says nothing of some of it.
    """
    m, n = len(stretch.motions), len(stretch.map_t_things)
    firsts = np.repeat(stretch.map_T_bases[:1], m + 1, axis=0)
    first_T_bases = relative_poses(firsts, stretch.map_T_bases)
    first_t_things = _inverse_transform(stretch.map_T_bases[0], stretch.map_t_things)
    information, gradient = _normal_equations(stretch, first_T_bases, first_t_things)
    scale = np.sqrt(np.diag(information))
    if not (scale > 0.0).all():
        raise GraphError("a stretch says nothing of a pose or a landmark")
    information, gradient = information / np.outer(scale, scale), gradient / scale
    inner = 3 * (m - 1)
    try:
        solved = solveh_banded(
            _band(information[:inner, :inner]),
            np.column_stack([information[:inner, inner:], gradient[:inner]]),
            lower=True,
        )
        kept = information[inner:, inner:] - information[inner:, :inner] @ solved[:, :-1]
        # Of a thousand columns it takes a third of numpy's time, and the root solves at once.
        root = cholesky(0.5 * (kept + kept.T), check_finite=False)
    except np.linalg.LinAlgError:
        raise GraphError("a stretch is nearly singular") from None
    pull = gradient[inner:] - information[inner:, :inner] @ solved[:, -1]
    shift = -cho_solve((root, False), pull, check_finite=False)
    between = -solved[:, -1] - solved[:, :-1] @ shift
    shift, between = shift / scale[inner:], (between / scale[:inner]).reshape(-1, 3)
    return Condensed(
        composed_poses(first_T_bases[-1:], shift[None, :3])[0],
        first_t_things + shift[3:].reshape(n, 2),
        (root * scale[inner:])[~np.tri(len(root), k=-1, dtype=np.bool_)].astype(np.float32),
        composed_poses(first_T_bases[1:-1], between).astype(np.float32),
    )


def _band(of_poses: FloatArray) -> FloatArray:
    """(6, k) its diagonal and those below: motions join only poses that follow each other."""
    band = np.zeros((min(6, len(of_poses)), len(of_poses)))
    for below in range(len(band)):
        band[below, : len(of_poses) - below] = np.diagonal(of_poses, -below)
    return band


def follow(
    map_T_first: FloatArray, condensed: Condensed, which: IntArray | None = None
) -> FloatArray:
    """(k, 3) the poses given up, or which of them, from where the first is now."""
    between = condensed.first_T_between.astype(np.float64)
    if which is not None:
        between = between[which]
    return composed_poses(np.repeat(map_T_first[None], len(between), axis=0), between)


def whitened_errors(
    condensed: Condensed, map_T_first: FloatArray, map_T_last: FloatArray, map_t_things: FloatArray
) -> FloatArray:
    """(d,) those of `linearized`, which takes thrice as long."""
    first_t = _inverse_transform(map_T_first, map_t_things)
    off = _relative(condensed.first_T_last, _relative(map_T_first, map_T_last))
    whitened: FloatArray = condensed.root() @ _errors(condensed, off, first_t)
    return whitened


def linearized(
    condensed: Condensed, map_T_first: FloatArray, map_T_last: FloatArray, map_t_things: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Whitened errors (d,), and by the first pose (d, 3), the last (d, 3) and each thing (d, n, 2).

    Args:
        condensed: a stretch.
        map_T_first: (3,) where its ends are now.
        map_T_last: (3,).
        map_t_things: (n, 2).
    """
    first_t = _inverse_transform(map_T_first, map_t_things)
    first_T_last = _relative(map_T_first, map_T_last)
    off = _relative(condensed.first_T_last, first_T_last)
    root = condensed.root()
    by_last = root[:, :3] @ _turned(off[2:])[0]
    of_things = root[:, 3:].reshape(len(root), -1, 2)
    by_first = -by_last @ adjoints_of_inverse(first_T_last[None])[0]
    by_first[:, :2] -= of_things.sum(axis=1)
    by_first[:, 2] -= root[:, 3:] @ np.column_stack([-first_t[:, 1], first_t[:, 0]]).ravel()
    c, s = math.cos(map_T_first[2]), math.sin(map_T_first[2])
    by_things = of_things @ np.array([[c, s], [-s, c]])
    return root @ _errors(condensed, off, first_t), by_first, by_last, by_things


def _relative(map_T_a: FloatArray, map_T_b: FloatArray) -> FloatArray:
    """(3,) a_T_b, as `relative_poses` finds many: that takes five times as long for one."""
    (ax, ay, a), (bx, by, b) = map_T_a.tolist(), map_T_b.tolist()
    c, s, x, y = math.cos(a), math.sin(a), bx - ax, by - ay
    return np.array([c * x + s * y, -s * x + c * y, wrap_angle(b - a)])


def _errors(condensed: Condensed, off: FloatArray, first_t: FloatArray) -> FloatArray:
    """(d,) of the last pose, off by (3,), and of the things (n, 2)."""
    return np.concatenate([off, (first_t - condensed.first_t_things).ravel()])


def _inverse_transform(map_T_base: FloatArray, map_t_points: FloatArray) -> FloatArray:
    """base_t_points (n, 2)."""
    c, s = math.cos(map_T_base[2]), math.sin(map_T_base[2])
    moved: FloatArray = (map_t_points - map_T_base[:2]) @ np.array([[c, -s], [s, c]])
    return moved


def _normal_equations(
    stretch: Stretch, first_T_bases: FloatArray, first_t_things: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Information and gradient of all motions and sightings.

    Of the poses after the first, each in its own frame, then of the things, in the first's. Put
    together block by block: as a product of whole matrices it would take many times as long.
    """
    m, n = len(stretch.motions), len(first_t_things)
    poses, things = stretch.poses - 1, stretch.things
    by_start, by_end, of_motions = _motions(stretch, first_T_bases)
    by_pose, by_thing, of_sightings = whitened_sightings(stretch, first_T_bases, first_t_things)
    of_poses, of_things, mixed = np.zeros((m, 3, 3)), np.zeros((n, 2, 2)), np.zeros((m, n, 3, 2))
    np.add.at(of_poses, poses, _squared(by_pose, by_pose))
    np.add.at(of_things, things, _squared(by_thing, by_thing))
    np.add.at(mixed, (poses, things), _squared(by_pose, by_thing))
    of_poses += _squared(by_end, by_end)
    of_poses[:-1] += _squared(by_start[1:], by_start[1:])
    links = _squared(by_start[1:], by_end[1:])
    pulls, pushes = np.zeros((m, 3)), np.zeros((n, 2))
    np.add.at(pulls, poses, _pulled(by_pose, of_sightings))
    np.add.at(pushes, things, _pulled(by_thing, of_sightings))
    pulls += _pulled(by_end, of_motions)
    pulls[:-1] += _pulled(by_start[1:], of_motions[1:])
    information = np.zeros((3 * m + 2 * n, 3 * m + 2 * n))
    each, every = np.arange(m), np.arange(n)
    of_all = information[: 3 * m, : 3 * m].reshape(m, 3, m, 3)
    of_all[each, :, each, :] = of_poses
    of_all[each[:-1], :, each[1:], :] = links
    of_all[each[1:], :, each[:-1], :] = links.transpose(0, 2, 1)
    information[3 * m :, 3 * m :].reshape(n, 2, n, 2)[every, :, every, :] = of_things
    information[: 3 * m, 3 * m :] = mixed.transpose(0, 2, 1, 3).reshape(3 * m, 2 * n)
    information[3 * m :, : 3 * m] = information[: 3 * m, 3 * m :].T
    return information, np.concatenate([pulls.ravel(), pushes.ravel()])


def _squared(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n, i, j) a^T b of each."""
    return np.asarray(a.transpose(0, 2, 1) @ b)


def _pulled(a: FloatArray, errors: FloatArray) -> FloatArray:
    """(n, i) a^T e of each."""
    return np.asarray(np.einsum("nki,nk->ni", a, errors))


def _motions(
    stretch: Stretch, first_T_bases: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """By the pose before and after each (m, 3, 3), and errors (m, 3), whitened."""
    moved = relative_poses(first_T_bases[:-1], first_T_bases[1:])
    errors = relative_poses(stretch.motions, moved)
    whiten = np.linalg.inv(np.linalg.cholesky(stretch.motion_covariances))
    by_end = whiten @ _turned(errors[:, 2])
    by_start = -by_end @ adjoints_of_inverse(moved)
    return by_start, by_end, np.einsum("nij,nj->ni", whiten, errors)


def _turned(angles: FloatArray) -> FloatArray:
    """(n, 3, 3) rotations of the position, the heading left as it is."""
    turned = np.zeros((len(angles), 3, 3))
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(angles)
    turned[:, 1, 0], turned[:, 0, 1] = np.sin(angles), -np.sin(angles)
    turned[:, 2, 2] = 1.0
    return turned


def adjoints_of_inverse(a_T_b: FloatArray) -> FloatArray:
    """(n, 3, 3) that take a tangent vector from frame a of each (n, 3) to frame b."""
    c, s = np.cos(a_T_b[:, 2]), np.sin(a_T_b[:, 2])
    x, y = a_T_b[:, 0], a_T_b[:, 1]
    adjoints = np.zeros((len(a_T_b), 3, 3))
    adjoints[:, 0, 0] = adjoints[:, 1, 1] = c
    adjoints[:, 0, 1], adjoints[:, 1, 0] = s, -s
    adjoints[:, 0, 2], adjoints[:, 1, 2] = s * x - c * y, c * x + s * y
    adjoints[:, 2, 2] = 1.0
    return adjoints


def whitened_sightings(
    stretch: Stretch, first_T_bases: FloatArray, first_t_things: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """By pose (s, 2, 3), by thing (s, 2, 2) and errors (s, 2), whitened.

    What lies outside its gate weighs as little as the robust kernel (DCS) lets it.
    """
    poses = first_T_bases[stretch.poses]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    delta = first_t_things[stretch.things] - poses[:, :2]
    base_t = np.column_stack([c * delta[:, 0] + s * delta[:, 1], c * delta[:, 1] - s * delta[:, 0]])
    ranges_m = np.maximum(np.hypot(base_t[:, 0], base_t[:, 1]), 1e-6)
    bearings = np.arctan2(base_t[:, 1], base_t[:, 0])
    errors = np.column_stack(
        [ranges_m - stretch.polar[:, 0], wrap_angle(bearings - stretch.polar[:, 1])]
    )
    unit = base_t / ranges_m[:, None]
    across = np.column_stack([-unit[:, 1], unit[:, 0]]) / ranges_m[:, None]
    by_base_t = np.stack([unit, across], axis=1)
    by_pose = np.zeros((len(poses), 2, 3))
    by_pose[:, :, :2] = -by_base_t
    by_pose[:, 1, 2] = -1.0
    base_R_first = np.stack([np.column_stack([c, s]), np.column_stack([-s, c])], axis=1)
    whiten = np.linalg.inv(np.linalg.cholesky(stretch.covariances))
    whitened = np.einsum("nij,nj->ni", whiten, errors)
    distances2 = np.einsum("ni,ni->n", whitened, whitened)
    beyond = np.maximum(distances2, CHI2_2DOF_999)
    weights = 2.0 * CHI2_2DOF_999 / (CHI2_2DOF_999 + beyond)
    whiten = whiten * weights[:, None, None]
    return whiten @ by_pose, whiten @ by_base_t @ base_R_first, whitened * weights[:, None]
