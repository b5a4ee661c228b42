"""A short course with wheels on which each tree is known by its identity."""

from dataclasses import replace

import numpy as np

from semgraph.landmarks import Perceptions
from sensors.catalog import open_source
from sensors.measurements import Measurement
from sensors.truth import Source


def known_course(seed: int = 1) -> Source:
    """No clutter, so that each perception is a tree."""
    source = open_source(
        "course:perceptions",
        {"seed": seed, "track_radius_m": 8.0, "num_trees": 30, "lap_s": 12.0, "odometry": True},
    )
    rows_of = source.truth.associations
    assert rows_of is not None
    measurements: list[Measurement] = []
    for each in source.recording.measurements:
        if isinstance(each, Perceptions):
            names = [f"tree {row}" for row in rows_of[each.stamp_ns].tolist()]
            measurements.append(replace(each, identities=np.array(names, dtype=np.str_)))
        else:
            measurements.append(each)
    return Source(replace(source.recording, measurements=tuple(measurements)), source.truth)
