"""The centre of a square: exact from exact corners, honest where two poses fit."""

import numpy as np
import pytest

from detectors.marker_pose import marker_centre
from semgraph.arrays import FloatArray
from semgraph.geometry import rotation
from sensors.measurements import CameraGeometry

CAMERA = CameraGeometry(640, 480, 457.0, (319.5, 239.5))
EDGE_M = 0.165
SQUARE = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def _corners_px(centre: FloatArray, turn: float, roll: float = 0.0) -> FloatArray:
    """(4, 2) of a square turned about the vertical after it was rolled."""
    flat = EDGE_M * SQUARE @ rotation(roll).T
    points = np.column_stack([np.cos(turn) * flat[:, 0], flat[:, 1], np.sin(turn) * flat[:, 0]])
    right, down, ahead = (points + centre).T
    return np.column_stack([457.0 * right / ahead + 319.5, 457.0 * down / ahead + 239.5])


@pytest.mark.parametrize("seed", range(100))
def test_exact_corners_give_the_exact_centre(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(0.4, 6.0)
    true = depth_m * np.append(rng.uniform(-0.5, 0.5, 2), 1.0)
    corners_px = _corners_px(true, rng.uniform(-1.2, 1.2), rng.uniform(-3.1, 3.1))
    centre = marker_centre(CAMERA, EDGE_M, corners_px, 0.02)
    np.testing.assert_allclose(centre.optical_t_marker, true, atol=1e-5 * depth_m)
    assert np.linalg.eigvalsh(centre.covariance)[0] > 0.0


@pytest.mark.parametrize("depth_m", [1.0727345794727228, 0.6107786407403831, 1.0, 3.3])
@pytest.mark.parametrize("turn", [0.0, 1e-9, 1e-4])
def test_an_exactly_facing_square_has_a_pose(depth_m: float, turn: float) -> None:
    """Of some of the first two IPPE says NaN."""
    true = np.array([0.0, 0.0, depth_m])
    centre = marker_centre(CAMERA, EDGE_M, _corners_px(true, turn), 0.02)
    np.testing.assert_allclose(centre.optical_t_marker, true, atol=1e-6)
    assert np.linalg.eigvalsh(centre.covariance)[0] > 0.0


@pytest.mark.parametrize(("depth_m", "turn"), [(1.0, 0.6), (2.5, -0.5), (4.0, 0.4)])
def test_covariance_is_honest(depth_m: float, turn: float) -> None:
    rng = np.random.default_rng(7)
    true = np.array([0.3 * depth_m, -0.1 * depth_m, depth_m])
    exact_px = _corners_px(true, turn)
    nees = []
    for _ in range(300):
        corners_px = exact_px + rng.normal(0.0, 0.1, (4, 2))
        centre = marker_centre(CAMERA, EDGE_M, corners_px, 0.1)
        error = centre.optical_t_marker - true
        nees.append(error @ np.linalg.solve(centre.covariance, error))
    assert 2.4 < np.mean(nees) < 3.6


def test_the_other_pose_widens_the_covariance_while_it_is_likely() -> None:
    """A far square: exact corners fit one pose, worse ones both, whose centres differ by mm."""
    corners_px = _corners_px(np.array([-1.2, 0.0, 5.9]), 0.7)
    certain, still_certain, doubtful = (
        marker_centre(CAMERA, EDGE_M, corners_px, sigma_px) for sigma_px in (1e-4, 2e-4, 0.3)
    )
    np.testing.assert_allclose(still_certain.covariance, 4.0 * certain.covariance, atol=1e-12)
    growth = doubtful.covariance - certain.covariance * (0.3 / 1e-4) ** 2
    assert np.linalg.eigvalsh(growth)[-1] > 0.001**2
