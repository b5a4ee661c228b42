"""A small stand of trees, a map of it, and what is perceived in it."""

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.geometry import Pose2, UncertainPose2, wrap_angle
from semgraph.known_map.fixed_map import FixedMap
from semgraph.landmarks import Kind, Perceptions, polar_covariances

SIGMAS = (0.03, 0.005)
ODOMETRY = np.diag([0.02, 0.01, 0.005]) ** 2


def stand(seed: int = 0, num_trees: int = 60, size_m: float = 60.0) -> FixedMap:
    rng = np.random.default_rng(seed)
    diameters_m = rng.uniform(0.1, 0.6, num_trees)
    return fixed(rng.uniform(0.0, size_m, (num_trees, 2)), diameters_m)


def fixed(
    positions: FloatArray, diameters_m: FloatArray | None = None, sigma_m: float = 0.02
) -> FixedMap:
    m = len(positions)
    known = np.full(m, np.nan) if diameters_m is None else diameters_m
    return FixedMap(
        positions,
        np.tile(sigma_m**2 * np.eye(2), (m, 1, 1)),
        np.full(m, int(Kind.TREE)),
        known,
        0.05 * known,
        np.full(m, "", dtype=np.str_),
    )


def perceive(
    trees: FixedMap,
    map_T_base: Pose2,
    stamp_ns: int,
    rng: np.random.Generator,
    reach_m: float = 15.0,
) -> Perceptions:
    base_t = map_T_base.inverse().transform(trees.map_t_landmarks)
    near = np.flatnonzero(np.hypot(*base_t.T) < reach_m)
    n = len(near)
    noise = rng.standard_normal((2, n)) * np.array(SIGMAS)[:, None]
    diameters_m = trees.diameters_m[near] * np.exp(0.1 * rng.standard_normal(n))
    return Perceptions.from_arrays(
        stamp_ns,
        Kind.TREE,
        np.maximum(np.hypot(*base_t[near].T) + noise[0], 0.05),
        wrap_angle(np.arctan2(base_t[near, 1], base_t[near, 0]) + noise[1]),
        polar_covariances(np.full(n, SIGMAS[0]), np.full(n, SIGMAS[1])),
        diameters_m=diameters_m,
        diameter_sigmas_m=0.1 * diameters_m,
    )


def measured(motion: Pose2, rng: np.random.Generator) -> UncertainPose2:
    error = Pose2.from_array(rng.multivariate_normal(np.zeros(3), ODOMETRY))
    return UncertainPose2(motion @ error, ODOMETRY)


def moved(trees: FixedMap, world_T_map: Pose2) -> FixedMap:
    """The same trees in another frame; their covariances are round."""
    return fixed(world_T_map.transform(trees.map_t_landmarks), trees.diameters_m)
