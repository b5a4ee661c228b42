"""A scan as it would be had all beams been measured at its stamp."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import wrap_angle
from semgraph.landmarks import Perceptions
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
    """
    m = len(scan.ranges_m)
    if context.twist is None or m < 2:
        return scan
    x_m, y_m, turns = _moved(scan, np.arange(m), settings, context.twist)
    turned = replace(
        scan,
        geometry=replace(
            scan.geometry,
            angle_min=scan.geometry.angle_min + float(turns[0]),
            angle_increment=scan.geometry.angle_increment + float(turns[1] - turns[0]),
        ),
    )
    seen = has_point(scan.ranges_m)
    ranges_m, shifts = _seen_from_stamp(
        np.where(seen, scan.ranges_m, 1.0), beam_bearings(turned), x_m, y_m
    )
    moved_m = np.where(seen, ranges_m, scan.ranges_m)
    return resample(turned, moved_m, np.where(seen, shifts, 0.0), settings.max_step_m)


def deskew_perceptions(
    perceptions: Perceptions, scan: LaserScan, settings: DeskewSettings, context: ScanContext
) -> Perceptions:
    """What was found in a scan as it comes, moved to where it was at the stamp.

    Exact where `deskew` must round: a trunk is passed within a millisecond and moves as a whole,
    while the way aside of a beam is mostly less than half a beam's width and leaves no trace in a
    scan. Use one or the other.

    Args:
        perceptions: relative to the laser.
        scan: in which they were found, not deskewed.
        settings: when each beam is measured.
        context: without a twist nothing changes.
    """
    m = len(scan.ranges_m)
    if context.twist is None or m < 2:
        return perceptions
    geometry = scan.geometry
    middle = geometry.angle_min + 0.5 * (m - 1) * geometry.angle_increment
    from_middle = wrap_angle(perceptions.bearings - middle) / geometry.angle_increment
    beams = 0.5 * (m - 1) + from_middle
    x_m, y_m, turns = _moved(scan, beams, settings, context.twist)
    bearings = perceptions.bearings + turns
    ranges_m, shifts = _seen_from_stamp(perceptions.ranges_m, bearings, x_m, y_m)
    return replace(perceptions, ranges_m=ranges_m, bearings=wrap_angle(bearings + shifts))


def _moved(
    scan: LaserScan,
    beams: FloatArray | IntArray,
    settings: DeskewSettings,
    base_twist: tuple[float, float, float],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """stamp_T_laser of the laser at each beam: x and y in m, turn in rad.

    Source: constant twist, so the laser moves along an arc: SE(2) exponential of twist times time.
    """
    # Ad(laser_T_base) takes the twist of base to that of the laser.
    vx, vy, omega = scan.geometry.base_T_laser.inverse().adjoint() @ base_twist
    seconds = settings.sweep_s * (beams / (len(scan.ranges_m) - 1) - settings.stamp_position)
    turns = omega * seconds
    # The arc's chord: sin(a)/a and (1 - cos(a))/a of the turn a.
    ahead, aside = np.sinc(turns / np.pi), np.sinc(turns / (2.0 * np.pi)) * np.sin(0.5 * turns)
    x_m = seconds * (vx * ahead - vy * aside)
    y_m = seconds * (vx * aside + vy * ahead)
    return x_m, y_m, turns


def _seen_from_stamp(
    ranges_m: FloatArray, bearings: FloatArray, x_m: FloatArray, y_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Ranges and shifts in bearing of points that were seen from (x, y)."""
    c, s = np.cos(bearings), np.sin(bearings)
    along_m = ranges_m + c * x_m + s * y_m
    across_m = c * y_m - s * x_m
    return np.hypot(along_m, across_m), np.arctan2(across_m, along_m)
