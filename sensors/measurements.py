"""What a sensor says, stamped. No logic lives here."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from semgraph.arrays import FloatArray, frozen_floats
from semgraph.errors import InputError
from semgraph.geometry import Pose2
from semgraph.landmarks import Perceptions


@dataclass(frozen=True, slots=True)
class ScannerGeometry:
    """Where a laser scanner's beams point, and where it is mounted.

    Angles in rad in the laser frame, 0 ahead, counter-clockwise.
    """

    angle_min: float
    angle_increment: float
    range_min_m: float
    range_max_m: float
    base_T_laser: Pose2 = field(default_factory=Pose2)

    def __post_init__(self) -> None:
        if not (0.0 <= self.range_min_m < self.range_max_m < float("inf")):
            raise InputError(
                "scanner: expected 0 <= range_min_m < range_max_m, "
                f"got {self.range_min_m} and {self.range_max_m}"
            )
        if not 0.0 < abs(self.angle_increment) < 1.0:
            raise InputError(
                f"scanner: expected an angle increment within 1 rad, got {self.angle_increment}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """One sweep: `ranges_m` (m,), +inf no return, -inf too near, NaN invalid (REP-117).

    `intensities` (m,) in the device's own units, or None.
    """

    stamp_ns: int
    geometry: ScannerGeometry
    ranges_m: FloatArray
    intensities: FloatArray | None = None

    def __post_init__(self) -> None:
        ranges_m = frozen_floats("scan ranges", self.ranges_m, (None,), finite=False)
        object.__setattr__(self, "ranges_m", ranges_m)
        if self.intensities is not None:
            intensities = frozen_floats("scan intensities", self.intensities, ranges_m.shape)
            object.__setattr__(self, "intensities", intensities)


@dataclass(frozen=True, slots=True)
class WheelOdometry:
    """The pose integrated from the wheels, in the drifting frame odom."""

    stamp_ns: int
    odom_T_base: Pose2


@dataclass(frozen=True, slots=True)
class ImuSample:
    """Yaw rate in rad/s, counter-clockwise positive."""

    stamp_ns: int
    yaw_rate: float


@dataclass(frozen=True, slots=True)
class GnssFix:
    """A position in the local metric frame of the recording, with its standard deviation."""

    stamp_ns: int
    x_m: float
    y_m: float
    sigma_m: float


Measurement = LaserScan | Perceptions | WheelOdometry | ImuSample | GnssFix


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """How fast wheel odometry errs; a property of the vehicle.

    Standard deviations grow with the square root of the distance and of the angle turned.
    """

    along_per_sqrt_m: float = 0.05
    across_per_sqrt_m: float = 0.02
    heading_per_sqrt_m: float = 0.01
    heading_per_sqrt_rad: float = 0.05

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not 0.0 <= value < float("inf"):
                raise InputError(f"odometry noise: expected {name} >= 0, got {value}")


@dataclass(frozen=True, slots=True)
class Recording:
    """A run as an estimator may see it.

    Attributes:
        name: what it is called in results.
        measurements: in the order of time; can be iterated again. Odometry at a scan's own time
            comes before the scan.
        num_scans: how many of them are scans or perceptions.
        odometry_noise: the vehicle's, or None where there is no odometry.
        detector: the name of the detector that the scans need, or "" where perceptions come ready.
        detector_settings: what this device needs set in it.
        map_T_start: the known pose at the start; it defines the frame map.
    """

    name: str
    measurements: Iterable[Measurement]
    num_scans: int
    odometry_noise: OdometryNoise | None = None
    detector: str = ""
    detector_settings: dict[str, float] = field(default_factory=dict)
    map_T_start: Pose2 = field(default_factory=Pose2)
