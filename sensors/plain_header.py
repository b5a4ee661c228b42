"""The header `recording.toml` of a plain recording folder."""

import math
import tomllib
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field, ValidationError

from semgraph.errors import InputError, known_names
from semgraph.geometry import Pose2
from sensors.files import read_text
from sensors.filters.chain import filter_settings
from sensors.measurements import CameraGeometry, Mounting, OdometryNoise, ScannerGeometry

HEADER_FILE = "recording.toml"
MAX_HEADER_BYTES = 2**20

Text = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f]{0,200}$")]
Name = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f]{1,200}$")]
PoseValues = tuple[float, float, float]


class Laser(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """`[laser]`: rad in the laser's frame, m; `base_T_laser` is x, y, yaw."""

    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    base_T_laser: PoseValues = (0.0, 0.0, 0.0)

    def geometry(self) -> ScannerGeometry:
        """The same as the scans carry it."""
        return ScannerGeometry(
            self.angle_min_rad,
            self.angle_increment_rad,
            self.range_min_m,
            self.range_max_m,
            Pose2(*self.base_T_laser),
        )


class MountingValues(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """`[camera.mounting]`: m and rad, as `Mounting`."""

    x_m: float = 0.0
    y_m: float = 0.0
    height_m: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0


class Camera(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """`[camera]`: of depth images and camera images alike, as `CameraGeometry`."""

    width: int
    height: int
    focal_px: float
    centre_px: tuple[float, float]
    mounting: MountingValues = MountingValues()

    def geometry(self) -> CameraGeometry:
        """The same as the images carry it."""
        mounting = Mounting(**self.mounting.model_dump())
        return CameraGeometry(self.width, self.height, self.focal_px, self.centre_px, mounting)


_NOISE = OdometryNoise()


class Vehicle(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """`[vehicle]`: the odometry's noise, as `OdometryNoise`."""

    along_per_sqrt_m: float = Field(default=_NOISE.along_per_sqrt_m, ge=0.0)
    across_per_sqrt_m: float = Field(default=_NOISE.across_per_sqrt_m, ge=0.0)
    heading_per_sqrt_m: float = Field(default=_NOISE.heading_per_sqrt_m, ge=0.0)
    heading_per_sqrt_rad: float = Field(default=_NOISE.heading_per_sqrt_rad, ge=0.0)


class Start(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """`[start]`: the known pose at the start, x, y, yaw."""

    map_T_start: PoseValues = (0.0, 0.0, 0.0)


class PerceptionDefaults(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """`[perceptions]`: sigmas of perceptions that bring none, by default those of a 2D laser."""

    range_sigma_m: float = Field(default=0.05, gt=0.0)
    bearing_sigma_rad: float = Field(default=math.radians(0.25), gt=0.0)


class TruthHeader(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """`[truth]`: which point of the vehicle `truth.tum` follows, whether it jumps, its sigma."""

    base_t_reference: tuple[float, float] = (0.0, 0.0)
    has_outliers: bool = False
    sigma_m: float = Field(default=0.0, ge=0.0)


class Header(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """All of `recording.toml`; only `name` must be there.

    `[laser]` where there are scans, `[camera]` where there are images. `[[filters]]` are those that
    the scans need, as in a settings file; `num_hypotheses` of associations are to be followed.
    """

    name: Name
    detectors: dict[Text, dict[str, float]] = {}
    filters: list[dict[Text, float | Text]] = []
    num_hypotheses: int = Field(default=1, ge=1, le=100_000)
    laser: Laser | None = None
    camera: Camera | None = None
    vehicle: Vehicle | None = None
    start: Start = Start()
    perceptions: PerceptionDefaults = PerceptionDefaults()
    truth: TruthHeader = TruthHeader()


_SECTIONS: dict[object, type[BaseModel]] = {
    "laser": Laser,
    "camera": Camera,
    "mounting": MountingValues,
    "vehicle": Vehicle,
    "start": Start,
    "perceptions": PerceptionDefaults,
    "truth": TruthHeader,
}


def laser_values(geometry: ScannerGeometry) -> dict[str, object]:
    """`[laser]` of a scan's geometry."""
    return Laser(
        angle_min_rad=geometry.angle_min,
        angle_increment_rad=geometry.angle_increment,
        range_min_m=geometry.range_min_m,
        range_max_m=geometry.range_max_m,
        base_T_laser=(
            geometry.base_T_laser.x,
            geometry.base_T_laser.y,
            geometry.base_T_laser.theta,
        ),
    ).model_dump()


def camera_values(camera: CameraGeometry) -> dict[str, object]:
    """`[camera]` of an image's geometry."""
    return Camera(
        width=camera.width,
        height=camera.height,
        focal_px=camera.focal_px,
        centre_px=camera.centre_px,
        mounting=MountingValues(**asdict(camera.mounting)),
    ).model_dump()


def read_header(folder: Path) -> Header:
    """The header of a plain recording folder.

    Raises:
        InputError: unreadable, no TOML, a key unknown or missing, or a value out of its domain.
    """
    file = folder / HEADER_FILE
    try:
        header = Header.model_validate(tomllib.loads(read_text(file, MAX_HEADER_BYTES)))
    except ValidationError as error:
        raise InputError(f"{file}: {_first_fault(error)}") from error
    except (ValueError, RecursionError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"{file}: expected TOML: {reason}") from error
    try:
        for device in (header.laser, header.camera):
            if device is not None:
                device.geometry()
        filter_settings(header.filters)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    return header


def _first_fault(error: ValidationError) -> str:
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        *section, name = first["loc"]
        model = _SECTIONS[section[-1]] if section else Header
        return f"unknown key {place!r}, {known_names(str(name), model.model_fields)}"
    return f"{place}: {first['msg']}, got {str(first['input'])[:60]!r}"
