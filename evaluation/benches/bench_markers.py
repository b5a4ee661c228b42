"""The figures of optical markers, measured on simulated images of the seeds given."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from detectors.optical_markers import OpticalMarkerDetector, OpticalMarkerSettings
from evaluation.benches.bench_statistics import mean, rms
from evaluation.benches.bench_table import Better, Row
from semgraph.arrays import BoolArray, FloatArray
from semgraph.geometry import Pose2, wrap_angle
from sensors.measurements import CameraGeometry, Mounting, Tilt
from sensors.simulation.marker_camera import NUM_IDS, MarkerCamera, OpticalMarkers

EDGE_M = 0.165
CAMERA = CameraGeometry(
    640, 480, 457.0, (319.5, 239.5), Mounting(0.3, 0.1, 1.2, roll=0.02, pitch=0.05, yaw=0.1)
)
IMAGES_PER_SEED = 20
_MAX_TURN = np.radians(50.0)


@dataclass(frozen=True, slots=True, eq=False)
class MarkerOutcomes:
    """Of n markers, each alone in an image.

    Attributes:
        detected: (n,).
        range_shares, bearings: (n,) errors, of the range and in rad; NaN where not detected.
        nees: (n,) of range and bearing.
        num_false: perceptions of what is not there, in all images.
    """

    detected: BoolArray
    range_shares: FloatArray
    bearings: FloatArray
    nees: FloatArray
    num_false: int


def optical_markers(seeds: Sequence[int]) -> list[Row]:
    """AprilTags 36h11, 25 to 50 and 50 to 150 px wide, turned up to 50 deg.

    The width is that of one that faces the camera: focal length times edge by distance. Errors
    are RMS. Light, tilt, mounting, place in the image and background differ from image to image.
    """
    rows = []
    for name, widths_px, range_percent in (
        ("AprilTag >= 25 px", (25.0, 50.0), 1.5),
        ("AprilTag >= 50 px", (50.0, 150.0), 0.7),
    ):
        outcomes = marker_outcomes(seeds, widths_px)
        seen = outcomes.detected
        nees = mean(outcomes.nees[seen])
        rows += [
            Row(f"{name} detected", mean(seen), "", Better.HIGHER, 0.99),
            Row(
                f"{name} range RMSE",
                100.0 * rms(outcomes.range_shares[seen]),
                "%",
                Better.LOWER,
                range_percent,
            ),
            Row(
                f"{name} bearing RMSE",
                float(np.degrees(rms(outcomes.bearings[seen]))),
                "deg",
                Better.LOWER,
                0.03,
            ),
            Row(f"{name} false", float(outcomes.num_false), "", Better.LOWER, 0.0),
            Row(f"{name} NEES of 2", nees, "", Better.HIGHER, 1.0),
            Row(f"{name} NEES of 2", nees, "", Better.LOWER, 3.0),
        ]
    return rows


def marker_outcomes(
    seeds: Sequence[int],
    widths_px: tuple[float, float],
    images_per_seed: int = IMAGES_PER_SEED,
) -> MarkerOutcomes:
    """What the detector makes of markers so wide."""
    detector = OpticalMarkerDetector(OpticalMarkerSettings(edge_m=EDGE_M))
    device = MarkerCamera(CAMERA)
    errors, nees, num_false = [], [], 0
    for seed in seeds:
        rng = np.random.default_rng([seed, round(widths_px[0])])
        for _ in range(images_per_seed):
            world_T_base = Pose2.from_array(rng.uniform(-3.0, 3.0, 3))
            tilt = Tilt(*rng.uniform(-0.05, 0.05, 2))
            marker = _marker_in_sight(rng, world_T_base, tilt, widths_px)
            perceptions = detector.detect(device.image(marker, world_T_base, rng, tilt=tilt))
            right = perceptions.identities == str(marker.ids[0])
            num_false += int((~right).sum())
            if not right.any():
                errors.append((np.nan, np.nan))
                nees.append(np.nan)
                continue
            found = perceptions.select(right)
            x, y = _sensor_t_markers(marker, world_T_base)[0]
            error = np.array(
                [found.ranges_m[0] - np.hypot(x, y), found.bearings[0] - np.arctan2(y, x)]
            )
            error[1] = wrap_angle(float(error[1]))
            nees.append(float(error @ np.linalg.solve(found.covariances[0], error)))
            errors.append((error[0] / np.hypot(x, y), error[1]))
    columns = np.array(errors)
    return MarkerOutcomes(
        ~np.isnan(columns[:, 0]), columns[:, 0], columns[:, 1], np.array(nees), num_false
    )


def _sensor_t_markers(markers: OpticalMarkers, world_T_base: Pose2) -> FloatArray:
    world_T_sensor = world_T_base @ CAMERA.mounting.base_T_sensor()
    return world_T_sensor.inverse().transform(markers.world_t_markers[:, :2])


def _marker_in_sight(
    rng: np.random.Generator,
    world_T_base: Pose2,
    tilt: Tilt,
    widths_px: tuple[float, float],
) -> OpticalMarkers:
    """One marker whose white border lies inside the image, too."""
    world_T_sensor = world_T_base @ CAMERA.mounting.base_T_sensor()
    device = MarkerCamera(CAMERA)
    while True:
        distance_m = CAMERA.focal_px * EDGE_M / np.exp(rng.uniform(*np.log(widths_px)))
        bearing = rng.uniform(-0.6, 0.6)
        sensor_t_marker = distance_m * np.array([[np.cos(bearing), np.sin(bearing)]])
        height_m = CAMERA.mounting.height_m + distance_m * rng.uniform(-0.5, 0.5)
        marker = OpticalMarkers(
            rng.integers(NUM_IDS, size=1),
            np.column_stack([world_T_sensor.transform(sensor_t_marker), [height_m]]),
            np.array([world_T_sensor.theta + bearing + np.pi + rng.uniform(-_MAX_TURN, _MAX_TURN)]),
            EDGE_M,
        )
        corners_px, depths_m = device.project(marker.world_t_corners(1.3), world_T_base, tilt)
        inside = (corners_px >= 3.0) & (corners_px <= (CAMERA.width - 4.0, CAMERA.height - 4.0))
        if inside.all() and (depths_m > 0.0).all():
            return marker
