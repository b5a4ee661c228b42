"""How an estimator that brings no motion model of its own expects to have moved."""

from dataclasses import dataclass, field

from semgraph.fast_estimator import FastSettings
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.moments import Moment
from semgraph.motion_model import MotionNoise, constant_motion
from semgraph.movement import KNOWN_START


@dataclass(slots=True)
class Motions:
    """By the wheels, else the last movement of the estimates once more, as the fast estimator."""

    settings: FastSettings
    _last_pose: Pose2 = field(default_factory=Pose2)
    _last_motion: Pose2 = field(default_factory=Pose2)
    _last_seconds: float = 0.0
    _last_ns: int | None = None

    def motion(self, moment: Moment) -> UncertainPose2:
        """last_T_current."""
        if moment.odometry is not None:
            return moment.odometry
        if self._last_ns is None:
            return UncertainPose2(Pose2(), KNOWN_START)
        seconds = (moment.perceptions.stamp_ns - self._last_ns) * 1e-9
        noise = MotionNoise(self.settings.acceleration, self.settings.angular_acceleration)
        return constant_motion(self._last_motion, self._last_seconds, seconds, noise)

    def remember(self, moment: Moment, map_T_base: Pose2) -> None:
        """Where the moment's pose turned out to be."""
        stamp_ns = moment.perceptions.stamp_ns
        if self._last_ns is not None:
            self._last_motion = self._last_pose.between(map_T_base)
            self._last_seconds = (stamp_ns - self._last_ns) * 1e-9
        self._last_pose, self._last_ns = map_T_base, stamp_ns
