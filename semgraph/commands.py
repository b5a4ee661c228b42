"""What the commands do: the file that brings sources, detectors, pipeline and judge together."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rich.console import Console
from rich.table import Table

from evaluation.metrics import Metric
from evaluation.report import evaluate_folder, table_rows
from evaluation.trajectory import trajectory_difference
from evaluation.truth_files import write_truth
from semgraph import localization, pipeline, results, staging, viewer
from semgraph.detecting import Effort, Efforts, write_detections
from semgraph.given_maps import read_given_map
from semgraph.localizer import Estimator, start_of
from semgraph.perceiving import Perceiver
from semgraph.progress import progress
from semgraph.settings import Settings, load_settings
from semgraph.trace import Trace
from sensors.catalog import open_source, source_options
from sensors.plain_perceptions import PERCEPTIONS_FILE
from sensors.plain_writing import write

if TYPE_CHECKING:
    from evaluation.bench import Section

DEMO_SOURCE: Final = "course:perceptions"
RESULTS: Final = Path("results")
RUN_RRD: Final = "run.rrd"
DETECTIONS_PNG: Final = "detections.png"
LOCALIZATION_PNG: Final = "localization.png"
_SURE_ABOVE: Final = 0.95
_NUM_SHOWN: Final = 6


def run(
    source: str,
    output: Path | None,
    settings_file: Path | None,
    assignments: Sequence[str],
    live: Path | None = None,
) -> None:
    """Runs a source, writes its results, and prints what came out.

    `live` is a settings file that is looked at between scans.

    Raises:
        SemgraphError: anything that a user can put right.
    """
    console = Console(soft_wrap=True)
    settings = load_settings(settings_file, assignments)
    with console.status(f"reading {source}"):
        opened = open_source(source, settings.source)
    folder = output or staging.new_results_folder(RESULTS, datetime.now().astimezone())
    perceiver, trace = Perceiver(opened.recording, settings, live), Trace()
    effective = _effective(source, settings, perceiver)
    with results.staged_results(folder) as staged:
        recording = opened.recording
        with progress(console, recording.name, recording.num_scans) as report:
            result = pipeline.run(recording, settings, perceiver, report, effective, trace)
        results.write_files(result, staged)
        write_truth(staged, opened.truth)
        viewer.write_recording(result, staged / RUN_RRD, trace.instants)
        metrics = evaluate_folder(staged)
    unlinked = staging.point_latest(folder) if output is None else None
    _print_comparison(console, metrics)
    _print_next(console, folder, unlinked)


def localize(
    source: str,
    map_file: Path,
    output: Path | None,
    settings_file: Path | None,
    assignments: Sequence[str],
    *,
    pose: Sequence[float] | None = None,
    circle: Sequence[float] | None = None,
) -> None:
    """Finds and follows the robot of a source in a known map, writes and prints what came out.

    Raises:
        SemgraphError: anything that a user can put right.
    """
    from evaluation.figures import draw_localization

    console = Console(soft_wrap=True)
    settings = load_settings(settings_file, assignments)
    with console.status(f"reading {source} and {map_file}"):
        opened = open_source(source, settings.source)
        landmarks = read_given_map(map_file, settings.localizer.listed_sigma_m)
    folder = output or staging.new_results_folder(RESULTS, datetime.now().astimezone())
    perceiver, recording = Perceiver(opened.recording, settings), opened.recording
    effective = _effective(source, settings, perceiver)
    start = start_of(pose, circle)
    with results.staged_results(folder) as staged:
        with progress(console, recording.name, recording.num_scans) as report:
            result = localization.localize(
                recording, landmarks, start, settings, perceiver, report, effective
            )
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


def simulate(source: str, folder: Path, assignments: Sequence[str]) -> None:
    """Writes a source, a simulated course say, as a plain recording folder; prints what it is.

    Raises:
        SemgraphError: no such source or option, or the folder holds something already.
    """
    console = Console(soft_wrap=True)
    settings = load_settings(None, assignments)
    with console.status(f"simulating {source}"):
        opened = open_source(source, settings.source)
        write(opened, folder)
    console.print(f"{folder}: {opened.recording.num_scans} scans or images of {source}")


def demo(output: Path | None) -> None:
    """The paper's simulated course, end to end."""
    run(DEMO_SOURCE, output, None, [])


def evaluate(folder: Path) -> None:
    """Prints and writes the metrics of a run again, from its files."""
    console = Console(soft_wrap=True)
    with console.status(f"judging {folder}"):
        metrics = evaluate_folder(folder)
    table = Table("metric", "value", "unit", "better")
    for row in table_rows(metrics):
        table.add_row(*row)
    console.print(table)


def compare(first: Path, second: Path) -> None:
    """Prints how far apart the smoothed trajectories of two runs of one recording are."""
    one, other = results.read(first), results.read(second)
    difference_m = trajectory_difference(one.smoothed, other.smoothed)
    Console(soft_wrap=True).print(
        f"smoothed trajectories, rigidly aligned, RMSE of the difference: {difference_m:.3f} m; "
        f"landmarks: {len(one.landmarks)} and {len(other.landmarks)}"
    )


def view(folder: Path) -> None:
    """Opens a run in Rerun."""
    viewer.open_viewer(folder / RUN_RRD)


