"""What was seen lately, as seen from here: more than one scan to find a place by."""

from typing import Final

import numpy as np

from semgraph.arrays import FloatArray
from semgraph.fast_estimator import FastEstimator, FastSettings
from semgraph.geometry import Pose2, UncertainPose2, relative_poses, rotation, wrap_angle
from semgraph.known_map.expected_sights import Lately
from semgraph.landmarks import Perceptions

_REACH_M: Final = 25.0
_MEMORY_M: Final = 20.0
# What was seen once only, and not since so far, was nothing.
_JUST_NOW_M: Final = 0.5
_LEAST_RANGE_M: Final = 0.05
# What a short memory drifts.
_DRIFT_SIGMA_M: Final = 0.05
# Of four perceptions or more, a scan that matches less has broken off.
_ENOUGH: Final = 4
# Where it looked from: so far apart, and so many places.
_WAY_STEP_M: Final = 1.0
_MOST_WAY: Final = 15
_LEAST_SHARE: Final = 0.25


class Surroundings:
    """Things around the robot, gathered by a fast estimator with a short memory of its own."""

    def __init__(self, settings: FastSettings) -> None:
        self._settings = settings.model_copy(update={"memory_m": _MEMORY_M})
        self.forget()

    def forget(self) -> None:
        """Nothing was seen lately."""
        self._tracker = FastEstimator(self._settings, Pose2())
        self._odom_T_then = np.zeros((0, 3))

    def add(self, perceptions: Perceptions, odometry: UncertainPose2 | None) -> Lately:
        """All that was seen lately, each thing once, relative to base now.

        A thing seen once only is as probably nothing, and soon forgotten. Where hardly anything is
        seen again, the robot made a leap, and all before is forgotten.
        """
        num_before = len(self._tracker.navigation_map)
        step = self._tracker.step(perceptions, odometry)
        again = int(((step.landmark_ids >= 0) & (step.landmark_ids < num_before)).sum())
        if num_before and len(perceptions) >= _ENOUGH and again < _LEAST_SHARE * len(perceptions):
            self.forget()
            step = self._tracker.step(perceptions, None)
        odom_T_base = step.map_T_base.pose
        return Lately(self._as_seen_from(odom_T_base, perceptions.stamp_ns), self._way(odom_T_base))

    def _way(self, odom_T_base: Pose2) -> FloatArray:
        """(t, 3) base_T_then, a metre apart, the last one here."""
        here = odom_T_base.as_array()
        way = np.vstack([self._odom_T_then, here])
        apart_m = np.hypot(*(self._odom_T_then[-1:, :2] - here[:2]).T)
        if not len(apart_m) or apart_m[0] >= _WAY_STEP_M:
            self._odom_T_then = way[-_MOST_WAY:]
        return relative_poses(np.tile(here, (len(way), 1)), way)

    def _as_seen_from(self, odom_T_base: Pose2, stamp_ns: int) -> Perceptions:
        gathered = self._tracker.navigation_map
        here, since_m = odom_T_base.as_array()[:2], self._tracker.remembered_since_m
        ids = gathered.near(here, _REACH_M, since_m)
        just_now = gathered.near(here, _REACH_M, since_m + _MEMORY_M - _JUST_NOW_M)
        ids = ids[(gathered.num_sightings(ids) > 1) | np.isin(ids, just_now)]
        base_t = odom_T_base.inverse().transform(gathered.positions(ids))
        ranges_m = np.hypot(base_t[:, 0], base_t[:, 1])
        ids, base_t = ids[ranges_m > _LEAST_RANGE_M], base_t[ranges_m > _LEAST_RANGE_M]
        base_R_odom = rotation(-odom_T_base.theta)
        covariances = base_R_odom @ gathered.covariances(ids) @ base_R_odom.T
        # They are of independent sightings, which have half of their sigma in common.
        num_sightings = gathered.num_sightings(ids)
        shares = 0.75 + 0.25 * num_sightings
        covariances = shares[:, None, None] * covariances
        diameters_m, diameter_sigmas_m = gathered.diameters(ids)
        diameter_sigmas_m = np.sqrt(shares / num_sightings) * diameter_sigmas_m
        return Perceptions.from_arrays(
            stamp_ns,
            gathered.kinds(ids),
            np.hypot(base_t[:, 0], base_t[:, 1]),
            wrap_angle(np.arctan2(base_t[:, 1], base_t[:, 0])),
            _polar(base_t, covariances + _DRIFT_SIGMA_M**2 * np.eye(2)),
            diameters_m=diameters_m,
            diameter_sigmas_m=diameter_sigmas_m,
            identities=np.array(gathered.identities(ids), dtype=np.str_),
            reliabilities=1.0 - 0.5**num_sightings,
        )


def _polar(base_t: FloatArray, covariances: FloatArray) -> FloatArray:
    """(n, 2, 2) of (range, bearing) for covariances (n, 2, 2) of points (n, 2)."""
    x, y = base_t.T
    r = np.hypot(x, y)
    J = np.stack(
        [np.stack([x / r, y / r], axis=-1), np.stack([-y / r**2, x / r**2], axis=-1)], axis=-2
    )
    polar = J @ covariances @ J.transpose(0, 2, 1)
    symmetric: FloatArray = 0.5 * (polar + polar.transpose(0, 2, 1))
    return symmetric
