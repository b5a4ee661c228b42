"""The paper's Fig. 4 to 7, of the seed whose error is the middle one."""

from typing import Final

import numpy as np

from evaluation.studies.trial import Outcome
from evaluation.study_report.chart import Chart, map_chart
from evaluation.study_report.contents import PATH_ERROR, Contents
from evaluation.study_report.legends import Series, figure, legend
from evaluation.study_report.markup import Markup
from evaluation.study_report.scales import Scale, figure_text, scale_of
from semgraph.arrays import FloatArray

FAST: Final = "fast"
GLOBAL: Final = "particle-filter"
_SHOWN_SHARE: Final = 0.08
_FACTORS: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_PAPERS: Final = Series(FAST, "c0 d0")
_OTHERS: Final = Series(GLOBAL, "c1 d0")
_TRUTH: Final = Series("truth", "truth")


def paper_figures(contents: Contents) -> list[Markup]:
    """What can be drawn of the four; nothing where the fast estimator has no drawing."""
    found = (median_trial(contents, condition, FAST) for condition in contents.conditions)
    shown = next((each for each in found if each is not None), None)
    figures = [] if shown is None else [_fig_4(shown), _fig_5(shown)]
    pair = _with_global(contents)
    if pair is not None:
        figures += [_fig_6(*pair), _fig_7(*pair)]
    return [each for each in figures if each is not None]


def _with_global(contents: Contents) -> tuple[Outcome, Outcome] | None:
    """The fast estimator and global localization on the same measurements."""
    for condition in contents.conditions:
        others = {each.trial.pair: each for each in contents.finished(condition, GLOBAL)}
        shown = median_trial(contents, condition, FAST)
        if shown is not None and shown.trial.pair in others:
            return shown, others[shown.trial.pair]
    return None


