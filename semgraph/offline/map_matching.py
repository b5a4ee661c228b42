"""Which landmarks of two maps are one, and how the maps lie to each other."""

from typing import Final

import numpy as np

from semgraph.alignment import Alignment, align
from semgraph.arrays import BoolArray, IntArray
from semgraph.geometry import Pose2, rotation
from semgraph.measurement_model import CHI2_2DOF_999, diameters_contradict, mahalanobis2
from semgraph.offline.assignment import one_to_one
from semgraph.offline.prior_map import PriorMap

# How far the frames may be off at first, and after each fit.
_FRAME_SIGMAS_M: Final = (1.0, 0.7, 0.5, 0.3, 0.2, 0.1, 0.0, 0.0)
_NEAREST: Final = 8


def match_maps(prior: PriorMap, new: PriorMap, frame_sigma_m: float = 0.0) -> IntArray:
    """(k,) the row of `new` that each landmark of `prior` is, -1 for none; one to one.

    Both within the 99.9 % gate of their covariances together, alike in kind, identity and
    diameter.

    Args:
        prior: k landmarks.
        new: in the same frame.
        frame_sigma_m: how far the frames may be off, one axis.
    """
    from scipy.spatial import KDTree

    found = np.full(len(prior), -1, dtype=np.int64)
    count = min(_NEAREST, len(new))
    near = KDTree(new.map_t_landmarks).query(prior.map_t_landmarks, k=count)[1]
    rows, columns = np.repeat(np.arange(len(prior)), count), np.asarray(near).ravel()
    differences = prior.map_t_landmarks[rows] - new.map_t_landmarks[columns]
    S = prior.covariances[rows] + new.covariances[columns] + frame_sigma_m**2 * np.eye(2)
    distances2 = np.where(_alike(prior, new, rows, columns), mahalanobis2(differences, S), np.inf)
    holds = one_to_one(rows, columns, distances2, CHI2_2DOF_999)
    found[rows[holds]] = columns[holds]
    return found


def locate(prior: PriorMap, new: PriorMap, prior_T_new: Pose2) -> Pose2:
    """prior_T_new, where it is known to about a metre: pairs and rigid fits by turns."""
    for sigma_m in _FRAME_SIGMAS_M:
        pairs = match_maps(prior, moved_map(new, prior_T_new), sigma_m)
        rows = np.flatnonzero(pairs >= 0)
        both = prior.covariances[rows] + new.covariances[pairs[rows]]
        variances = 0.5 * np.trace(both, axis1=1, axis2=2) + sigma_m**2
        fit = align(new.map_t_landmarks[pairs[rows]], prior.map_t_landmarks[rows], variances)
        if isinstance(fit, Alignment):
            prior_T_new = fit.map_T_base.pose
    return prior_T_new


def moved_map(new: PriorMap, prior_T_new: Pose2) -> PriorMap:
    """The same landmarks in another frame."""
    R = rotation(prior_T_new.theta)
    return PriorMap(
        new.names,
        new.kinds,
        prior_T_new.transform(new.map_t_landmarks),
        R @ new.covariances @ R.T,
        new.diameters_m,
        new.diameter_sigmas_m,
        new.identities,
    )


def _alike(prior: PriorMap, new: PriorMap, rows: IntArray, columns: IntArray) -> BoolArray:
    identities = np.array(prior.identities)[rows] == np.array(new.identities)[columns]
    contradict = diameters_contradict(
        prior.diameters_m[rows],
        prior.diameter_sigmas_m[rows],
        new.diameters_m[columns],
        new.diameter_sigmas_m[columns],
    )
    same: BoolArray = (prior.kinds[rows] == new.kinds[columns]) & identities & ~contradict
    return same
