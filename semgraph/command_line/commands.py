"""What the commands do: the file that brings sources, detectors, pipeline and judge together."""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rich.console import Console
from rich.table import Table

from evaluation.metrics import Metric
from evaluation.report import evaluate_folder, table_rows
from evaluation.trajectory import compare_path, rmse, trajectory_difference
from evaluation.truth_files import read_truth, write_truth
from semgraph import pipeline, results, viewer
from semgraph.beside.online import OnlineSmoother
from semgraph.command_line import explaining
from semgraph.command_line.terminal import terminal
from semgraph.detecting import Effort, Efforts, write_detections
from semgraph.errors import InputError, SemgraphError
from semgraph.estimates import Trajectory
from semgraph.files import staging
from semgraph.files.run_log import RunLog
from semgraph.geometry import Pose2
from semgraph.offline import refining
from semgraph.offline.prior_map import read_prior_map
from semgraph.pacing import Pace
from semgraph.perceiving import Perceiver
from semgraph.progress import progress
from semgraph.settings import Settings, load_settings
from semgraph.trace import Trace
from sensors.catalog import open_source, source_options
from sensors.measurements import Recording
from sensors.plain_perceptions import PERCEPTIONS_FILE
from sensors.plain_writing import write
from sensors.truth import Truth

if TYPE_CHECKING:
    from evaluation.benches.bench import Section

DEMO_SOURCE: Final = "course:perceptions"
RESULTS: Final = Path("results")
RUN_RRD: Final = "run.rrd"
DETECTIONS_PNG: Final = "detections.png"
REFINED_PNG: Final = "refined.png"
_NUM_SHOWN: Final = 6


def run(
    source: str,
    output: Path | None,
    settings_file: Path | None,
    assignments: Sequence[str],
    live: Path | None = None,
    online_speed: float | None = None,
) -> None:
    """Runs a source, writes its results, and prints what came out.

    `live` is a settings file that is looked at between scans. With `online_speed` the graph is in
    a process of its own, and the recording is played so many times as fast as it was made.

    Raises:
        SemgraphError: anything that a user can put right; the graph was lost on the way (then the
            results are written without it).
    """
    console = terminal()
    settings = load_settings(settings_file, assignments)
    with console.status(f"reading {source}"):
        opened = open_source(source, settings.source)
    folder = output or staging.new_results_folder(RESULTS, datetime.now().astimezone())
    perceiver, trace = Perceiver(opened.recording, settings, live), Trace()
    effective = effective_settings(source, settings, perceiver)
    recording = opened.recording
    pace = None if online_speed is None else Pace(online_speed)
    with (
        results.staged_results(folder) as staged,
        _online(pace, recording, settings) as graph,
    ):
        with progress(console, recording.name, recording.num_scans) as report:
            result = pipeline.run(
                recording, settings, perceiver, report, effective, trace, graph, pace
            )
        results.write_files(result, staged)
        write_truth(staged, opened.truth)
        viewer.write_recording(result, staged / RUN_RRD, trace.instants)
        metrics = evaluate_folder(staged)
    unlinked = staging.point_latest(folder) if output is None else None
    _print_comparison(console, metrics)
    if result.online is not None:
        console.print(result.online.summary)
    _print_next(console, folder, unlinked)
    if result.online is not None and result.online.lost:
        raise SemgraphError(
            f"graph given up: {result.online.lost}; the fast estimate stands, see {folder}"
        )


def _online(
    pace: Pace | None, recording: Recording, settings: Settings
) -> AbstractContextManager[OnlineSmoother | None]:
    """The graph in a process of its own, where that is asked for."""
    if pace is None:
        return nullcontext()
    return OnlineSmoother(settings.smoother, settings.online, recording.map_T_start)


def simulate(source: str, folder: Path, assignments: Sequence[str]) -> None:
    """Writes a source, a simulated course say, as a plain recording folder; prints what it is.

    Raises:
        SemgraphError: no such source or option, or the folder holds something already.
    """
    console = terminal()
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
    console = terminal()
    with console.status(f"judging {folder}"):
        metrics = evaluate_folder(folder)
    table = Table("metric", "value", "unit", "better")
    for row in table_rows(metrics):
        table.add_row(*row)
    console.print(table)


def explain(folder: Path, landmark: int | None) -> None:
    """Prints what a run decided of its landmarks, when and why."""
    console = terminal()
    for line in explaining.explain(results.read(folder), landmark):
        console.print(line, highlight=False)


def compare(first: Path, second: Path) -> None:
    """Prints how far apart the smoothed trajectories of two runs of one recording are."""
    one, other = results.read(first), results.read(second)
    difference_m = trajectory_difference(one.smoothed, other.smoothed)
    terminal().print(
        f"smoothed trajectories, rigidly aligned, RMSE of the difference: {difference_m:.3f} m; "
        f"landmarks: {len(one.landmarks)} and {len(other.landmarks)}"
    )


def refine(
    sources: Sequence[str],
    output: Path | None,
    prior_file: Path | None,
    map_sigma_m: float,
    map_T_start: Pose2 | None,
    settings_file: Path | None,
    assignments: Sequence[str],
) -> None:
    """Refines runs, or recordings that are run first, in one batch; prints and writes the outcome.

    Raises:
        SemgraphError: anything that a user can put right.
    """
    from evaluation.figures.refinement import draw_refinement

    console = terminal()
    settings = load_settings(settings_file, assignments)
    prior = read_prior_map(prior_file, map_sigma_m) if prior_file is not None else None
    sessions = [_session(console, source, settings) for source in sources]
    folder = output or staging.new_results_folder(RESULTS, datetime.now().astimezone())
    logs = [(name, log) for name, log, _ in sessions]
    with staging.staged_folder(folder, refining.REFINED_JSON) as staged:
        with progress(console, "refining", len(sessions), "sessions") as report:
            refinement = refining.refine_sessions(
                logs, settings.smoother, prior, map_T_start, report.note
            )
        refining.write_refinement(refinement, staged)
        draw_refinement(refinement, staged / REFINED_PNG)
    for line in refining.report(refinement):
        console.print(line)
    for (name, log, truth), trajectory in zip(sessions, refinement.trajectories, strict=True):
        _print_gain(console, name, truth, log.trajectory, trajectory)
    console.print(f"written: {folder}, look at {folder / REFINED_PNG}")


