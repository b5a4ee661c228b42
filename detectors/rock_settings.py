"""What the rock detector can be told."""

from typing import Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from semgraph.arrays import FloatArray


class RockSettings(BaseModel):
    """Device, rocks and gates; lengths in m. The device is a stereo camera of 0.24 m.

    A depth z errs by sigma = depth_sigma_m + depth_sigma_per_m z + disparity_sigma_px z^2 / (f b);
    time of flight has no disparity.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    range_min_m: float = Field(default=0.6, gt=0.0)
    range_max_m: float = Field(default=12.0, gt=0.0, le=60.0, description="in the plane")
    baseline_m: float = Field(default=0.24, gt=0.0)
    disparity_sigma_px: float = Field(default=0.2, ge=0.0)
    depth_sigma_m: float = Field(default=0.0, ge=0.0)
    depth_sigma_per_m: float = Field(default=0.0, ge=0.0)
    stride_px: int = Field(default=2, ge=1, le=8, description="every so many pixels are looked at")
    least_height_m: float = Field(default=0.04, gt=0.0, description="above smooth ground")
    roughness_factor: float = Field(
        default=2.0, ge=0.0, description="least height in standard deviations of the ground"
    )
    max_gap_m: float = Field(default=0.15, gt=0.0, description="a larger step parts two rocks")
    min_pixels: int = Field(default=6, ge=2, description="of those looked at")
    diameter_min_m: float = Field(default=0.12, gt=0.0)
    diameter_max_m: float = Field(default=2.5, gt=0.0)
    min_reliability: float = Field(default=0.2, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.diameter_min_m < self.diameter_max_m:
            raise ValueError("expected diameter_min_m below diameter_max_m")
        if not self.range_min_m < self.range_max_m:
            raise ValueError("expected range_min_m below range_max_m")
        return self

    def depth_sigmas_m(self, depths_m: FloatArray, focal_px: float) -> FloatArray:
        """Standard deviations of depths, of the same shape."""
        disparity = self.disparity_sigma_px / (focal_px * self.baseline_m)
        return self.depth_sigma_m + depths_m * (self.depth_sigma_per_m + depths_m * disparity)
