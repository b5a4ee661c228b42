"""What `semgraph localize` does."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console

from evaluation.figures import draw_localization
from evaluation.metrics import Metric
from evaluation.report import evaluate_folder
from evaluation.truth_files import write_truth
from semgraph import localization, results, viewer
from semgraph.command_line.commands import RESULTS, RUN_RRD, effective_settings
from semgraph.command_line.terminal import terminal
from semgraph.files import staging
from semgraph.given_maps import read_given_map
from semgraph.localizer import Estimator, start_of
from semgraph.offline.map_growth import Stretches, grow
from semgraph.offline.refining import counts_of
from semgraph.perceiving import Perceiver
from semgraph.progress import progress
from semgraph.settings import load_settings
from sensors.catalog import open_source

LOCALIZATION_PNG: Final = "localization.png"
_SURE_ABOVE: Final = 0.95


def localize(
    source: str,
    map_file: Path,
    output: Path | None,
    settings_file: Path | None,
    assignments: Sequence[str],
    *,
    pose: Sequence[float] | None = None,
    circle: Sequence[float] | None = None,
    grows: bool = False,
) -> None:
    """Finds and follows the robot of a source in a known map, writes and prints what came out.

    Where the map grows, run and map are brought to their joint optimum afterwards.

    Raises:
        SemgraphError: anything that a user can put right.
    """
    console = terminal()
    settings = load_settings(settings_file, assignments)
    with console.status(f"reading {source} and {map_file}"):
        opened = open_source(source, settings.source)
        landmarks = read_given_map(map_file, settings.localizer.listed_sigma_m)
    folder = output or staging.new_results_folder(RESULTS, datetime.now().astimezone())
    perceiver, recording = Perceiver(opened.recording, settings), opened.recording
    effective = effective_settings(source, settings, perceiver)
    start = start_of(pose, circle)
    stretches = Stretches(settings.tracker) if grows else None
    with results.staged_results(folder) as staged:
        with progress(console, recording.name, recording.num_scans) as report:
            result = localization.localize(
                recording, landmarks, start, settings, perceiver, report, effective, stretches
            )
        if stretches is not None:
            with console.status("growing the map") as status:
                grown = grow(landmarks, stretches.logs(), settings.smoother, status.update)
            result = result.with_grown(grown) if grown is not None else result
        localization.write_localization(result, staged)
        write_truth(staged, opened.truth)
        viewer.write_recording(result.run, staged / RUN_RRD)
        metrics = evaluate_folder(staged)
        draw_localization(result, staged / LOCALIZATION_PNG)
    unlinked = staging.point_latest(folder) if output is None else None
    _print_localized(console, result, metrics)
    if unlinked is not None:
        console.print(f"results/latest could not be set: {unlinked}")
    console.print(f"written: {folder}, look at {folder / LOCALIZATION_PNG}")


def _print_localized(
    console: Console, result: localization.LocalizationResult, metrics: Sequence[Metric]
) -> None:
    """How sure, how accurate, by which estimator."""
    sure = [each for each in result.localized if each.quality >= _SURE_ABOVE]
    fast = sum(each.estimator is Estimator.FAST for each in result.localized)
    total = len(result.localized)
    console.print(
        f"{len(sure)} of {total} poses are within 1 m by {100 * _SURE_ABOVE:.0f} % or more; "
        f"{fast} by the fast estimator, {total - fast} by particles"
    )
    if sure:
        seconds = (sure[0].stamp_ns - result.localized[0].stamp_ns) * 1e-9
        pose = sure[0].map_T_base.pose
        where = f"x {pose.x:.2f} m, y {pose.y:.2f} m, yaw {np.degrees(pose.theta):.1f} deg"
        console.print(f"found after {seconds:.1f} s, at {where}")
    if result.grown is not None:
        console.print(f"map: {counts_of(result.grown.changes)}")
    errors = {metric.name: metric.value for metric in metrics}
    if "trajectory_rmse_unaligned_m" in errors:
        fast_rmse = errors.get("fast_trajectory_rmse_unaligned_m")
        alone = "" if fast_rmse is None else f" (fast estimator alone {fast_rmse:.3f} m)"
        rmse_m = errors["trajectory_rmse_unaligned_m"]
        console.print(f"RMSE in the map's frame, all poses: {rmse_m:.3f} m{alone}")