def detect(
    source: str, output: Path | None, settings_file: Path | None, assignments: Sequence[str]
) -> None:
    """Writes, draws and counts what the detectors find in a source of raw measurements.

    Raises:
        SemgraphError: anything that a user can put right.
    """
    from evaluation.figures import draw_detections

    console = Console(soft_wrap=True)
    settings = load_settings(settings_file, assignments)
    with console.status(f"reading {source}"):
        recording = open_source(source, settings.source).recording
    folder = output or staging.new_results_folder(RESULTS, datetime.now().astimezone())
    efforts = Efforts()
    perceiver = Perceiver(recording, settings, observe=efforts)
    with staging.staged_folder(folder, DETECTIONS_PNG) as staged:
        with progress(console, recording.name, recording.num_scans) as report:
            file = staged / PERCEPTIONS_FILE
            seen = write_detections(recording, perceiver, file, report, _NUM_SHOWN)
        draw_detections(recording.name, seen, staged / DETECTIONS_PNG)
        results.write_settings(staged, _effective(source, settings, perceiver))
    _print_efforts(console, efforts.table(), perceiver.bank.faults)
    console.print(f"written: {folder}, look at {folder / DETECTIONS_PNG}")


def bench_detectors(seeds: Sequence[int], output: Path | None, data: Path | None) -> None:
    """Measures the detectors' figures, prints and writes them beside their targets."""
    from evaluation.bench_detectors import SECTIONS, car_park

    _bench("detectors", (*SECTIONS, car_park(data)), seeds, output)


def bench_graph(seeds: Sequence[int], output: Path | None) -> None:
    """Measures the graph's figures beside the oracle's, prints and writes them."""
    from evaluation.bench_graph import SECTIONS

    _bench("graph", SECTIONS, seeds, output)


def bench_localization(seeds: Sequence[int], output: Path | None, data: Path | None) -> None:
    """Measures localization in known maps, prints and writes the figures."""
    from evaluation.bench_localization import sections

    _bench("localization", sections(data), seeds, output)


def _bench(
    name: str, sections: Sequence["Section"], seeds: Sequence[int], output: Path | None
) -> None:
    from evaluation.bench import bench

    folder = output or staging.new_results_folder(RESULTS, datetime.now().astimezone())
    console = Console(soft_wrap=True)
    bench(console, name, sections, seeds, folder)
    console.print(f"written: {folder}")


def _effective(source: str, settings: Settings, perceiver: Perceiver) -> dict[str, Any]:
    """All settings as they hold, defaults included."""
    effective = settings.model_dump(mode="json")
    options = source_options(source).model_validate(settings.source)
    effective["source"] = options.model_dump(mode="json", exclude_none=True)
    effective["filters"] = [each.model_dump(mode="json") for each in perceiver.filters]
    effective["detectors"] = perceiver.bank.effective()
    return effective


def _print_efforts(console: Console, efforts: Sequence[Effort], faults: Sequence[str]) -> None:
    table = Table("detector", "looked at", "perceptions", "mean", "CPU median", "CPU p99")
    table.columns[0].no_wrap = True
    for each in efforts:
        table.add_row(
            each.detector,
            str(each.num_measurements),
            str(each.num_perceptions),
            f"{each.mean_perceptions:.2f}",
            f"{each.median_ms:.2f} ms",
            f"{each.p99_ms:.2f} ms",
        )
    console.print(table)
    for fault in faults:
        console.print(fault)


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
        console.print(f"found after {seconds:.1f} s, at {sure[0].map_T_base.pose}")
    errors = {metric.name: metric.value for metric in metrics}
    if "trajectory_rmse_unaligned_m" in errors:
        fast_rmse = errors.get("fast_trajectory_rmse_unaligned_m")
        alone = "" if fast_rmse is None else f" (fast estimator alone {fast_rmse:.3f} m)"
        rmse_m = errors["trajectory_rmse_unaligned_m"]
        console.print(f"RMSE in the map's frame, all poses: {rmse_m:.3f} m{alone}")


_COMPARED: Final = (
    ("trajectory, rigidly aligned, RMSE", "trajectory_rmse_m"),
    ("trajectory, rigidly aligned, median", "trajectory_median_m"),
    ("trajectory, first pose on the first, RMSE", "trajectory_rmse_origin_m"),
    ("map, RMSE", "map_rmse_m"),
)


def _print_comparison(console: Console, metrics: Sequence[Metric]) -> None:
    """One table: the fast estimator and the graph side by side."""
    values = {metric.name: metric.value for metric in metrics}
    table = Table("error in m", "fast", "smoothed")
    for label, name in _COMPARED:
        if name in values:
            fast = values.get(f"fast_{name}")
            table.add_row(label, "" if fast is None else f"{fast:.3f}", f"{values[name]:.3f}")
    if table.row_count:
        console.print(table)
    else:
        console.print("no truth to compare with: see the map")
    counts = [
        f"{values[name]:.0f} {label}"
        for label, name in (
            ("landmarks", "landmarks_confirmed"),
            ("missed", "landmarks_missed"),
            ("twice", "landmarks_duplicate"),
            ("loop closures", "num_loop_closures"),
        )
        if name in values
    ]
    console.print(", ".join(counts))


def _print_next(console: Console, folder: Path, unlinked: str | None) -> None:
    if unlinked is not None:
        console.print(f"results/latest could not be set: {unlinked}")
    console.print(f"results: {folder}")
    console.print(f"look at: {folder / 'map.png'} and {folder / 'errors.png'}")
    console.print(f"next:    semgraph view {folder}    semgraph evaluate {folder}")
    console.print("         semgraph run FOLDER, a recording of your own (README: your own data)")
