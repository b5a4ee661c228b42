"""Axes through sections: closed forms, outliers, pieces, honesty."""

import numpy as np
import pytest

from detectors.tree_3d_settings import Tree3dSettings
from detectors.trunk_axes import Axes, Sections, fit_axes

SETTINGS = Tree3dSettings(row_correlation=0.0, lean_sigma=1.0)


def _sections(
    foot: tuple[float, float],
    lean: tuple[float, float],
    heights_m: list[float],
    rng: np.random.Generator | None = None,
    sigma_m: float = 0.01,
) -> Sections:
    n = len(heights_m)
    z = np.array(heights_m)
    noise = np.zeros((n, 2)) if rng is None else sigma_m * rng.standard_normal((n, 2))
    centres = np.column_stack([np.array(foot) + z[:, None] * np.array(lean) + noise, z])
    return Sections(
        centres,
        np.tile(sigma_m**2 * np.eye(2), (n, 1, 1)),
        np.full(n, 0.3),
        np.full(n, 0.02),
        np.full(n, 0.9),
        np.arange(n),
    )


def _both(a: Sections, b: Sections) -> Sections:
    rings = np.concatenate([a.rings, len(a.rings) + b.rings])
    parts = {
        name: np.concatenate([getattr(a, name), getattr(b, name)]) for name in Sections.__slots__
    }
    return Sections(**(parts | {"rings": rings}))


def _fit(sections: Sections, settings: Tree3dSettings = SETTINGS) -> Axes:
    axes = fit_axes(sections, settings)
    assert axes is not None
    return axes


HEIGHTS_M = [0.5 + 0.25 * k for k in range(12)]


def test_a_straight_axis_is_found_exactly_at_the_reference_height() -> None:
    axes = _fit(_sections((4.0, 1.0), (0.1, -0.05), HEIGHTS_M))
    np.testing.assert_allclose(axes.base_t_centres, [[4.0 + 0.13, 1.0 - 0.065]], atol=1e-6)
    assert axes.diameters_m.tolist() == [0.3]


def test_one_section_far_off_hardly_matters() -> None:
    sections = _sections((4.0, 1.0), (0.0, 0.0), HEIGHTS_M)
    centres = sections.level_t_centres.copy()
    centres[5, 0] += 0.15
    off = Sections(
        **{n: getattr(sections, n) for n in Sections.__slots__ if n != "level_t_centres"},
        level_t_centres=centres,
    )
    assert abs(_fit(off).base_t_centres[0, 0] - 4.0) < 0.003


def test_covariances_are_honest_for_independent_sections() -> None:
    rng = np.random.default_rng(101)
    nees = []
    for _ in range(150):
        axes = _fit(_sections((4.0, 1.0), (0.02, 0.03), HEIGHTS_M, rng, 0.05))
        error = axes.base_t_centres[0] - (4.0 + 0.026, 1.0 + 0.039)
        nees.append(error @ np.linalg.solve(axes.covariances[0], error))
    # The weights that guard against outliers give away a quarter of the information.
    assert 1.3 < np.mean(nees) < 2.2


def test_sections_that_err_alike_are_worth_less() -> None:
    sections = _sections((4.0, 1.0), (0.0, 0.0), HEIGHTS_M)
    alone, alike = (_fit(sections, Tree3dSettings(row_correlation=share)) for share in (0.0, 1.0))
    assert alike.covariances[0, 0, 0] > 2.0 * alone.covariances[0, 0, 0]
    assert alike.diameter_sigmas_m[0] > 2.0 * alone.diameter_sigmas_m[0]


def test_two_pieces_of_one_axis_are_one_and_two_trunks_are_two() -> None:
    low = _sections((4.0, 1.0), (0.1, 0.0), HEIGHTS_M[:5])
    high = _sections((4.0, 1.0), (0.1, 0.0), [4.0 + h for h in HEIGHTS_M[:5]])
    assert len(_fit(_both(low, high)).diameters_m) == 1
    beside = _sections((4.0, 1.6), (0.0, 0.0), HEIGHTS_M)
    assert len(_fit(_both(low, beside)).diameters_m) == 2


@pytest.mark.parametrize("heights_m", [HEIGHTS_M[:1], HEIGHTS_M[:3], [1.0, 1.01, 1.02, 1.03, 1.04]])
def test_few_or_low_sections_are_no_trunk(heights_m: list[float]) -> None:
    assert fit_axes(_sections((4.0, 1.0), (0.0, 0.0), heights_m), SETTINGS) is None
