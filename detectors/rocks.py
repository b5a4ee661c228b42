"""Rocks in depth images and dense clouds: what stands out of the local ground."""

from typing import Final, final

import numpy as np

from detectors.detector import DetectorType
from detectors.levelled_raster import raster_of_cloud, raster_of_image
from detectors.rock_calibration import reliabilities, rocks_of, scores
from detectors.rock_pixels import standing_pixels
from detectors.rock_segments import rock_segments
from detectors.rock_settings import RockSettings
from semgraph.arrays import FloatArray, IntArray
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import DepthImage, PointCloud

_MAX_CUT: Final = 1.2


@final
class RockDetector:
    """Local ground, what stands out of it, and of parts within parts those most like a rock."""

    def __init__(self, settings: RockSettings) -> None:
        self._settings: Final = settings

    def detect(self, measurement: DepthImage | PointCloud) -> Perceptions:
        """Rocks relative to the sensor's point and heading in the plane."""
        settings = self._settings
        raster = (
            raster_of_image(measurement, settings.stride_px)
            if isinstance(measurement, DepthImage)
            else raster_of_cloud(measurement, settings.stride_px)
        )
        pixels = standing_pixels(raster, settings)
        segments = rock_segments(raster, pixels)
        rocks = rocks_of(segments)
        reliability = reliabilities(scores(segments))
        fit = (
            (rocks.diameters_m > settings.diameter_min_m)
            & (rocks.diameters_m < settings.diameter_max_m)
            & (rocks.ranges_m < settings.range_max_m)
            & (segments.cut < _MAX_CUT)
            & (reliability >= settings.min_reliability)
        )
        kept = _apart(np.flatnonzero(fit), reliability, pixels.parts)
        return Perceptions.from_arrays(
            measurement.stamp_ns,
            Kind.ROCK,
            rocks.ranges_m[kept],
            rocks.bearings[kept],
            rocks.covariances[kept],
            diameters_m=rocks.diameters_m[kept],
            diameter_sigmas_m=rocks.diameter_sigmas_m[kept],
            reliabilities=reliability[kept],
        )


def _apart(candidates: IntArray, scores: FloatArray, parts: IntArray) -> IntArray:
    """Those of the parts that share no pixel with one of a higher score, the best first."""
    levels = np.searchsorted(np.maximum.accumulate(parts.max(axis=1, initial=-1)), candidates)
    free = np.ones(len(scores), dtype=np.bool_)
    chosen = []
    for k in np.argsort(-scores[candidates], kind="stable"):
        part = candidates[k]
        if free[part]:
            chosen.append(part)
            related = parts[:, parts[levels[k]] == part]
            free[related[related >= 0]] = False
    return np.array(chosen, dtype=np.int64)


ROCKS = DetectorType(RockSettings, RockDetector, looks_at=DepthImage)
