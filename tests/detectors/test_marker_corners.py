"""Corners to a part of a pixel: blurred, turned, bright or noisy, and degenerate squares."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from detectors.marker_corners import refine_corners
from semgraph.arrays import FloatArray
from semgraph.geometry import rotation

SIDE = 64.0
MIDDLE = np.array([80.3, 79.6])
FINE = 8


def _picture(turn: float, blur_px: float, noise: float = 0.0, gain: float = 1.0) -> FloatArray:
    """A black square of 64 px with a white border on grey, and in it a white core; anti-aliased."""
    steps = (np.arange(160 * FINE) + 0.5) / FINE - 0.5
    points = np.stack(np.meshgrid(steps, steps), axis=-1) - MIDDLE
    out = np.abs(points @ rotation(turn)).max(axis=-1) / (0.5 * SIDE)
    canvas = np.select([out < 0.75, out < 1.0, out < 1.25], [210.0, 30.0, 210.0], 110.0)
    small = canvas.reshape(160, FINE, 160, FINE).mean(axis=(1, 3))
    blurred = gaussian_filter(small, blur_px)
    seen = gain * blurred + np.random.default_rng(0).normal(0.0, noise, blurred.shape)
    return np.asarray(np.clip(seen, 0, 255))


def _corners(turn: float) -> FloatArray:
    square = 0.5 * SIDE * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.asarray(square @ rotation(turn).T + MIDDLE)


@pytest.mark.parametrize("turn", [0.0, 0.2, -0.7, 1.3])
@pytest.mark.parametrize("blur_px", [0.4, 0.8, 1.5])
def test_blur_does_not_move_the_corners(turn: float, blur_px: float) -> None:
    """An edge along the pixels' rows meets all of them alike: nothing averages there."""
    rough = _corners(turn)[None] + np.random.default_rng(1).uniform(-1.0, 1.0, (1, 4, 2))
    grey = _picture(turn, blur_px).astype(np.uint8)
    found = refine_corners(grey, rough, 8, blur_px)
    np.testing.assert_allclose(
        found.corners_px[0], _corners(turn), atol=0.08 if turn == 0.0 else 0.05
    )
    assert not found.are_overexposed[0]


def test_noise_is_told_in_the_sigma() -> None:
    sigmas_px = []
    for noise in (1.0, 8.0):
        grey = _picture(0.3, 0.7, noise).astype(np.uint8)
        found = refine_corners(grey, _corners(0.3)[None], 8, 0.0)
        error_px = np.sqrt(np.mean((found.corners_px[0] - _corners(0.3)) ** 2))
        assert error_px < 4.0 * found.sigmas_px[0]
        sigmas_px.append(found.sigmas_px[0])
    assert sigmas_px[1] > 2.0 * sigmas_px[0]


def test_clipped_white_is_told() -> None:
    grey = _picture(0.3, 0.7, gain=1.5).astype(np.uint8)
    assert refine_corners(grey, _corners(0.3)[None], 8, 0.7).are_overexposed.tolist() == [True]


def test_squares_do_not_depend_on_each_other() -> None:
    grey = _picture(0.3, 0.7, 3.0).astype(np.uint8)
    squares = _corners(0.3) + np.array([[[0.0, 0.0]], [[0.5, -0.5]], [[30.0, 10.0]]])
    together = refine_corners(grey, squares, 8, 0.7)
    for k in range(3):
        alone = refine_corners(grey, squares[k : k + 1], 8, 0.7)
        np.testing.assert_allclose(alone.corners_px[0], together.corners_px[k])


@pytest.mark.parametrize(
    "square",
    [np.zeros((4, 2)), np.full((4, 2), 1e7), np.array([[0, 0], [9, 0], [18, 0], [27, 0]])],
    ids=["a point", "far outside", "a line"],
)
def test_what_is_no_square_has_no_corners_or_a_valid_sigma(square: FloatArray) -> None:
    grey = _picture(0.0, 0.7).astype(np.uint8)
    found = refine_corners(grey, square[None].astype(np.float64), 8, 0.7)
    assert np.isnan(found.corners_px).any() or found.sigmas_px[0] >= 0.0


def test_no_squares_are_no_corners() -> None:
    found = refine_corners(np.zeros((5, 5), np.uint8), np.zeros((0, 4, 2)), 8, 0.7)
    assert found.corners_px.shape == (0, 4, 2)
    assert found.sigmas_px.shape == (0,)
