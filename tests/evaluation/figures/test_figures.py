"""Pictures are looked at by people; here they are drawn for every kind of run, and measured."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from evaluation.figures import draw_errors, draw_map, draw_rotation
from evaluation.figures.errors import _error_axes
from evaluation.figures.map import _draw_landmarks, _extent, _map_axes
from evaluation.figures.style import broken_at_gaps, drawable
from semgraph.errors import SemgraphError
from semgraph.estimates import Trajectory
from semgraph.landmarks import Kind, Landmark, semantic_object
from semgraph.results import RunResult
from sensors.truth import Truth
from tests.evaluation.course import make_run, with_imu

NOTHING = Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)))


def runs() -> dict[str, tuple[RunResult, Truth]]:
    result, truth = make_run(0)
    assert truth.path is not None
    empty = RunResult("", NOTHING, np.empty((0, 3, 3)), NOTHING, (), np.empty(0), 0.0, 0)
    positions = np.array(truth.path.world_t_reference)
    positions[5] += 137.0
    gnss = replace(truth.path, world_t_reference=positions, headings=None, has_outliers=True)
    rows = np.flatnonzero(np.arange(200) % 60 < 40)
    gaps = Trajectory(result.smoothed.stamps_ns[rows], result.smoothed.map_T_bases[rows])
    return {
        "whole": (result, truth),
        "no truth": (result, Truth()),
        "no headings": (result, Truth(gnss, truth.landmarks)),
        "landmarks only": (result, Truth(landmarks=truth.landmarks)),
        "empty": (empty, truth),
        "empty without truth": (empty, Truth()),
        "odd name": (replace(result, name="$\\frac{x}$ 森林 " + 200 * "long "), truth),
        "gaps": (
            replace(result, smoothed=gaps, smoothed_covariances=np.full((len(rows), 3, 3), np.nan)),
            truth,
        ),
    }


@pytest.mark.parametrize("name", runs())
def test_every_kind_of_run_is_drawn(tmp_path: Path, name: str) -> None:
    result, truth = runs()[name]
    draw_rotation(result, tmp_path / "rotation.png")
    for draw in (draw_map, draw_errors):
        draw(result, truth, tmp_path / "picture.png")
        image = imread(tmp_path / "picture.png")
        assert min(image.shape[:2]) > 800
        assert image[..., :3].min() < 0.5


def test_the_pictures_show_the_run(tmp_path: Path) -> None:
    result, truth = make_run(0)
    other = replace(result, smoothed=replace(result.fast))
    images = []
    for shown in (result, other):
        draw_errors(shown, truth, tmp_path / "errors.png")
        images.append(imread(tmp_path / "errors.png"))
    assert (images[0] != images[1]).any()


def test_a_picture_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(SemgraphError, match="cannot be written"):
        draw_map(*make_run(0), tmp_path / "none" / "map.png")


@pytest.mark.parametrize("high", [(20.0, 20.0), (300.0, 250.0), (4000.0, 10.0), (1.0, 900.0)])
def test_a_metre_is_as_long_in_x_as_in_y_and_everything_is_inside(
    high: tuple[float, float],
) -> None:
    figure, axes = _map_axes(np.zeros(2), np.array(high))
    box = axes.get_position()
    x, y = axes.get_xlim(), axes.get_ylim()
    across = box.width * figure.get_figwidth() / (x[1] - x[0])
    up = box.height * figure.get_figheight() / (y[1] - y[0])
    assert across == pytest.approx(up)
    assert x[0] <= 1e-9
    assert x[1] >= high[0] - 1e-9
    assert y[0] <= 1e-9
    assert y[1] >= high[1] - 1e-9
    assert max(figure.get_size_inches()) < 15.0


def test_ellipses_lie_along_their_covariances_and_hold_95_percent() -> None:
    long_m, short_m, turn = 3.0, 1.0, 0.5
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    covariance = R @ np.diag([long_m**2, short_m**2]) @ R.T
    _, axes = _map_axes(np.full(2, -10.0), np.full(2, 10.0))
    tree = Landmark(0, semantic_object(Kind.TREE), np.zeros(2), covariance, 3, 1.0)
    _draw_landmarks(axes, [tree])
    (ellipses,) = axes.collections
    points = np.random.default_rng(0).multivariate_normal(np.zeros(2), covariance, 4000)
    ellipses.set_figure(axes.figure)
    widths, heights = ellipses.get_widths()[0], ellipses.get_heights()[0]  # type: ignore[attr-defined]  # missing in the stubs
    angle = np.radians(ellipses.get_angles()[0])  # type: ignore[attr-defined]  # missing in the stubs
    c, s = np.cos(angle), np.sin(angle)
    along, across = points @ [c, s] / (widths / 2), points @ [-s, c] / (heights / 2)
    assert np.mean(along**2 + across**2 <= 1.0) == pytest.approx(0.95, abs=0.012)
    assert widths > heights


def test_an_ellipse_wider_than_the_map_hides_nothing_and_is_told() -> None:
    _, axes = _map_axes(np.full(2, -100.0), np.full(2, 100.0))
    places, sigmas_m = (np.zeros(2), np.full(2, 50.0), np.full(2, -50.0)), (0.1, 30.0, 0.1)
    trees = [
        Landmark(k, semantic_object(Kind.TREE), place, sigma_m**2 * np.eye(2), 3, 1.0)
        for k, (place, sigma_m) in enumerate(zip(places, sigmas_m, strict=True))
    ]
    _draw_landmarks(axes, trees)
    (ellipses,) = axes.collections
    assert len(np.asarray(ellipses.get_offsets())) == 2
    (label,) = axes.get_legend_handles_labels()[1]
    assert label == "tree (3),\n1 with too wide an ellipse"


def test_lines_break_where_nothing_was_known() -> None:
    stamps_ns = np.array([0, 1, 2, 6, 7]) * 1_000_000_000
    broken = broken_at_gaps(stamps_ns, np.arange(10.0).reshape(5, 2))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(broken[:, 0])), [3])


def test_a_line_of_points_that_are_always_far_apart_breaks_only_where_they_are_farther() -> None:
    seconds = np.array([0, 3, 6, 9, 48, 51, 54])
    broken = broken_at_gaps(seconds * 1_000_000_000, np.arange(14.0).reshape(7, 2))
    assert np.flatnonzero(np.isnan(broken).all(axis=1)).tolist() == [4]
    assert not len(broken_at_gaps(np.empty(0, dtype=np.int64), np.empty((0, 2))))


def test_what_the_font_lacks_is_a_question_mark() -> None:
    assert drawable("Müller 森\n") == "Müller ??"


def test_there_is_an_extent_without_points() -> None:
    low, high = _extent([np.empty((0, 2)), np.full((1, 2), np.nan)])
    assert (low < high).all()


@pytest.mark.parametrize(("with_headings", "num_panels"), [(True, 3), (False, 2)])
def test_rotation_has_a_panel_only_with_headings(*, with_headings: bool, num_panels: int) -> None:
    _, panels = _error_axes("error", with_headings=with_headings)
    assert len(panels) == num_panels
    assert any("rotation" in axes.get_ylabel() for axes in panels) == with_headings


def test_rotation_shows_each_estimate_and_the_sensor(tmp_path: Path) -> None:
    result, truth = make_run(0)
    assert truth.path is not None
    images = []
    for name, shown in (
        ("both", with_imu(result, truth.path)),
        ("other", replace(with_imu(result, truth.path), smoothed=result.fast)),
        ("one", replace(with_imu(result, truth.path), fast=NOTHING)),
        ("none", result),
    ):
        draw_rotation(shown, tmp_path / f"{name}.png")
        images.append(imread(tmp_path / f"{name}.png"))
    for k, first in enumerate(images):
        assert all((first != second).any() for second in images[:k])
