"""Where the centre of a square is, from its four corners in an image."""

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
    _, turns, places, _ = cv2.solvePnPGeneric(
        square, corners_px, matrix, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    chi2, centres, covariances = [], [], []
    for start in zip(turns, places, strict=True):
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
