"""Which beams of a scan count: range, field, and the codes of a device for nothing (REP-117)."""

from dataclasses import replace
from typing import Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from sensors.filters.resampling import beam_bearings
from sensors.measurements import LaserScan


class RangeSettings(BaseModel):
    """Returns nearer become "too near", those farther "no return"; m."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: Literal["range"] = "range"
    min_m: float = Field(0.1, ge=0.0)
    max_m: float = Field(50.0, gt=0.0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.min_m < self.max_m:
            raise ValueError("expected min_m below max_m")
        return self


class FieldSettings(BaseModel):
    """Beams outside of the field become invalid; bearings in the laser frame, rad.

    The field runs counter-clockwise from `bearing_min` to `bearing_max`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: Literal["field"] = "field"
    bearing_min: float = Field(-0.75 * np.pi, ge=-2.0 * np.pi, le=2.0 * np.pi)
    bearing_max: float = Field(0.75 * np.pi, ge=-2.0 * np.pi, le=2.0 * np.pi)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not 0.0 < self.bearing_max - self.bearing_min <= 2.0 * np.pi:
            raise ValueError("expected bearing_min below bearing_max, within one turn")
        return self


class InvalidSettings(BaseModel):
    """The numbers by which a device says that it measured nothing; m.

    Source: an LMS1xx reports 0.0 for no return and raw codes below 16 mm for what it could not
    measure; an LMS2xx reports 81.9 m (codes from 8183 on, in cm) for no return.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: Literal["invalid"] = "invalid"
    no_return_m: float = Field(0.0, ge=0.0, description="exactly this is no return")
    no_return_from_m: float = Field(81.0, gt=0.0, description="this and more is no return")
    invalid_below_m: float = Field(0.016, ge=0.0, description="what else is less is an error code")


def limit_range(scan: LaserScan, settings: RangeSettings) -> LaserScan:
    """The scan with -inf below the limits and +inf above; it reaches no farther than they do."""
    ranges_m = scan.ranges_m.copy()
    ranges_m[ranges_m < settings.min_m] = -np.inf
    ranges_m[ranges_m > settings.max_m] = np.inf
    reach_m = max(min(scan.geometry.range_max_m, settings.max_m), scan.geometry.range_min_m + 1e-3)
    return replace(scan, ranges_m=ranges_m, geometry=replace(scan.geometry, range_max_m=reach_m))


def limit_field(scan: LaserScan, settings: FieldSettings) -> LaserScan:
    """The scan with NaN outside of the field."""
    # A beam at the very edge belongs to the field, however its bearing was rounded.
    slack = 1e-9
    turned = np.mod(beam_bearings(scan) - settings.bearing_min + slack, 2.0 * np.pi)
    inside = turned <= settings.bearing_max - settings.bearing_min + 2.0 * slack
    return replace(scan, ranges_m=np.where(inside, scan.ranges_m, np.nan))


def read_codes(scan: LaserScan, settings: InvalidSettings) -> LaserScan:
    """The scan with REP-117's +inf and NaN in place of the device's own codes."""
    raw_m = scan.ranges_m
    ranges_m = raw_m.copy()
    ranges_m[np.isfinite(raw_m) & (raw_m < settings.invalid_below_m)] = np.nan
    ranges_m[(raw_m == settings.no_return_m) | (raw_m >= settings.no_return_from_m)] = np.inf
    return replace(scan, ranges_m=ranges_m)
