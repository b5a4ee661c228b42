"""Trees in the clouds of a spinning laser: trunks cut by ring after ring, and an axis through each.

Each ring cuts an upright trunk in a circle, seen from above. The detector in the plane finds these
sections in all rings at once; those above one another are one trunk.
"""

from typing import Final, final

import numpy as np

from detectors.detector import DetectorType
from detectors.ring_scans import RingScans, unroll_rings
from detectors.tree_3d_settings import Tree3dSettings
from detectors.trunk_axes import Axes, Sections, fit_axes
from detectors.trunk_candidates import trunk_candidates
from detectors.trunk_fit import fit_circles
from detectors.trunk_reliability import trunk_reliabilities
from semgraph.arrays import FloatArray
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import Mounting, PointCloud, Tilt


@final
class Tree3dDetector:
    """The 2D detector on each ring, sections linked, a robust axis, the median diameter."""

    def __init__(self, settings: Tree3dSettings) -> None:
        self._settings: Final = settings

    def detect(self, cloud: PointCloud) -> Perceptions:
        """Trees relative to the sensor's place and heading in the plane, levelled.

        Centre at `reference_height_m` over base, diameter, covariance, reliability.
        """
        settings = self._settings
        rings = unroll_rings(
            cloud, settings.azimuth_increment, settings.elevation_step, settings.range_max_m
        )
        sections = None if rings is None else self._sections(rings, cloud)
        axes = None if sections is None else fit_axes(sections, settings)
        if axes is None:
            nothing = np.zeros(0)
            return Perceptions.from_arrays(
                cloud.stamp_ns, Kind.TREE, nothing, nothing, np.zeros((0, 2, 2))
            )
        return self._perceptions(cloud, axes)

    def _sections(self, rings: RingScans, cloud: PointCloud) -> Sections | None:
        """All sections of all rings, or None."""
        settings = self._settings
        increment = rings.scan.geometry.angle_increment
        segments, free, diameters_m = trunk_candidates(rings.scan, settings)
        columns = segments.beams[segments.starts] % rings.stride
        # What begins at the seam is seen whole in the overlap; what begins there was seen before.
        once = (columns >= 1) & (columns <= rings.num_columns)
        if not once.any():
            return None
        segments, free, diameters_m = segments.select(once), free[:, once], diameters_m[once]
        circles = fit_circles(segments, free, diameters_m, increment, settings)
        reliabilities = trunk_reliabilities(segments, free, circles, increment)
        good = (circles.misfits < settings.max_misfit) & (reliabilities >= settings.min_reliability)
        if not good.any():
            return None
        of_ring = (segments.beams[segments.starts] // rings.stride)[good]
        azimuths = rings.azimuths(of_ring, circles.bearings[good])
        distances_m, radii_m = circles.distances_m[good], circles.radii_m[good]
        c, s = np.cos(azimuths), np.sin(azimuths)
        fronts_m = rings.slopes[of_ring] * (distances_m - radii_m)
        level_R_sensor, level_t_sensor = _placed(cloud.tilt, cloud.mounting)
        centres = np.column_stack([distances_m * c, distances_m * s, fronts_m])
        jacobians = np.stack(
            [np.stack([c, -distances_m * s], axis=-1), np.stack([s, distances_m * c], axis=-1)],
            axis=-2,
        )
        turned = level_R_sensor[:2, :2] @ jacobians
        covariances = circles.covariances[good]
        return Sections(
            centres @ level_R_sensor.T + level_t_sensor,
            turned @ covariances[:, :2, :2] @ turned.transpose(0, 2, 1),
            2.0 * radii_m,
            2.0 * np.sqrt(covariances[:, 2, 2]),
            reliabilities[good],
            of_ring,
        )

    def _perceptions(self, cloud: PointCloud, axes: Axes) -> Perceptions:
        """The trunks within the limits, as range and bearing."""
        settings = self._settings
        base_T_sensor = cloud.base_T_sensor
        x, y = base_T_sensor.inverse().transform(axes.base_t_centres).T
        ranges_m = np.hypot(x, y)
        kept = (
            (axes.diameters_m > settings.diameter_min_m)
            & (axes.diameters_m < settings.diameter_max_m)
            & (ranges_m > settings.range_min_m)
            & (axes.reliabilities >= settings.min_reliability)
        )
        bearings = np.arctan2(y, x)[kept]
        ranges_m = ranges_m[kept]
        # Rows: along the line of sight, and across it by range.
        angles = bearings + base_T_sensor.theta
        c, s = np.cos(angles), np.sin(angles)
        to_polar = np.stack(
            [np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1) / ranges_m[:, None]], axis=-2
        )
        covariances = to_polar @ axes.covariances[kept] @ to_polar.transpose(0, 2, 1)
        return Perceptions.from_arrays(
            cloud.stamp_ns,
            Kind.TREE,
            ranges_m,
            bearings,
            covariances,
            diameters_m=axes.diameters_m[kept],
            diameter_sigmas_m=axes.diameter_sigmas_m[kept],
            reliabilities=axes.reliabilities[kept],
            common_shares=np.full(kept.sum(), settings.common_share),
        )


def _placed(tilt: Tilt, mounting: Mounting) -> tuple[FloatArray, FloatArray]:
    """level_R_sensor (3, 3) and level_t_sensor (3,): base leans about its origin on the ground."""
    level_R_base = tilt.level_R_base()
    base_t_sensor = np.array([mounting.x_m, mounting.y_m, mounting.height_m])
    return level_R_base @ mounting.base_R_sensor(), level_R_base @ base_t_sensor


TREES_3D = DetectorType(Tree3dSettings, Tree3dDetector, looks_at=PointCloud)
