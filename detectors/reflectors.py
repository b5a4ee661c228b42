"""Reflecting markers in the intensity of a laser scan."""

import math
from typing import Final, final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from detectors.detector import DetectorType
from detectors.reflector_edges import Sweep, beam_bounds
from semgraph.arrays import FloatArray, IntArray
from semgraph.errors import InputError
from semgraph.geometry import wrap_angle
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.measurements import LaserScan


class ReflectorSettings(BaseModel):
    """Device and marker properties; lengths in m, angles in rad."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    intensity_min: float = Field(
        default=200.0, ge=0.0, description="a brighter beam hit a reflector"
    )
    range_min_m: float = Field(
        default=1.0,
        ge=0.0,
        description="nearer, bright reflections of the vehicle itself are expected",
    )
    range_max_m: float = Field(default=30.0, gt=0.0)
    marker_width_m: float = Field(default=0.1, gt=0.0, description="widest a single marker can be")
    centre_offset_m: float = Field(
        default=0.0,
        ge=0.0,
        description="seen face to centre: pi/4 of a wrapped pole's radius, 0 for flat tape",
    )
    max_range_step_m: float = Field(
        default=0.5, gt=0.0, description="a larger step parts two markers"
    )
    max_beam_step: int = Field(
        default=2,
        ge=1,
        description="a larger step between bright beams, wider than a marker, parts two",
    )
    beam_divergence: float = Field(default=0.015, ge=0.0, description="spot width per m of range")
    beam_exit_m: float = Field(default=0.008, ge=0.0, description="spot width at the device")
    range_sigma_m: float = Field(default=0.007, gt=0.0, description="noise from scan to scan")
    range_systematic_m: float = Field(
        default=0.015, ge=0.0, description="error that repeats in each scan"
    )
    post_width_m: float = Field(
        default=0.0,
        ge=0.0,
        description="of the markers, if all are alike: their edges tell the bearing; "
        "0: the mean of the beams by intensity does",
    )
    saturated_intensity: float = Field(
        default=254.0, gt=0.0, description="the device's largest; counts with `post_width_m`"
    )
    saturation_share: float = Field(
        default=0.08,
        gt=0.0,
        le=1.0,
        description="of the spot on a marker that saturates; counts with `post_width_m`",
    )
    edge_sigma: float = Field(
        default=0.0003, gt=0.0, description="how well the spot's edge is known, in rad"
    )
    reliability: float = Field(default=0.99, gt=0.0, le=1.0)
    single_hit_reliability: float = Field(default=0.97, gt=0.0, le=1.0)

    @property
    def common_share(self) -> float:
        """Of the range's variance, what repeats in each sighting of a marker."""
        return self.range_systematic_m**2 / (self.range_systematic_m**2 + self.range_sigma_m**2)


