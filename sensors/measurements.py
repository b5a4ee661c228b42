"""What a sensor says, stamped. No logic lives here."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from semgraph.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
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

    @property
    def base_T_sensor(self) -> Pose2:
        """Where what is perceived in it is seen from."""
        return self.geometry.base_T_laser


@dataclass(frozen=True, slots=True)
class Tilt:
    """How far base leans: roll and pitch in rad, right side down and nose down positive (REP-103).

    `level_R_base` turns what is measured in base into a frame of the same heading that is level.
    """

    roll: float = 0.0
    pitch: float = 0.0

    def level_R_base(self) -> FloatArray:
        """(3, 3)."""
        return _rotation(self.roll, self.pitch, 0.0)


@dataclass(frozen=True, slots=True)
class Mounting:
    """base_T_sensor of what sees in three dimensions: x ahead, y left, z up from the ground.

    Angles in rad: yaw, then pitch (looking down positive), then roll.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    height_m: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0

    def base_R_sensor(self) -> FloatArray:
        """(3, 3)."""
        return _rotation(self.roll, self.pitch, self.yaw)

    def base_T_sensor(self) -> Pose2:
        """The sensor's position and heading in the plane."""
        return Pose2(self.x_m, self.y_m, self.yaw)


def _rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    """(3, 3) Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


@dataclass(frozen=True, slots=True)
class CameraGeometry:
    """A pinhole camera without distortion: size and focal length in pixels, and where it sits.

    The optical axis is the sensor's x axis; columns count to its right, rows downwards.
    """

    width: int
    height: int
    focal_px: float
    centre_px: tuple[float, float]
    mounting: Mounting = field(default_factory=Mounting)

    def __post_init__(self) -> None:
        if not (0 < self.width <= 2**14 and 0 < self.height <= 2**14 and self.focal_px > 0.0):
            raise InputError(
                "camera: expected 1 to 16384 pixels a side and a positive focal length, got "
                f"{self.width} x {self.height} and {self.focal_px}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class DepthImage:
    """`depths_m` (height, width) along the optical axis, NaN where there is none.

    `tilt` is base's at that moment, as an IMU measured it.
    """

    stamp_ns: int
    camera: CameraGeometry
    depths_m: FloatArray
    tilt: Tilt = field(default_factory=Tilt)

    def __post_init__(self) -> None:
        shape = (self.camera.height, self.camera.width)
        depths_m = frozen_floats("depth image", self.depths_m, shape, finite=False)
        object.__setattr__(self, "depths_m", depths_m)

    @property
    def base_T_sensor(self) -> Pose2:
        """Where what is perceived in it is seen from."""
        return self.camera.mounting.base_T_sensor()


@dataclass(frozen=True, slots=True, eq=False)
class CameraImage:
    """`grey` (height, width) of uint8; `tilt` is base's at that moment."""

    stamp_ns: int
    camera: CameraGeometry
    grey: NDArray[np.uint8]
    tilt: Tilt = field(default_factory=Tilt)

    def __post_init__(self) -> None:
        shape = (self.camera.height, self.camera.width)
        if self.grey.dtype != np.uint8 or self.grey.shape != shape:
            raise InputError(
                f"camera image: expected uint8 of {shape}, got {self.grey.dtype} {self.grey.shape}"
            )
        grey = self.grey.copy()
        grey.setflags(write=False)
        object.__setattr__(self, "grey", grey)

    @property
    def base_T_sensor(self) -> Pose2:
        """Where what is perceived in it is seen from."""
        return self.camera.mounting.base_T_sensor()


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """`sensor_t_points` (n, 3) m, `rings` (n,) the row of the laser, -1 where it is not known."""

    stamp_ns: int
    mounting: Mounting
    sensor_t_points: FloatArray
    rings: IntArray
    tilt: Tilt = field(default_factory=Tilt)

    def __post_init__(self) -> None:
        points = frozen_floats("cloud", self.sensor_t_points, (None, 3))
        object.__setattr__(self, "sensor_t_points", points)
        object.__setattr__(self, "rings", frozen_ints("rings", self.rings, (len(points),)))

    @property
    def base_T_sensor(self) -> Pose2:
        """Where what is perceived in it is seen from."""
        return self.mounting.base_T_sensor()


@dataclass(frozen=True, slots=True)
class WheelOdometry:
    """The pose integrated from the wheels, in the drifting frame odom."""

    stamp_ns: int
    odom_T_base: Pose2


@dataclass(frozen=True, slots=True)
class ImuSample:
    """Yaw rate in rad/s, counter-clockwise positive; base's tilt, where the device tells it."""

    stamp_ns: int
    yaw_rate: float
    tilt: Tilt | None = None


@dataclass(frozen=True, slots=True)
class GnssFix:
    """A position in the local metric frame of the recording, with its standard deviation."""

    stamp_ns: int
    x_m: float
    y_m: float
    sigma_m: float


Raw = LaserScan | DepthImage | CameraImage | PointCloud
"""What a detector looks at."""
Measurement = Raw | Perceptions | WheelOdometry | ImuSample | GnssFix


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
        detectors: by name, those that look at what its devices measure, with what these devices
            need set in them; none where perceptions come ready.
        filters: what is to be done to scans before, as tables of settings.
        map_T_start: the known pose at the start; it defines the frame map.
        num_hypotheses: of associations to be followed at once; more than one where most scans show
            one or two of several things that nothing tells apart, so that one cannot do.
    """

    name: str
    measurements: Iterable[Measurement]
    num_scans: int
    odometry_noise: OdometryNoise | None = None
    detectors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    filters: Sequence[Mapping[str, object]] = ()
    map_T_start: Pose2 = field(default_factory=Pose2)
    num_hypotheses: int = 1
