"""How the robot moved lately, as far as its places told, and what to expect of it next."""

from typing import Final, final

import numpy as np

from semgraph.geometry import Pose2, UncertainPose2
from semgraph.motion_model import (
    MotionHabit,
    MotionNoise,
    constant_motion,
    corrected,
    span_s2,
)

KNOWN_START: Final = np.diag([1e-6**2, 1e-6**2, 1e-6**2])
# So many landmarks seen twice tell how the robot moved.
_TELL_SPEED: Final = 2
# The share of a wandering velocity's variance that one place after it leaves.
_LEFT_BY_ONE_PLACE: Final = 0.25


@final
class Movement:
    """The last movement, how surely it tells the velocity, and how evenly the robot moved so far.

    Args:
        noise: how much a velocity may change.
    """

    def __init__(self, noise: MotionNoise) -> None:
        self._noise, self._habit = noise, MotionHabit(noise)
        self._last = Pose2()
        self._last_seconds = 0.0
        # For how long the velocity was free to change.
        self._unseen_seconds = 0.0
        self._num_known = 0
        self._was_perceived = False
        self._was_speed_seen = False
        self._last_stamp_ns: int | None = None

    def restart(self, stamp_ns: int) -> None:
        """The movement up to now is not known; how evenly the robot moves still is."""
        self._last, self._last_seconds, self._unseen_seconds = Pose2(), 0.0, 0.0
        self._last_stamp_ns, self._was_perceived = stamp_ns, False
        self._was_speed_seen = False
        self._num_known = 0

    def expected(self, stamp_ns: int) -> UncertainPose2:
        """last_T_current: the last movement once more, with all that a velocity may change."""
        return self._once_more(stamp_ns, self._noise)

    def usual(self, stamp_ns: int) -> UncertainPose2:
        """The same with what it changed so far."""
        return self._once_more(stamp_ns, self._habit.noise())

    def told(self, stamp_ns: int, expected: UncertainPose2) -> UncertainPose2:
        """What is expected, with all that it leaves open of a speed that nobody has seen.

        One landmark alone tells driving past it from turning before it by what is usual only. The
        speed that this begins with is good to go on with, but says nothing.
        """
        if self._was_speed_seen or self._last_stamp_ns is None:
            return expected
        seconds = (stamp_ns - self._last_stamp_ns) * 1e-9
        unknown = constant_motion(Pose2(), 0.0, seconds, self._noise, self._unseen_seconds)
        return UncertainPose2(expected.pose, unknown.covariance)

    def note(
        self,
        stamp_ns: int,
        expected: Pose2,
        moved: Pose2,
        num_known: int,
        *,
        is_seen: bool,
        is_perceived: bool,
    ) -> None:
        """One movement more.

        Args:
            stamp_ns: when it ended.
            expected: last_T_current by the motion model.
            moved: the same as it was found.
            num_known: landmarks in sight at its end that will be known when they are seen again.
            is_seen: whether anything was matched.
            is_perceived: whether enough was to solve for the place.
        """
        if self._last_stamp_ns is not None:
            seconds = (stamp_ns - self._last_stamp_ns) * 1e-9
            self._learn_habit(stamp_ns, moved, seconds, is_perceived=is_perceived)
            self._learn_velocity(
                expected, moved, seconds, is_seen=is_seen, is_perceived=is_perceived
            )
        self._was_perceived, self._num_known = is_perceived, num_known
        self._last_stamp_ns = stamp_ns

    def _once_more(self, stamp_ns: int, noise: MotionNoise) -> UncertainPose2:
        if self._last_stamp_ns is None:
            return UncertainPose2(Pose2(), KNOWN_START)
        seconds = (stamp_ns - self._last_stamp_ns) * 1e-9
        # From what is in sight by now, a speed that nobody knows leads no farther than it can.
        is_begun = self._last_seconds <= 0.0 and self._num_known > 0
        unseen_seconds = 0.0 if is_begun else self._unseen_seconds
        return constant_motion(self._last, self._last_seconds, seconds, noise, unseen_seconds)

    def _learn_habit(
        self, stamp_ns: int, moved: Pose2, seconds: float, *, is_perceived: bool
    ) -> None:
        """Two places that were solved for, after a movement, tell how much that changed."""
        if is_perceived and self._was_perceived and self._last_seconds > 0.0:
            span = span_s2(self._last_seconds, seconds)
            self._habit.note(self.expected(stamp_ns).pose, moved, span)

    def _learn_velocity(
        self, expected: Pose2, moved: Pose2, seconds: float, *, is_seen: bool, is_perceived: bool
    ) -> None:
        """Two places that were solved for tell the velocity."""
        is_movement = is_perceived and self._was_perceived
        self._was_speed_seen |= is_perceived and self._num_known >= _TELL_SPEED
        unseen_seconds = 0.0 if is_movement else self._unseen_seconds
        if self._last_seconds > 0.0:
            self._last = corrected(expected, moved, seconds, unseen_seconds)
            self._last_seconds = seconds
        elif self._num_known and is_seen:
            self._last, self._last_seconds = moved, seconds
        self._unseen_seconds = (
            _LEFT_BY_ONE_PLACE * unseen_seconds if is_perceived else unseen_seconds + seconds
        )
