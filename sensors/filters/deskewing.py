"""A scan as it would be had all beams been measured at its stamp."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import FloatArray
from sensors.filters.context import ScanContext
from sensors.filters.resampling import beam_bearings, has_point, resample
from sensors.measurements import LaserScan


class DeskewSettings(BaseModel):
    """When each beam is measured, after the stamp; s."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: Literal["deskew"] = "deskew"
    sweep_s: float = Field(
        0.015,
        gt=0.0,
        le=1.0,
        description="first beam to last; LMS1xx: 0.015 at 0.5 deg, 0.030 at 0.25 deg",
    )
    stamp_position: float = Field(
        0.5, ge=0.0, le=1.0, description="where in the sweep the stamp is: 0 first beam, 1 last"
    )
    max_step_m: float = Field(0.1, gt=0.0, description="a larger step parts two things")


def deskew(scan: LaserScan, settings: DeskewSettings, context: ScanContext) -> LaserScan:
    """The scan as seen from where the laser was at the stamp; as it is without a twist.

    The turn of the laser during the sweep spreads or narrows all beams evenly: it goes, exactly,
    into the angles of the scan. What is left is the way driven: points are moved by it and measured
    again on those beams. Resampling for the turn as well would round both edges of each trunk to
    beams a second time.

    Source: constant twist, so the laser moves along an arc: SE(2) exponential of twist times time.
    """
    m = len(scan.ranges_m)
    if context.twist is None or m < 2:
        return scan
    vx, vy, omega = _laser_twist(scan, context.twist)
    seconds = settings.sweep_s * (np.arange(m) / (m - 1) - settings.stamp_position)
    turns = omega * seconds
    turned = replace(
        scan,
        geometry=replace(
            scan.geometry,
            angle_min=scan.geometry.angle_min + float(turns[0]),
            angle_increment=scan.geometry.angle_increment + float(turns[1] - turns[0]),
        ),
    )
    # The arc's chord: sin(a)/a and (1 - cos(a))/a of the turn a.
    ahead, aside = np.sinc(turns / np.pi), np.sinc(turns / (2.0 * np.pi)) * np.sin(0.5 * turns)
    x_m = seconds * (vx * ahead - vy * aside)
    y_m = seconds * (vx * aside + vy * ahead)
    seen = has_point(scan.ranges_m)
    ranges_m = np.where(seen, scan.ranges_m, 1.0)
    bearings = beam_bearings(turned)
    c, s = np.cos(bearings), np.sin(bearings)
    along_m = ranges_m + c * x_m + s * y_m
    across_m = c * y_m - s * x_m
    moved_m = np.where(seen, np.hypot(along_m, across_m), scan.ranges_m)
    shifts = np.where(seen, np.arctan2(across_m, along_m), 0.0)
    return resample(turned, moved_m, shifts, settings.max_step_m)


def _laser_twist(scan: LaserScan, base_twist: tuple[float, float, float]) -> FloatArray:
    """(3,) the laser's own twist: Ad(laser_T_base) times that of base."""
    laser_twist: FloatArray = scan.geometry.base_T_laser.inverse().adjoint() @ base_twist
    return laser_twist