def _session(console: Console, source: str, settings: Settings) -> tuple[str, RunLog, Truth]:
    """The log of a run's folder, or of a recording that is run now; its truth for judging."""
    if refining.is_run(Path(source)):
        return Path(source).name, refining.log_of_run(Path(source)), read_truth(Path(source))
    with console.status(f"reading {source}"):
        opened = open_source(source, settings.source)
    recording, perceiver = opened.recording, Perceiver(opened.recording, settings)
    with progress(console, recording.name, recording.num_scans) as report:
        result = pipeline.run(recording, settings, perceiver, report, {})
    if result.log is None:
        raise InputError(f"{source}: expected a log of its run, there is none")
    return recording.name, result.log, opened.truth


def _print_gain(
    console: Console, name: str, truth: Truth, run: Trajectory, refined: Trajectory
) -> None:
    """Both errors, where there is a true path."""
    if truth.path is None:
        return
    before, after = compare_path(run, truth.path), compare_path(refined, truth.path)
    if before is not None and after is not None:
        console.print(
            f"{name}: trajectory, rigidly aligned, RMSE {rmse(before.distances):.4f} m in the run, "
            f"{rmse(after.distances):.4f} m refined"
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

    console = terminal()
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
        results.write_settings(staged, effective_settings(source, settings, perceiver))
    _print_efforts(console, efforts.table(), perceiver.bank.faults)
    console.print(f"written: {folder}, look at {folder / DETECTIONS_PNG}")


def bench_detectors(seeds: Sequence[int], output: Path | None, data: Path | None) -> None:
    """Measures the detectors' figures, prints and writes them beside their targets."""
    from evaluation.benches.bench_detectors import SECTIONS, car_park

    _bench("detectors", (*SECTIONS, car_park(data)), seeds, output)


def bench_graph(seeds: Sequence[int], output: Path | None, data: Path, only: Sequence[str]) -> None:
    """Measures the graph's figures beside the oracle's, prints and writes them.

    Raises:
        InputError: no section begins with a name of `only`.
    """
    from evaluation.benches.bench import chosen
    from evaluation.benches.bench_graph import sections

    _bench("graph", chosen(sections(data), only), seeds, output)


def bench_online(seeds: Sequence[int], output: Path | None) -> None:
    """Measures what the graph beside it costs the scan path, prints and writes it."""
    from evaluation.benches.bench_online import SECTIONS

    _bench("online", SECTIONS, seeds, output)


def bench_constellation(seeds: Sequence[int], output: Path | None) -> None:
    """Measures how surely groups of landmarks are found in maps, prints and writes it."""
    from evaluation.benches.bench_constellation import SECTIONS

    _bench("constellation", SECTIONS, seeds, output)


def bench_refine(seeds: Sequence[int], output: Path | None) -> None:
    """Measures the figures of the offline refinement, prints and writes them."""
    from evaluation.benches.bench_refine import SECTIONS

    _bench("refine", SECTIONS, seeds, output)


def bench_localization(
    seeds: Sequence[int], output: Path | None, data: Path, only: Sequence[str]
) -> None:
    """Measures localization in known maps, prints and writes the figures.

    Raises:
        InputError: no section begins with a name of `only`.
    """
    from evaluation.benches.bench import chosen
    from evaluation.benches.bench_localization import sections

    _bench("localization", chosen(sections(data), only), seeds, output)


def _bench(
    name: str, sections: Sequence["Section"], seeds: Sequence[int], output: Path | None
) -> None:
    from evaluation.benches.bench import bench

    folder = output or staging.new_results_folder(RESULTS, datetime.now().astimezone())
    console = terminal()
    bench(console, name, sections, seeds, folder)
    console.print(f"written: {folder}")


def effective_settings(source: str, settings: Settings, perceiver: Perceiver) -> dict[str, Any]:
    """All settings as they hold, defaults included."""
    effective = settings.model_dump(mode="json", exclude_none=True)
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


_COMPARED: Final = (
    ("trajectory, rigidly aligned, RMSE", "trajectory_rmse_m"),
    ("trajectory, rigidly aligned, median", "trajectory_median_m"),
    ("trajectory, first pose on the first, RMSE", "trajectory_rmse_origin_m"),
    ("map, RMSE", "map_rmse_m"),
)


def _print_comparison(console: Console, metrics: Sequence[Metric]) -> None:
    """One table: the fast estimator, what the graph made of it in time, and in the end."""
    values = {metric.name: metric.value for metric in metrics}
    estimates = {"fast": "fast_", "online": "online_", "smoothed": ""}
    shown = {
        label: prefix
        for label, prefix in estimates.items()
        if any(f"{prefix}{name}" in values for _, name in _COMPARED)
    }
    table = Table("error in m", *shown)
    for label, name in _COMPARED:
        errors = [values.get(f"{prefix}{name}") for prefix in shown.values()]
        if any(error is not None for error in errors):
            table.add_row(label, *("" if error is None else f"{error:.3f}" for error in errors))
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