@final
class ReflectorDetector:
    """Groups bright beams into markers.

    Beacons of Nebot's car park are one or two beams wide (0.5 deg), so a bearing is known as well
    as the beam spacing allows: sigma = spacing / sqrt(12). Where the markers' width is known and
    the spot is wider than the spacing, the edges tell more (`reflector_edges.py`).
    """

    def __init__(self, settings: ReflectorSettings) -> None:
        self._settings: Final = settings

    def detect(self, scan: LaserScan) -> Perceptions:
        """Markers relative to the laser, of width `marker_width_m` at most.

        Raises:
            InputError: the scan has no intensities.
        """
        if scan.intensities is None:
            raise InputError(
                "reflectors: expected a scan with intensities, got one without; "
                "choose another detector or record the intensity"
            )
        bright = self._bright_beams(scan, scan.intensities)
        starts = self._group_starts(bright, scan)
        if not len(starts):
            return _markers(scan.stamp_ns, *np.zeros((5, 0)))
        return self._perceive(scan, scan.intensities, bright, starts)

    def _bright_beams(self, scan: LaserScan, intensities: FloatArray) -> IntArray:
        near = max(scan.geometry.range_min_m, self._settings.range_min_m)
        far = min(scan.geometry.range_max_m, self._settings.range_max_m)
        in_range = (scan.ranges_m >= near) & (scan.ranges_m <= far)
        return np.flatnonzero(in_range & (intensities > self._settings.intensity_min))

    def _group_starts(self, bright: IntArray, scan: LaserScan) -> IntArray:
        """Positions in `bright` where a new marker begins.

        From near, a real beacon is bright at both edges and dim between: beams no farther apart
        than a marker is wide are one marker's.
        """
        steps, ranges_m = np.diff(bright), scan.ranges_m[bright]
        steps_m = steps * abs(scan.geometry.angle_increment) * ranges_m[:-1]
        is_apart = (steps > self._settings.max_beam_step) & (
            steps_m > self._settings.marker_width_m
        )
        parted = is_apart | (np.abs(np.diff(ranges_m)) > self._settings.max_range_step_m)
        return np.flatnonzero(np.concatenate([np.ones(min(len(bright), 1), bool), parted]))

    def _perceive(
        self, scan: LaserScan, intensities: FloatArray, bright: IntArray, starts: IntArray
    ) -> Perceptions:
        settings = self._settings
        weights = intensities[bright] / intensities[bright].max()
        total = np.add.reduceat(weights, starts)
        beams: FloatArray = np.add.reduceat(weights * bright, starts) / total
        ranges_m = np.add.reduceat(weights * scan.ranges_m[bright], starts) / total
        num_hits = np.diff(np.append(starts, len(bright)))

        increment = abs(scan.geometry.angle_increment)
        last = bright[starts + num_hits - 1]
        widths_m = (last - bright[starts]) * increment * ranges_m
        spots_m = settings.beam_exit_m + settings.beam_divergence * ranges_m
        narrow = widths_m <= settings.marker_width_m + spots_m
        by_mean = beams, self._bearing_sigmas(ranges_m, increment)
        ends = bright[starts], last
        beams, bearing_sigmas = (
            self._by_edges(scan, intensities, ends, ranges_m, by_mean)
            if settings.post_width_m > 0.0
            else by_mean
        )
        bearings = wrap_angle(scan.geometry.angle_min + beams * scan.geometry.angle_increment)
        reliabilities = np.where(
            num_hits == 1, settings.single_hit_reliability, settings.reliability
        )
        return _markers(
            scan.stamp_ns,
            ranges_m[narrow] + settings.centre_offset_m,
            bearings[narrow],
            np.full(narrow.sum(), math.hypot(settings.range_sigma_m, settings.range_systematic_m)),
            bearing_sigmas[narrow],
            reliabilities[narrow],
            settings.common_share,
        )

    def _by_edges(
        self,
        scan: LaserScan,
        intensities: FloatArray,
        ends: tuple[IntArray, IntArray],
        ranges_m: FloatArray,
        by_mean: tuple[FloatArray, FloatArray],
    ) -> tuple[FloatArray, FloatArray]:
        """Beam numbers and bearing sigmas; those `by_mean` where the edges contradict each other.

        What the bounds leave open is uniform.
        """
        settings = self._settings
        increment = abs(scan.geometry.angle_increment)
        spots = settings.beam_divergence + settings.beam_exit_m / ranges_m
        half_m = 0.5 * settings.post_width_m
        reaches = (np.arcsin(half_m / (ranges_m + half_m)) + 0.5 * spots) / increment
        low, high = beam_bounds(
            Sweep(scan.ranges_m, intensities / settings.saturated_intensity),
            ends,
            ranges_m,
            reaches,
            settings.saturation_share * spots / increment,
        )
        agree = high - low >= -2.0 * settings.edge_sigma / increment
        left_open = increment * np.maximum(high - low, 0.0) / math.sqrt(12.0)
        return (
            np.where(agree, 0.5 * (low + high), by_mean[0]),
            np.where(agree, np.hypot(left_open, settings.edge_sigma), by_mean[1]),
        )

    def _bearing_sigmas(self, ranges_m: FloatArray, increment: float) -> FloatArray:
        """Beam spacing, and a hit that may lie anywhere on the marker's face: both uniform."""
        return np.asarray(
            np.hypot(increment, self._settings.marker_width_m / ranges_m) / math.sqrt(12.0)
        )


def _markers(
    stamp_ns: int,
    ranges_m: FloatArray,
    bearings: FloatArray,
    range_sigmas_m: FloatArray,
    bearing_sigmas: FloatArray,
    reliabilities: FloatArray,
    common_share: float = 0.0,
) -> Perceptions:
    return Perceptions.from_arrays(
        stamp_ns,
        Kind.MARKER,
        ranges_m,
        bearings,
        polar_covariances(range_sigmas_m, bearing_sigmas),
        reliabilities=reliabilities,
        common_shares=np.full(len(ranges_m), common_share),
    )


REFLECTORS = DetectorType(ReflectorSettings, ReflectorDetector)
