"""What the estimators see, moment by moment, of a recording's measurements."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from semgraph.doubles import each_once
from semgraph.files.yaw_rates import YawRateLog
from semgraph.geometry import Pose2, UncertainPose2
from semgraph.landmarks import Perceptions
from semgraph.motion_model import OdometryAccumulator
from semgraph.pacing import Pace
from semgraph.perceiving import Perceiver
from sensors.measurements import ImuSample, Measurement, Raw, Recording, WheelOdometry
from sensors.views import View


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """What the estimators see at one time, relative to base.

    Attributes:
        perceptions: of all sensors, each thing once.
        odometry: the wheels' motion since the moment before; None without wheels.
        views: how far lasers saw.
        measurements: what was perceived in.
        odom_T_base: by the wheels; None without.
    """

    perceptions: Perceptions
    odometry: UncertainPose2 | None
    views: tuple[View, ...]
    measurements: tuple[Raw, ...]
    odom_T_base: Pose2 | None


def moments(
    recording: Recording, perceiver: Perceiver, imu: YawRateLog, pace: Pace | None = None
) -> Iterator[Moment]:
    """What the estimators see, moment by moment; `imu` gathers the yaw rates.

    A moment is there with the last of its measurements, not only once the next one's time has come.

    Raises:
        InputError: a measurement, and no detector for it.
    """
    noise = recording.odometry_noise
    wheels = OdometryAccumulator(noise) if noise is not None else None
    now = _Now()
    for measurement, next_ns in _with_next(recording.measurements):
        if pace is not None:
            pace.wait(measurement.stamp_ns)
        if isinstance(measurement, WheelOdometry) and wheels is not None:
            wheels.add(measurement)
            now.odom_T_base = measurement.odom_T_base
        elif isinstance(measurement, ImuSample):
            perceiver.lean(measurement)
            imu.add(measurement.stamp_ns, measurement.yaw_rate)
        elif isinstance(measurement, Perceptions):
            now.parts.append(measurement)
        elif isinstance(measurement, Raw):
            perceived = perceiver.perceive(measurement)
            now.parts.append(perceived.perceptions)
            now.measurements.append(measurement)
            if perceived.view is not None:
                now.views.append(perceived.view)
        if now.parts and next_ns != now.parts[0].stamp_ns:
            yield now.take(wheels)


def _with_next(measurements: Iterable[Measurement]) -> Iterator[tuple[Measurement, int | None]]:
    """Each measurement with the stamp of the one after it; None after the last."""
    last: Measurement | None = None
    for measurement in measurements:
        if last is not None:
            yield last, measurement.stamp_ns
        last = measurement
    if last is not None:
        yield last, None


@dataclass(slots=True)
class _Now:
    """What the sensors showed at one time."""

    parts: list[Perceptions] = field(default_factory=list)
    views: list[View] = field(default_factory=list)
    measurements: list[Raw] = field(default_factory=list)
    odom_T_base: Pose2 | None = None

    def take(self, wheels: OdometryAccumulator | None) -> Moment:
        """All of it, and the motion up to now."""
        parts, views, measurements = self.parts, tuple(self.views), tuple(self.measurements)
        self.parts, self.views, self.measurements = [], [], []
        perceptions = parts[0] if len(parts) == 1 else each_once(parts[0].stamp_ns, parts)
        odometry = wheels.take() if wheels is not None else None
        return Moment(perceptions, odometry, views, measurements, self.odom_T_base)
