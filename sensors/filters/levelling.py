"""A scan of a leaning vehicle as a scan in the horizontal plane."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import FloatArray
from semgraph.geometry import wrap_angle
from sensors.filters.context import ScanContext
from sensors.filters.resampling import beam_bearings, has_point, resample
from sensors.measurements import LaserScan


class LevelSettings(BaseModel):
    """Where the laser sits over the ground, and how near to it a point is one of the ground; m."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: Literal["level"] = "level"
    height_m: float = Field(1.0, gt=0.0, description="of the laser over the ground")
    ground_margin_m: float = Field(
        0.15, ge=0.0, description="what is hit below this height is the ground, not a trunk"
    )
    max_step_m: float = Field(0.1, gt=0.0, description="a larger step parts two things")


def level(scan: LaserScan, settings: LevelSettings, context: ScanContext) -> LaserScan:
    """Horizontal ranges and bearings of what a tilted laser saw; as it is without a tilt.

    Points at the ground, taken as level under base, become NaN: what stands behind is not known.
    The mounting becomes that of the leaning laser over the ground.
    """
    if context.tilt is None:
        return scan
    geometry = scan.geometry
    level_R_base = context.tilt.level_R_base()
    bearings = beam_bearings(scan)
    directions = _directions(bearings + geometry.base_T_laser.theta) @ level_R_base.T
    mounted = (geometry.base_T_laser.x, geometry.base_T_laser.y, settings.height_m)
    seen = has_point(scan.ranges_m)
    ranges_m = np.where(seen, scan.ranges_m, 0.0)
    heights_m = level_R_base[2] @ mounted + ranges_m * directions[:, 2]
    ground = seen & (heights_m < settings.ground_margin_m)
    levelled_m = np.where(seen, ranges_m * np.hypot(*directions[:, :2].T), scan.ranges_m)
    level_bearings = np.arctan2(directions[:, 1], directions[:, 0]) - geometry.base_T_laser.theta
    shifts = wrap_angle(level_bearings - bearings)
    # Leaning moves the laser aside by its height: 5 cm for 1 m and 3 deg.
    x_m, y_m, _ = (level_R_base @ mounted).tolist()
    mount = replace(geometry.base_T_laser, x=x_m, y=y_m)
    upright = replace(scan, geometry=replace(geometry, base_T_laser=mount))
    return resample(upright, np.where(ground, np.nan, levelled_m), shifts, settings.max_step_m)


def _directions(bearings: FloatArray) -> FloatArray:
    """(m, 3) unit vectors in the plane."""
    return np.column_stack([np.cos(bearings), np.sin(bearings), np.zeros(len(bearings))])
