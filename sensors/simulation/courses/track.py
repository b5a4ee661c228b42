"""Ways to drive: closed curves, and the motion of a vehicle along one."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import Pose2, wrap_angle
from sensors.measurements import Tilt
from sensors.simulation.noise import gauss_markov

_NUM_POINTS: Final = 720
_TILT_CORRELATION_S: Final = 0.5


class Track:
    """A smooth closed curve through points (n, 2) m, by the distance driven along it."""

    def __init__(self, world_t_points: FloatArray) -> None:
        from scipy.interpolate import CubicSpline

        closed = np.vstack([world_t_points, world_t_points[:1]])
        chords_m = np.hypot(*np.diff(closed, axis=0).T)
        along_m = np.concatenate([[0.0], np.cumsum(chords_m)])
        self.length_m: Final = float(along_m[-1])
        self._spline: Final = CubicSpline(along_m, closed, bc_type="periodic")

    @classmethod
    def around(cls, radius_m: float, waves: FloatArray | None = None) -> Self:
        """Counter-clockwise around the origin; from (radius, 0) on if it is a circle.

        `waves` (k, 2): the radius swings k + 1 times a lap, by a share of it and from a phase.
        """
        angles = np.linspace(0.0, 2.0 * np.pi, _NUM_POINTS, endpoint=False)
        shares = np.ones(len(angles))
        for k, (share, phase) in enumerate(np.zeros((0, 2)) if waves is None else waves):
            shares += share * np.cos((k + 1) * angles + phase)
        return cls(radius_m * shares[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]))

    def poses(self, along_m: FloatArray) -> FloatArray:
        """(n, 3) at distances (n,), looking ahead; laps go on."""
        x, y = self._spline(along_m).T
        ahead_x, ahead_y = self._spline(along_m, 1).T
        return np.column_stack([x, y, np.arctan2(ahead_y, ahead_x)])

    def curvatures(self, along_m: FloatArray) -> FloatArray:
        """(n,) rad/m, to the left positive."""
        ax, ay = self._spline(along_m, 1).T
        bx, by = self._spline(along_m, 2).T
        return np.asarray((ax * by - ay * bx) / np.hypot(ax, ay) ** 3)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """How a vehicle really moves, at every tick of a clock.

    Attributes:
        stamps_ns: (n,).
        poses: (n, 3) world_T_base.
        speeds, yaw_rates: (n,) m/s ahead, rad/s.
        tilts: (n, 2) roll and pitch.
    """

    stamps_ns: IntArray
    poses: FloatArray
    speeds: FloatArray
    yaw_rates: FloatArray
    tilts: FloatArray

    def pose(self, tick: int) -> Pose2:
        """world_T_base at a tick."""
        return Pose2.from_array(self.poses[tick])

    def tilt(self, tick: int) -> Tilt:
        """How base leans at a tick."""
        roll, pitch = self.tilts[tick].tolist()
        return Tilt(roll, pitch)


def drive(
    track: Track,
    speed: float,
    seconds: float,
    clock_hz: float,
    *,
    tilt_sigma: float = 0.0,
    rng: np.random.Generator,
) -> Drive:
    """A drive at constant speed; roll and pitch wander over half a second by `tilt_sigma` rad."""
    times = np.arange(int(round(seconds * clock_hz, 6)) + 1) / clock_hz
    along_m = speed * times
    return Drive(
        np.round(times * 1e9).astype(np.int64),
        _wrapped(track.poses(along_m)),
        np.full(len(times), speed),
        speed * track.curvatures(along_m),
        gauss_markov(times, tilt_sigma, _TILT_CORRELATION_S, 2, rng),
    )


def beside(
    track: Track,
    count: int,
    between_m: tuple[float, float],
    rng: np.random.Generator,
    sides: tuple[float, ...] = (-1.0, 1.0),
) -> tuple[FloatArray, FloatArray]:
    """(count, 2) places so far from a track, and (count, 3) poses on it beside them.

    They are spread along the track, never evenly; `sides` are 1 for its left, -1 for its right.
    """
    steps = (np.arange(count) + rng.uniform(0.1, 0.9, count)) / max(count, 1)
    poses = track.poses(steps * track.length_m)
    aside_m = rng.uniform(*between_m, count) * rng.choice(sides, count)
    left = np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])
    return poses[:, :2] + aside_m[:, None] * left, _wrapped(poses)


def _wrapped(poses: FloatArray) -> FloatArray:
    return np.column_stack([poses[:, :2], wrap_angle(poses[:, 2])])
