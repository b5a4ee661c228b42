"""What the tree detector for clouds can be told."""

import math

from pydantic import Field

from detectors.tree_settings import TreeSettings


class Tree3dSettings(TreeSettings):
    """Those of a section in the plane, and how sections become a trunk; m and rad."""

    range_max_m: float = Field(default=30.0, gt=0.0)
    range_sigma_m: float = Field(default=0.02, gt=0.0, description="noise of one beam")
    beam_divergence: float = Field(default=0.003, ge=0.0, description="spot width per m of range")
    beam_exit_m: float = Field(default=0.0, ge=0.0, description="spot width at the device")
    edge_share: float = Field(default=0.3, ge=0.0, le=1.0, description="of the spot to be lit")
    edge_share_per_m2: float = Field(default=0.0, ge=0.0)
    azimuth_increment: float = Field(
        default=0.0, ge=0.0, le=0.1, description="between columns; 0 to read it off the cloud"
    )
    elevation_step: float = Field(
        default=math.radians(0.5), gt=0.0, le=0.1, description="cuts a cloud without rings"
    )
    link_m: float = Field(default=0.25, gt=0.0, description="x, y, z/4 of two sections of a trunk")
    min_rows: int = Field(default=4, ge=2, description="sections of a trunk")
    min_height_m: float = Field(default=0.3, gt=0.0, description="lowest to highest section")
    reference_height_m: float = Field(
        default=1.3, ge=0.0, description="where a leaning trunk is said to stand: breast height"
    )
    lean_sigma: float = Field(default=0.05, gt=0.0, description="of trunks, m per m of height")
    row_correlation: float = Field(
        default=0.07, ge=0.0, le=1.0, description="how much of their errors sections share"
    )
