"""Square optical markers, AprilTag 36h11, in grey images."""

from typing import Final, final

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from detectors.detector import DetectorType
from detectors.marker_corners import Corners, refine_corners
from detectors.marker_pose import SENSOR_R_OPTICAL, marker_centre
from semgraph.arrays import FloatArray, IntArray
from semgraph.geometry import rotation, wrap_angle
from semgraph.landmarks import Kind, Perceptions
from sensors.measurements import CameraImage

_CELLS = 8
_NEAREST_M = 1e-3


class OpticalMarkerSettings(BaseModel):
    """Marker and camera properties; lengths in m or pixels, angles in rad."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    edge_m: float = Field(default=0.165, gt=0.0, description="edge of the black square")
    min_edge_px: float = Field(default=15.0, ge=8.0, description="smaller squares are left out")
    max_wrong_bits: int = Field(default=2, ge=0, le=5, description="of 36, mended")
    shrinkage_px: float = Field(
        default=0.0,
        ge=-5.0,
        le=5.0,
        description="how much too short the edge appears: glare, print (see `shrinkage_px`)",
    )
    shrinkage_sigma_px: float = Field(default=0.02, ge=0.0, description="how well that is known")
    overexposed_sigma_px: float = Field(
        default=0.3, ge=0.0, description="the same where the white about a marker is clipped"
    )
    corner_sigma_px: float = Field(
        default=0.01, gt=0.0, description="of a corner beside noise and blur: lens, print"
    )
    blur_px: float = Field(
        default=0.7, ge=0.0, description="sigma of an edge in the image, lens and pixel together"
    )
    max_misfit_px: float = Field(
        default=0.5, gt=0.0, description="an edge less straight is none of a marker"
    )
    tilt_sigma: float = Field(
        default=0.0, ge=0.0, description="of the roll and pitch that level an image"
    )
    reliability: float = Field(default=0.99, gt=0.0, le=1.0)


@final
class OpticalMarkerDetector:
    """Decodes with OpenCV, refines the edges, and takes the better of the two poses of a square.

    Source: Olson 2011 (AprilTag); Collins and Bartoli 2014 (IPPE, both poses).
    """

    def __init__(self, settings: OpticalMarkerSettings) -> None:
        self._settings: Final = settings
        parameters = cv2.aruco.DetectorParameters()
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        parameters.errorCorrectionRate = (settings.max_wrong_bits + 0.5) / family.maxCorrectionBits
        # The outline of the white border is no second try at the same square.
        parameters.minMarkerDistanceRate = 0.02
        self._decoder: Final = cv2.aruco.ArucoDetector(family, parameters)

    def detect(self, image: CameraImage) -> Perceptions:
        """Markers by their ids, relative to the camera's place and heading in the plane.

        Range and bearing are those of the centre, levelled with the image's tilt, of which base
        leans about its origin. Two markers of one id cannot be told apart and are left out.
        """
        ids, corners = self._squares(image)
        edge_m = self._settings.edge_m
        centres = [
            marker_centre(image.camera, edge_m, corners_px, float(sigma_px))
            for corners_px, sigma_px in zip(corners.corners_px, corners.sigmas_px, strict=True)
        ]
        optical = np.array([centre.optical_t_marker for centre in centres]).reshape(-1, 3)
        covariances = np.array([centre.covariance for centre in centres]).reshape(-1, 3, 3)
        along = optical * (self._shrinkage_sigmas(corners) / _edges_px(corners.corners_px))[:, None]
        covariances += along[:, :, None] * along[:, None]
        return self._perceptions(image, ids, optical, covariances)

    def _squares(self, image: CameraImage) -> tuple[IntArray, Corners]:
        """Ids (n,) and corners of the squares that are markers."""
        settings = self._settings
        quads, found, _ = self._decoder.detectMarkers(image.grey)
        if not len(quads):
            nothing = np.zeros(0)
            return nothing.astype(np.int64), Corners(
                np.zeros((0, 4, 2)), nothing, nothing, nothing.astype(np.bool_)
            )
        ids = np.ravel(found).astype(np.int64)
        rough = np.array(quads, dtype=np.float64).reshape(-1, 4, 2)
        corners = refine_corners(image.grey, rough, _CELLS, settings.blur_px)
        edges_px = _edges_px(corners.corners_px)
        moved_px = np.abs(corners.corners_px - rough).max(axis=(1, 2), initial=0.0)
        _, which, counts = np.unique(ids, return_inverse=True, return_counts=True)
        right = (
            (edges_px >= settings.min_edge_px)
            & (corners.misfits_px <= settings.max_misfit_px)
            & (moved_px <= 1.0 + edges_px / _CELLS)
            & (counts[which] == 1)
        )
        grown = _grown(corners.corners_px[right], settings.shrinkage_px)
        sigmas_px = np.hypot(corners.sigmas_px[right], settings.corner_sigma_px)
        return ids[right], Corners(
            grown, sigmas_px, corners.misfits_px[right], corners.are_overexposed[right]
        )

    def _shrinkage_sigmas(self, corners: Corners) -> FloatArray:
        settings = self._settings
        known, clipped = settings.shrinkage_sigma_px, settings.overexposed_sigma_px
        return np.where(corners.are_overexposed, max(known, clipped), known)

    def _perceptions(
        self,
        image: CameraImage,
        ids: IntArray,
        optical_t_markers: FloatArray,
        covariances: FloatArray,
    ) -> Perceptions:
        """Levelled: (n, 3) m and (n, 3, 3) of the optical frame in the plane of the camera."""
        mounting, level_R_base = image.camera.mounting, image.tilt.level_R_base()
        level_R_optical = level_R_base @ mounting.base_R_sensor() @ SENSOR_R_OPTICAL
        level_t_camera = level_R_base @ (mounting.x_m, mounting.y_m, mounting.height_m)
        level_t_markers = level_t_camera + optical_t_markers @ level_R_optical.T
        leaning = (self._settings.tilt_sigma * level_t_markers[:, 2]) ** 2
        planar = (level_R_optical @ covariances @ level_R_optical.T)[:, :2, :2]
        planar = planar + leaning[:, None, None] * np.eye(2)
        base_T_sensor = image.base_T_sensor
        turn = rotation(-base_T_sensor.theta)
        x, y = base_T_sensor.inverse().transform(level_t_markers[:, :2]).T
        ranges_m = np.hypot(x, y)
        kept = ranges_m > _NEAREST_M
        x, y, ranges_m = x[kept], y[kept], ranges_m[kept]
        jacobians = (
            np.stack([np.stack([x, y], axis=-1), np.stack([-y, x] / ranges_m, axis=-1)], axis=-2)
            / ranges_m[:, None, None]
        )
        return Perceptions.from_arrays(
            image.stamp_ns,
            Kind.MARKER,
            ranges_m,
            wrap_angle(np.arctan2(y, x)),
            jacobians @ (turn @ planar[kept] @ turn.T) @ jacobians.transpose(0, 2, 1),
            identities=ids[kept].astype(np.str_),
            reliabilities=np.full(len(ranges_m), self._settings.reliability),
        )


def shrinkage_px(
    ranges_m: FloatArray, known_ranges_m: FloatArray, focal_px: float, edge_m: float
) -> float:
    """The `shrinkage_px` to set for a camera, median over markers at known distances.

    Args:
        ranges_m: (n,) from the camera to each marker, perceived with `shrinkage_px` 0.
        known_ranges_m: (n,) measured otherwise.
        focal_px: the camera's.
        edge_m: of the markers.
    """
    return float(np.median(focal_px * edge_m * (1.0 / known_ranges_m - 1.0 / ranges_m)))


def _edges_px(corners_px: FloatArray) -> FloatArray:
    """(n,) mean edge of squares (n, 4, 2)."""
    edges = np.linalg.norm(np.roll(corners_px, -1, axis=1) - corners_px, axis=2)
    return np.asarray(edges.mean(axis=1))


def _grown(corners_px: FloatArray, by_px: float) -> FloatArray:
    """Squares (n, 4, 2) with each edge moved out by half of `by_px`."""
    ahead = np.roll(corners_px, -1, axis=1) - corners_px
    behind = np.roll(corners_px, 1, axis=1) - corners_px
    ahead /= np.linalg.norm(ahead, axis=2, keepdims=True)
    behind /= np.linalg.norm(behind, axis=2, keepdims=True)
    sines = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
    return np.asarray(corners_px - 0.5 * by_px * (ahead + behind) / np.abs(sines)[..., None])


OPTICAL_MARKERS = DetectorType(OpticalMarkerSettings, OpticalMarkerDetector, looks_at=CameraImage)
