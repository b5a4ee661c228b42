"""The rings of a 3D laser, one after the other as one long scan of horizontal ranges."""

import math
from dataclasses import dataclass

import numpy as np

from semgraph.arrays import FloatArray, IntArray
from sensors.measurements import LaserScan, PointCloud, ScannerGeometry

_OVERLAP = 0.9
_GAP = 2
_INCREMENTS = (5e-4, 0.1)


@dataclass(frozen=True, slots=True, eq=False)
class RingScans:
    """The rings (k of them) of a cloud, unrolled.

    Attributes:
        scan: all rings, each followed by its beginning once more, so that what stands at the seam
            is seen whole, and by a gap.
        num_columns: beams of a turn.
        stride: beams from one ring to the next in `scan`.
        phases: (k,) rad, azimuth of each ring's first beam.
        slopes: (k,) height over horizontal range.
    """

    scan: LaserScan
    num_columns: int
    stride: int
    phases: FloatArray
    slopes: FloatArray

    def azimuths(self, rings: IntArray, bearings: FloatArray) -> FloatArray:
        """Azimuths (n,) rad of bearings in `scan`."""
        turned = bearings - rings * (self.stride * self.scan.geometry.angle_increment)
        return np.asarray(self.phases[rings] + turned)


def unroll_rings(
    cloud: PointCloud, increment: float, elevation_step: float, range_max_m: float
) -> RingScans | None:
    """The rings of a cloud; None where it has too few points to tell its columns.

    A cloud does not tell where nothing returned: points are put on an even grid of azimuths, and
    what is left empty had no return. Of two points in one cell the nearer counts.

    Args:
        cloud: in the sensor's frame.
        increment: rad between columns; 0 to estimate it.
        elevation_step: rad, to cut into rings what comes without.
        range_max_m: farther points are no return.
    """
    ranges_m = np.hypot(cloud.sensor_t_points[:, 0], cloud.sensor_t_points[:, 1])
    kept = (ranges_m > 1e-3) & (ranges_m < range_max_m)
    x, y, z = cloud.sensor_t_points[kept].T
    ranges_m, azimuths = ranges_m[kept], np.arctan2(y, x)
    names = np.where(
        cloud.rings[kept] >= 0,
        cloud.rings[kept],
        -1 - np.round((np.arctan2(z, ranges_m) + math.pi) / elevation_step).astype(np.int64),
    )
    _, rings = np.unique(names, return_inverse=True)
    increment = increment or _column_spacing(rings, azimuths)
    if not increment > 0.0:
        return None
    num_columns = round(2.0 * math.pi / increment)
    increment = 2.0 * math.pi / num_columns
    slopes = _means(rings, z / ranges_m)
    turns = np.exp(1j * num_columns * azimuths)
    phases = np.arctan2(_means(rings, turns.imag), _means(rings, turns.real)) / num_columns
    columns = np.round((azimuths - phases[rings]) / increment).astype(np.int64)

    overlap = math.ceil(_OVERLAP / increment)
    stride = num_columns + overlap + _GAP
    grid_m = np.full((len(slopes), stride), np.nan)
    grid_m[:, :num_columns] = np.inf
    # Written far to near: the nearest is written last.
    order = np.argsort(-ranges_m)
    grid_m[rings[order], columns[order] % num_columns] = ranges_m[order]
    grid_m[:, num_columns:-_GAP] = grid_m[:, :overlap]
    geometry = ScannerGeometry(0.0, increment, 0.0, range_max_m)
    scan = LaserScan(cloud.stamp_ns, geometry, grid_m.ravel())
    return RingScans(scan, num_columns, stride, phases, slopes)


def _column_spacing(rings: IntArray, azimuths: FloatArray) -> float:
    """Rad: the median step between neighbours of a ring, NaN for fewer than ten steps."""
    order = np.lexsort([azimuths, rings])
    steps = np.diff(azimuths[order])[np.diff(rings[order]) == 0]
    steps = steps[(steps > _INCREMENTS[0]) & (steps < _INCREMENTS[1])]
    return float(np.median(steps)) if len(steps) >= 10 else math.nan


def _means(rings: IntArray, values: FloatArray) -> FloatArray:
    """(k,) of each ring."""
    return np.asarray(np.bincount(rings, values) / np.bincount(rings))
