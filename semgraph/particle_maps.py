"""A map of its own for each particle: Gaussian landmarks, sighted by range and bearing."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import BoolArray, FloatArray, IntArray
from semgraph.geometry import wrap_angle
from semgraph.measurement_model import CHI2_2DOF_999

# More landmarks no particle has; then the one farthest away is forgotten.
MOST_LANDMARKS: Final = 64
_NONE: Final = -1
_LEAST_RANGE_M: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class _Predicted:
    """One sighting as each landmark of each particle would explain it, all (n, c).

    Attributes:
        range_by_x, range_by_y, bearing_by_x, bearing_by_y: the Jacobian by the landmark.
        range_error, bearing_error: perceived minus predicted.
        S11, S12, S22: the covariance of that.
    """

    range_by_x: FloatArray
    range_by_y: FloatArray
    bearing_by_x: FloatArray
    bearing_by_y: FloatArray
    range_error: FloatArray
    bearing_error: FloatArray
    S11: FloatArray
    S12: FloatArray
    S22: FloatArray

    def log_likelihoods(self) -> FloatArray:
        """(n, c) of range and bearing; -inf beyond the 99.9 % gate."""
        determinants = self.S11 * self.S22 - self.S12**2
        distances2 = (
            self.S22 * self.range_error**2
            - 2.0 * self.S12 * self.range_error * self.bearing_error
            + self.S11 * self.bearing_error**2
        ) / determinants
        logs = -0.5 * (distances2 + np.log(determinants)) - np.log(2.0 * np.pi)
        return np.where(distances2 <= CHI2_2DOF_999, logs, -np.inf)

    def at(self, rows: IntArray, columns: IntArray) -> "_Predicted":
        """(k,) of one landmark in each of these particles."""
        return _Predicted(*(getattr(self, name)[rows, columns] for name in self.__slots__))


class ParticleMaps:
    """Landmarks of n particles, each with means, covariances (xx, xy, yy) and numbers.

    Attributes:
        numbers: (n, c) of the sighting that each landmark began with, the same in all particles
            that took it for new; -1 where there is no landmark.
    """

    def __init__(self, num_particles: int, sigma_m: float) -> None:
        self._variance = sigma_m**2
        self._means = np.zeros((num_particles, MOST_LANDMARKS, 2))
        self._covariances = np.zeros((num_particles, MOST_LANDMARKS, 3))
        self._numbers = np.full((num_particles, MOST_LANDMARKS), _NONE)

    @property
    def numbers(self) -> IntArray:
        """Of the columns that any particle has a landmark in."""
        return self._numbers[:, : int(self.counts().max(initial=0))]

    def counts(self) -> IntArray:
        """(n,) landmarks of each particle."""
        counts: IntArray = (self._numbers != _NONE).sum(axis=1)
        return counts

    def select(self, rows: IntArray) -> None:
        """Particles are drawn anew."""
        self._means, self._covariances = self._means[rows], self._covariances[rows]
        self._numbers = self._numbers[rows]

    def predict(
        self, map_T_bases: FloatArray, range_m: float, bearing: float, covariance: FloatArray
    ) -> _Predicted:
        """How each landmark explains what is perceived, from poses (n, 3)."""
        c = self.numbers.shape[1]
        x, y = np.moveaxis(self._means[:, :c] - map_T_bases[:, None, :2], -1, 0)
        r = np.maximum(np.hypot(x, y), _LEAST_RANGE_M)
        ux, uy = x / r, y / r
        vx, vy = -uy / r, ux / r
        xx, xy, yy = np.moveaxis(self._covariances[:, :c], -1, 0)
        # All of what is around may be off a little, however often it was sighted.
        xx, yy = xx + self._variance, yy + self._variance
        ahead = np.arctan2(y, x) - map_T_bases[:, 2:]
        return _Predicted(
            ux,
            uy,
            vx,
            vy,
            range_m - r,
            wrap_angle(bearing - ahead),
            ux * ux * xx + 2.0 * ux * uy * xy + uy * uy * yy + covariance[0, 0],
            ux * vx * xx + (ux * vy + uy * vx) * xy + uy * vy * yy + covariance[0, 1],
            vx * vx * xx + 2.0 * vx * vy * xy + vy * vy * yy + covariance[1, 1],
        )

    def sight(self, rows: IntArray, columns: IntArray, predicted: _Predicted) -> None:
        """The Kalman update of one landmark in each of these particles, all (k,)."""
        p = predicted.at(rows, columns)
        xx, xy, yy = self._covariances[rows, columns].T
        rx, ry = xx * p.range_by_x + xy * p.range_by_y, xy * p.range_by_x + yy * p.range_by_y
        bx, by = (
            xx * p.bearing_by_x + xy * p.bearing_by_y,
            xy * p.bearing_by_x + yy * p.bearing_by_y,
        )
        determinants = p.S11 * p.S22 - p.S12**2
        i11, i12, i22 = p.S22 / determinants, -p.S12 / determinants, p.S11 / determinants
        xr, xb = rx * i11 + bx * i12, rx * i12 + bx * i22
        yr, yb = ry * i11 + by * i12, ry * i12 + by * i22
        moved = [
            xr * p.range_error + xb * p.bearing_error,
            yr * p.range_error + yb * p.bearing_error,
        ]
        self._means[rows, columns] += np.column_stack(moved)
        less = [xr * rx + xb * bx, xr * ry + xb * by, yr * ry + yb * by]
        self._covariances[rows, columns] -= np.column_stack(less)

    def insert(
        self,
        rows: IntArray,
        map_T_bases: FloatArray,
        polar: tuple[float, float],
        covariance: FloatArray,
        number: int,
    ) -> IntArray:
        """(k,) the columns of a new landmark in each of these particles.

        Args:
            rows: (k,) particles.
            map_T_bases: (n, 3) of all particles.
            polar: range in m and bearing.
            covariance: (2, 2) of those.
            number: of the landmark.
        """
        columns = self._free(rows, map_T_bases)
        range_m, bearing = polar
        ahead = map_T_bases[rows, 2] + bearing
        out = np.column_stack([np.cos(ahead), np.sin(ahead)])
        J = np.stack([out, range_m * np.column_stack([-out[:, 1], out[:, 0]])], axis=-1)
        spread = J @ covariance @ J.transpose(0, 2, 1)
        self._means[rows, columns] = map_T_bases[rows, :2] + range_m * out
        self._covariances[rows, columns] = spread[:, [0, 0, 1], [0, 1, 1]]
        self._numbers[rows, columns] = number
        return columns

    def _free(self, rows: IntArray, map_T_bases: FloatArray) -> IntArray:
        """(k,) the first column without a landmark; else that of the farthest one."""
        empty: BoolArray = self._numbers[rows] == _NONE
        offsets = self._means[rows] - map_T_bases[rows, None, :2]
        farthest = np.square(offsets).sum(axis=2).argmax(axis=1)
        columns: IntArray = np.where(empty.any(axis=1), empty.argmax(axis=1), farthest)
        return columns