def median_trial(contents: Contents, condition: str, estimator: str) -> Outcome | None:
    """The finished trial with the middle path error; None where there is none with a drawing."""
    its = [
        each
        for each in contents.finished(condition, estimator)
        if each.drawing is not None and np.isfinite(each.values.get(PATH_ERROR, np.nan))
    ]
    its.sort(key=lambda each: each.values[PATH_ERROR])
    return its[(len(its) - 1) // 2] if its else None


def _fig_4(shown: Outcome) -> Markup | None:
    drawing = shown.drawing
    if drawing is None:
        return None
    chart = map_chart(np.concatenate([drawing.true_path, drawing.true_landmarks]))
    chart.line(drawing.true_path[:, 0], drawing.true_path[:, 1], "truth")
    chart.ring(drawing.true_landmarks[:, 0], drawing.true_landmarks[:, 1], "truth", 3.2)
    chart.line(drawing.estimated_path[:, 0], drawing.estimated_path[:, 1], _PAPERS.class_)
    chart.dots(drawing.estimated_landmarks[:, 0], drawing.estimated_landmarks[:, 1], "c1", 1.9)
    seen = (
        f"{len(drawing.estimated_landmarks)} landmarks mapped, {len(drawing.true_landmarks)} true"
    )
    return figure(
        chart.svg("Fig. 4: map and path", f"{seen}, along {len(drawing.true_path)} true points."),
        f"Fig. 4 redone: landmarks as they stand (rings) and as {FAST} mapped them (dots), with "
        f"the true and the estimated path. {_which(shown)}",
        legend((_TRUTH, _PAPERS)),
    )


def _fig_5(shown: Outcome) -> Markup | None:
    series, errors_m = shown.series, errors_in_x_and_y(shown)
    if series is None or not len(series.times_s):
        return None
    last_s = float(series.times_s[-1])
    shown_m = series.position_errors_m if errors_m is None else errors_m.ravel()
    everything = np.concatenate([shown_m, series.heading_errors_deg])
    y = scale_of(everything, "error (m, and deg)", from_zero=errors_m is None)
    chart = Chart(Scale(0.0, last_s, "time since the start (s)"), y)
    chart.line(series.times_s, series.heading_errors_deg, "c4 d2")
    lines = [Series("rotation (deg)", "c4 d2")]
    if errors_m is None:
        chart.line(series.times_s, series.position_errors_m, "c0 d0")
        lines.append(Series("distance (m)", "c0 d0"))
    else:
        for name, class_, values in zip("xy", ("c0 d0", "c1 d1"), errors_m.T, strict=True):
            chart.line(np.linspace(0.0, last_s, len(values)), values, class_)
            lines.append(Series(f"{name} (m)", class_))
    largest = figure_text(float(np.nanmax(series.position_errors_m)))
    last = figure_text(float(series.position_errors_m[-1]))
    return figure(
        chart.svg(
            "Fig. 5: errors during the run", f"At most {largest} m, and {last} m at the end."
        ),
        f"Fig. 5 redone: errors of {FAST} over time, the path rigidly aligned; of the rotation its "
        f"size. {_which(shown)}",
        legend((*lines[1:], lines[0])),
    )


def errors_in_x_and_y(outcome: Outcome) -> FloatArray | None:
    """(n, 2) m along the drawn path; None where it was not drawn at the times of the true one.

    Drawings have no times. Points of both paths belong together if there are as many of each and
    none are further apart than the largest error that was measured.
    """
    drawing, series = outcome.drawing, outcome.series
    if drawing is None or series is None or not len(series.times_s):
        return None
    if drawing.true_path.shape != drawing.estimated_path.shape:
        return None
    errors_m = drawing.estimated_path - drawing.true_path
    largest_m = float(series.position_errors_m.max())
    is_same = np.hypot(errors_m[:, 0], errors_m[:, 1]).max() <= largest_m * (1.0 + 1e-6)
    return errors_m if is_same else None


def _fig_6(shown: Outcome, other: Outcome) -> Markup | None:
    one, two = shown.drawing, other.drawing
    if one is None or two is None:
        return None
    (first, second), factor = _magnified(shown, other)
    chart = map_chart(np.concatenate([one.true_path, first, second]))
    chart.line(one.true_path[:, 0], one.true_path[:, 1], "truth")
    chart.line(first[:, 0], first[:, 1], _PAPERS.class_)
    chart.line(second[:, 0], second[:, 1], "c1 d1")
    errors = [figure_text(each.values.get(PATH_ERROR, np.nan)) for each in (shown, other)]
    drawn = f" Distances from the true path are drawn {factor} times as large." * (factor > 1)
    return figure(
        chart.svg(
            "Fig. 6: global localization beside the fast estimator",
            f"Path errors {errors[0]} m ({FAST}) and {errors[1]} m ({GLOBAL}).",
        ),
        f"Fig. 6 redone: global localization in the known map ({GLOBAL}) beside {FAST}, which "
        f"makes its map itself.{drawn} {_which(shown)}",
        legend((_TRUTH, _PAPERS, Series(GLOBAL, "c1 d1"))),
    )


def _magnified(shown: Outcome, other: Outcome) -> tuple[list[FloatArray], int]:
    """Both paths, their errors as many times as large as can be seen; 1 where that is unknown."""
    drawings = [each.drawing for each in (shown, other) if each.drawing is not None]
    errors = [errors_in_x_and_y(each) for each in (shown, other)]
    known = [each for each in errors if each is not None]
    extent_m = float(np.ptp(drawings[0].true_path, axis=0).max())
    if len(known) < len(drawings) or not extent_m > 0.0:
        return [each.estimated_path for each in drawings], 1
    largest_m = max(float(np.hypot(each[:, 0], each[:, 1]).max()) for each in known)
    wanted = _SHOWN_SHARE * extent_m / max(largest_m, 1e-9 * extent_m)
    factor = max([each for each in _FACTORS if each <= wanted], default=1)
    return [
        each.true_path + factor * errors_m for each, errors_m in zip(drawings, known, strict=True)
    ], factor


def _fig_7(shown: Outcome, other: Outcome) -> Markup | None:
    one, two = shown.series, other.series
    if one is None or two is None or not np.isfinite(one.heading_errors_deg).any():
        return None
    both = np.concatenate([one.heading_errors_deg, two.heading_errors_deg])
    chart = _time_chart(one.times_s, both, "heading error (deg)")
    chart.line(one.times_s, one.heading_errors_deg, _PAPERS.class_)
    chart.line(two.times_s, two.heading_errors_deg, "c1 d1")
    largest = figure_text(float(np.nanmax(one.heading_errors_deg)))
    return figure(
        chart.svg("Fig. 7: rotation", f"{FAST} turns at most {largest} deg from the truth."),
        "Fig. 7 redone against the true heading, as simulated runs carry no IMU: how far the "
        f"estimated rotation is off. {_which(shown)}",
        legend((_PAPERS, Series(GLOBAL, "c1 d1"))),
    )


def _time_chart(times_s: FloatArray, values: FloatArray, label: str) -> Chart:
    x = Scale(0.0, float(times_s[-1]), "time since the start (s)")
    return Chart(x, scale_of(values, label, from_zero=True))


def _which(shown: Outcome) -> str:
    trial = shown.trial
    return f"Seed {trial.seed} of {trial.condition}, whose path error is the median."
