"""Where the centre of a square is, from its four corners in an image."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from semgraph.arrays import FloatArray
from sensors.measurements import CameraGeometry

SENSOR_R_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_SQUARE = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
"""Corners in the order that OpenCV's IPPE_SQUARE wants, in edges: right, down, ahead.

From the lower left. Taken as right, up, back, a square that faces the camera is turned by half a
turn, and there OpenCV 5.0 gives wrong rotation vectors.
"""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerCentre:
    """A centre in the optical frame (right, down, ahead): (3,) m, covariance (3, 3) m2."""

    optical_t_marker: FloatArray
    covariance: FloatArray


def marker_centre(
    camera: CameraGeometry, edge_m: float, corners_px: FloatArray, sigma_px: float
) -> MarkerCentre:
    """The centre by the better of the square's two poses.

    The other pose widens the covariance by as much as it is likely.

    Args:
        camera: its focal length and centre.
        edge_m: of the square.
        corners_px: (4, 2) columns and rows, clockwise as it is seen from its upper left.
        sigma_px: of each coordinate of a corner.
    Source: Collins and Bartoli 2014 (IPPE), then least squares.
    """
    matrix = np.diag([camera.focal_px, camera.focal_px, 1.0])
    matrix[:2, 2] = camera.centre_px
    square, corners_px = edge_m * _SQUARE, np.ascontiguousarray(corners_px[::-1])
    chi2, centres, covariances = [], [], []
    for start in _starts(square, corners_px, matrix):
        # A second solution that is no minimum of its own runs into the first here.
        turn, place = cv2.solvePnPRefineLM(square, corners_px, matrix, None, *start)
        projected, jacobian = cv2.projectPoints(square, turn, place, matrix, None)
        information = jacobian[:, :6].T @ jacobian[:, :6] / sigma_px**2
        chi2.append(float(np.sum((projected[:, 0] - corners_px) ** 2)) / sigma_px**2)
        centres.append(np.asarray(place[:, 0], dtype=np.float64))
        covariances.append(np.linalg.pinv(information, hermitian=True)[3:, 3:])
    best = int(np.argmin(chi2))
    likely = np.exp(-0.5 * (np.array(chi2) - chi2[best]))
    apart = np.array(centres) - centres[best]
    spread = np.einsum("k,ki,kj->ij", likely / likely.sum(), apart, apart)
    return MarkerCentre(centres[best], covariances[best] + spread)


def _starts(
    square: FloatArray, corners_px: FloatArray, matrix: FloatArray
) -> Sequence[tuple[FloatArray, FloatArray]]:
    """IPPE's rotation vectors and places (3, 1); of a square that faces the camera it has none."""
    _, turns, places, _ = cv2.solvePnPGeneric(
        square, corners_px, matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    starts = [
        (np.asarray(turn, dtype=np.float64), np.asarray(place, dtype=np.float64))
        for turn, place in zip(turns, places, strict=True)
        if np.isfinite(turn).all() and np.isfinite(place).all()
    ]
    if starts:
        return starts
    ahead = np.linalg.solve(matrix, np.append(corners_px.mean(axis=0), 1.0))
    depth_m = matrix[0, 0] * np.sqrt(np.ptp(square, axis=0).max() ** 2 / _area(corners_px))
    return [(np.zeros((3, 1)), depth_m * ahead[:, None])]


def _area(corners: FloatArray) -> float:
    """Of a polygon (n, 2)."""
    x, y = corners.T
    return float(0.5 * np.abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
