"""Filters that hold each beam against its neighbours in the scan."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from semgraph.arrays import FloatArray
from sensors.measurements import LaserScan


class MedianSettings(BaseModel):
    """How many beams a median is of, and which of them lie on the same surface; m."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: Literal["median"] = "median"
    num_beams: int = Field(3, ge=1, le=101, description="odd")
    max_step_m: float = Field(0.1, gt=0.0, description="a larger step parts two things")

    @field_validator("num_beams")
    @classmethod
    def _odd(cls, num_beams: int) -> int:
        if num_beams % 2 == 0:
            raise ValueError("expected an odd number of beams")
        return num_beams


class ShadowSettings(BaseModel):
    """How steeply to the line of sight two neighbouring points may lie; rad."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: Literal["shadow"] = "shadow"
    min_angle: float = Field(float(np.radians(10.0)), gt=0.0, lt=1.5)


def smooth(scan: LaserScan, settings: MedianSettings) -> LaserScan:
    """The scan with each range the median of those around it on the same surface.

    Edges stay where they are, a thing one beam wide keeps its range, and beams without a return
    have none afterwards.
    """
    half = settings.num_beams // 2
    seen = np.isfinite(scan.ranges_m)
    if not seen.any():
        return scan
    padded_m = np.pad(np.where(seen, scan.ranges_m, np.nan), half, constant_values=np.nan)
    windows_m = np.lib.stride_tricks.sliding_window_view(padded_m, settings.num_beams)[seen]
    here_m = scan.ranges_m[seen]
    same = np.abs(windows_m - here_m[:, None]) <= settings.max_step_m
    ranges_m = scan.ranges_m.copy()
    ranges_m[seen] = np.nanmedian(np.where(same, windows_m, np.nan), axis=1)
    return replace(scan, ranges_m=ranges_m)


def remove_shadows(scan: LaserScan, settings: ShadowSettings) -> LaserScan:
    """The scan with NaN where a point floats between a nearer and a farther surface.

    A beam that hits an edge returns a mixture of both. Such a point lies nearly along the line of
    sight to both of its neighbours, one nearer and one farther; an edge of a real thing does so to
    one of them only, and stays.
    """
    increment = abs(scan.geometry.angle_increment)
    ranges_m = np.where(np.isfinite(scan.ranges_m), scan.ranges_m, np.nan)
    rises = _steep_rises(ranges_m, increment, settings.min_angle)
    floating = np.zeros(len(ranges_m), dtype=bool)
    floating[1:-1] = rises[:-1] * rises[1:] > 0.0
    return replace(scan, ranges_m=np.where(floating, np.nan, scan.ranges_m))


def _steep_rises(ranges_m: FloatArray, increment: float, min_angle: float) -> FloatArray:
    """(m - 1,) sign of each step that is steeper to the line of sight than allowed, else 0."""
    nearer_m = np.minimum(ranges_m[1:], ranges_m[:-1])
    farther_m = np.maximum(ranges_m[1:], ranges_m[:-1])
    across_m = nearer_m * np.sin(increment)
    along_m = farther_m - nearer_m * np.cos(increment)
    steep = np.arctan2(across_m, along_m) < min_angle
    rises: FloatArray = np.where(steep, np.sign(np.diff(ranges_m)), 0.0)
    return rises
