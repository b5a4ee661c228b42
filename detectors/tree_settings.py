"""What the tree detector can be told."""

import math
from typing import Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


class TreeSettings(BaseModel):
    """Device, trees and gates; lengths in m, angles in rad. The beam is that of an LMS151."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    range_min_m: float = Field(default=0.4, ge=0.0)
    range_max_m: float = Field(default=30.0, gt=0.0)
    range_sigma_m: float = Field(default=0.0135, gt=0.0, description="noise of one beam")
    beam_divergence: float = Field(default=0.015, ge=0.0, description="spot width per m of range")
    beam_exit_m: float = Field(default=0.008, ge=0.0, description="spot width at the device")
    edge_share: float = Field(
        default=0.05, ge=0.0, le=1.0, description="share of the spot that must be lit, near"
    )
    edge_share_per_m2: float = Field(
        default=7.5e-4, ge=0.0, description="that share far away, over the square of the range"
    )
    edge_share_max: float = Field(
        default=0.33, ge=0.0, le=1.0, description="its end: only what is bright is seen farther"
    )
    edge_sigma: float = Field(default=0.001, gt=0.0, description="of an edge, beside the spacing")
    break_angle: float = Field(default=math.radians(10.0), gt=0.0, lt=1.5)
    max_gap_m: float = Field(default=0.45, gt=0.0, description="a larger step parts two things")
    free_edge_step_m: float = Field(default=0.15, gt=0.0, description="what is beyond is farther")
    min_beams: int = Field(default=3, ge=1)
    isolated_step_m: float = Field(
        default=1.0, gt=0.0, description="a thing this far before all else needs one beam only"
    )
    diameter_min_m: float = Field(default=0.08, gt=0.0)
    diameter_max_m: float = Field(default=0.75, gt=0.0)
    radius_prior_m: tuple[float, float] = Field(default=(0.13, 0.15), description="mean and sigma")
    common_share: float = Field(
        default=0.2,
        ge=0.0,
        le=1.0,
        description="of the range's variance: what all sightings of a trunk have in common, since "
        "its radius is taken for too small or too large; simulated, 0.02 near and 0.19 at 20 m",
    )
    max_misfit: float = Field(default=3.0, gt=0.0, description="chi-square per residual")
    min_reliability: float = Field(default=0.2, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.diameter_min_m < self.diameter_max_m:
            raise ValueError("expected diameter_min_m below diameter_max_m")
        return self
