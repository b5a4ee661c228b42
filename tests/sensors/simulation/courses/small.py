"""Every course from raw measurements, small enough for tests."""

import importlib
from functools import cache

import pytest

from sensors.catalog import open_source
from sensors.truth import Source

SMALL: dict[str, dict[str, object]] = {
    "course:paper": {"lap_s": 8.0, "overlap_s": 1.0, "track_radius_m": 8.0, "scan_every": 10},
    "course:forest": {
        "track_radius_m": 5.0,
        "speed": 3.0,
        "overlap_s": 0.5,
        "stems_per_ha": 400,
        "odometry": True,
    },
    "course:rocks": {"track_radius_m": 4.0, "speed": 1.5, "overlap_s": 0.5, "image_rate_hz": 1.5},
    "course:car-park": {"track_radius_m": 8.0, "speed": 8.0, "overlap_s": 1.0},
    "course:markers": {
        "track_radius_m": 4.0,
        "num_markers": 20,
        "speed": 2.0,
        "overlap_s": 1.0,
        "image_rate_hz": 2.5,
    },
}


def opened_small(name: str, **options: object) -> Source:
    """A small course with other options on top; skips where its library does not load."""
    if name == "course:rocks":
        try:
            importlib.import_module("open3d")
        except (ImportError, OSError) as error:
            pytest.skip(f"Open3D does not load: {error}")
    return open_source(name, SMALL[name] | options)


@cache
def small(name: str) -> Source:
    """A small course with seed 1, read once for all tests."""
    return opened_small(name, seed=1)
