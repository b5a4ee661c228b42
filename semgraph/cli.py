"""The command line. Each command imports what it needs when it is called."""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from semgraph.command_line.argument_types import DATA, AddParser, positive, seeds, sigma
from semgraph.command_line.baseline_command import add_baseline, call_baseline
from semgraph.command_line.bench_all_command import add_bench_all, call_bench_all
from semgraph.command_line.report_command import add_report, call_report
from semgraph.command_line.study_arguments import add_study, call_study
from semgraph.errors import SemgraphError

_SOURCES = """\
sources:
  course:paper            the paper's round course from laser scans (--set seed=1, odometry=true)
  course:forest           a dense stand on uneven ground (person=true, felled=true, stem_map=FILE)
  course:eight            a figure of eight through a real stand (stem_map=FILE)
  course:lanes            a wood driven lane by lane (--set length_m=2000)
  course:rocks            rocks on rough ground, by a depth camera (--set rock_share=0.05)
  course:car-park         reflecting posts, by a laser; course:markers: AprilTags, by a camera
  course:perceptions      the paper's with perceptions ready made (--set clutter=1)
  victoria-park-graph     the graph that the gtsam wheel carries (--set identities=true)
  FOLDER                  a recording, recognised by what lies in it: a plain recording folder,
                          car park, Victoria Park, MRCLAM (--set robot=1), Wild-Places
  NAME:FOLDER             the same, by name
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit status: 0, 1 after a known error told in one line, 2 for wrong usage."""
    parser = _parser()
    parsed = parser.parse_args(arguments)
    if parsed.command == "run" and not parsed.online and parsed.speed != math.inf:
        parser.error("--speed X: expected --online with it")
    try:
        _call(parsed)
    except SemgraphError as error:
        print(f"semgraph: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"semgraph: interrupted; {_left_by(parsed.command)}", file=sys.stderr)
        return 130
    return 0


def _left_by(command: str) -> str:
    """What an interrupted command leaves behind."""
    if command == "study":
        return "finished trials are kept, the same command goes on"
    return "nothing was written"


def _call(parsed: argparse.Namespace) -> None:
    own = {
        "localize": _call_localize,
        "bench": _call_bench,
        "refine": _call_refine,
        "study": call_study,
        "report": call_report,
        "baseline": call_baseline,
    }
    if parsed.command in own:
        own[parsed.command](parsed)
        return
    from semgraph.command_line import commands

    match parsed.command:
        case "demo":
            commands.demo(parsed.output)
        case "run":
            commands.run(
                parsed.source,
                parsed.output,
                parsed.settings,
                parsed.set,
                parsed.live,
                parsed.speed if parsed.online else None,
            )
        case "detect":
            commands.detect(parsed.source, parsed.output, parsed.settings, parsed.set)
        case "simulate":
            commands.simulate(parsed.source, parsed.folder, parsed.set)
        case _:
            _look_at_results(parsed)


def _look_at_results(parsed: argparse.Namespace) -> None:
    from semgraph.command_line import commands

    match parsed.command:
        case "evaluate":
            commands.evaluate(parsed.folder)
        case "explain":
            commands.explain(parsed.folder, parsed.landmark)
        case "compare":
            commands.compare(parsed.first, parsed.second)
        case "view":
            commands.view(parsed.folder)


def _call_localize(parsed: argparse.Namespace) -> None:
    from semgraph.command_line.localize_command import localize

    localize(
        parsed.source,
        parsed.map,
        parsed.output,
        parsed.settings,
        parsed.set,
        pose=parsed.start,
        circle=parsed.radius,
        grows=parsed.grow,
    )


def _call_bench(parsed: argparse.Namespace) -> None:
    if parsed.bench in ("all", None):
        call_bench_all(parsed)
        return
    from semgraph.command_line import commands

    match parsed.bench:
        case "graph":
            commands.bench_graph(parsed.seeds, parsed.output, parsed.data, parsed.only)
        case "online":
            commands.bench_online(parsed.seeds, parsed.output)
        case "constellation":
            commands.bench_constellation(parsed.seeds, parsed.output)
        case "refine":
            commands.bench_refine(parsed.seeds, parsed.output)
        case "localization":
            commands.bench_localization(parsed.seeds, parsed.output, parsed.data, parsed.only)
        case "detectors":
            commands.bench_detectors(parsed.seeds, parsed.output, parsed.data)


def _call_refine(parsed: argparse.Namespace) -> None:
    from semgraph.command_line import commands
    from semgraph.geometry import pose_in_degrees

    commands.refine(
        parsed.sources,
        parsed.output,
        parsed.map,
        parsed.map_sigma,
        pose_in_degrees(*parsed.start) if parsed.start is not None else None,
        parsed.settings,
        parsed.set,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="semgraph",
        description="Landmark SLAM: trees, rocks and markers in, trajectory and map out.",
        epilog="Start with: semgraph demo",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="run the paper's course, with nothing to prepare")
    _add_output(demo)
    _add_run(commands.add_parser)
    _add_localize(commands.add_parser)
    _add_with_source(
        commands.add_parser, "detect", "write and draw what the detectors find in raw measurements"
    )
    _add_simulate(commands.add_parser)
    _add_looks(commands.add_parser)
    _add_refine(commands.add_parser)
    _add_bench(commands.add_parser)
    add_study(commands.add_parser)
    add_report(commands.add_parser)
    add_baseline(commands.add_parser)
    return parser


def _add_run(add_parser: AddParser) -> None:
    run = _add_with_source(add_parser, "run", "run a recording or a course")
    run.add_argument(
        "--live",
        type=Path,
        metavar="FILE",
        help="settings whose filters and detectors may be changed while the run goes on",
    )
    run.add_argument(
        "--online",
        action="store_true",
        help="the graph in a process of its own, that corrects the fast pose and never holds it up",
    )
    run.add_argument(
        "--speed",
        type=positive,
        default=math.inf,
        metavar="X",
        help="play the recording at X times real time (default: as fast as it goes)",
    )


def _add_simulate(add_parser: AddParser) -> None:
    simulate = add_parser(
        "simulate",
        help="write a simulated course as a plain recording folder",
        epilog=_SOURCES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    simulate.add_argument("source", metavar="SOURCE", help="a name, see below")
    simulate.add_argument("folder", type=Path, metavar="DIR", help="new or empty")
    _add_set(simulate, "one option of the course, e.g. seed=1")


def _add_looks(add_parser: AddParser) -> None:
    """Commands that look at the results of runs."""
    for name, what in (
        ("evaluate", "print and write the metrics of a run again"),
        ("view", "open a run in Rerun"),
    ):
        command = add_parser(name, help=what)
        command.add_argument("folder", type=Path, metavar="DIR", help="the results of a run")
    explain = add_parser("explain", help="what a run decided of its landmarks, and why")
    explain.add_argument("folder", type=Path, metavar="DIR", help="the results of a run")
    explain.add_argument(
        "--landmark", type=int, metavar="N", help="the story of one, by its id in map.csv"
    )
    compare = add_parser("compare", help="how far two runs of one recording are apart")
    compare.add_argument("first", type=Path, metavar="DIR", help="the results of a run")
    compare.add_argument("second", type=Path, metavar="DIR", help="the results of another")


def _add_localize(add_parser: AddParser) -> None:
    localize = _add_with_source(add_parser, "localize", "find and follow the robot in a known map")
    localize.add_argument(
        "--map",
        type=Path,
        required=True,
        metavar="MAP",
        help="map.json or map.csv of a run, its folder, or a list x_m,y_m,kind,diameter_m",
    )
    start = localize.add_mutually_exclusive_group()
    start.add_argument(
        "--start", type=float, nargs=3, metavar=("X", "Y", "YAW"), help="m and degrees, in the map"
    )
    start.add_argument(
        "--radius", type=float, nargs=3, metavar=("M", "X", "Y"), help="within M of a point"
    )
    localize.add_argument(
        "--grow", action="store_true", help="refine the map by what is seen, and add what is new"
    )


def _add_with_source(add_parser: AddParser, name: str, what: str) -> argparse.ArgumentParser:
    """A command that reads a source and takes settings."""
    command = add_parser(
        name,
        help=what,
        epilog=_SOURCES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument("source", metavar="SOURCE", help="a folder or a name, see below")
    _add_output(command)
    command.add_argument("--settings", type=Path, metavar="FILE", help="settings in TOML")
    _add_set(
        command, "one setting, e.g. fast.search_radius_m=0.8; without a section: of the source"
    )
    return command


def _add_refine(add_parser: AddParser) -> None:
    refine = add_parser("refine", help="all measurements of runs at once, offline, robustly")
    refine.add_argument(
        "sources",
        nargs="+",
        metavar="RECORDING|DIR",
        help="recordings, or results of runs, of one place; each starts where the first does",
    )
    refine.add_argument(
        "--map",
        type=Path,
        metavar="PRIOR",
        help="from before: results, map.json, map.csv, or a table x,y or x,y,diameter",
    )
    refine.add_argument(
        "--map-sigma",
        type=sigma,
        default=0.5,
        metavar="M",
        help="of one axis, for a table (default: 0.5)",
    )
    refine.add_argument(
        "--start",
        type=float,
        nargs=3,
        metavar=("X", "Y", "YAW"),
        help="m and degrees, where the first session starts in PRIOR, to about a metre and six "
        "degrees (default: as it says)",
    )
    _add_output(refine)
    refine.add_argument("--settings", type=Path, metavar="FILE", help="settings in TOML")
    _add_set(refine, "one setting, as of semgraph run")


def _add_bench(add_parser: AddParser) -> None:
    bench = add_parser("bench", help="measure figures of detectors and graph, and their targets")
    benches = bench.add_subparsers(dest="bench", metavar="WHAT")
    add_bench_all(benches.add_parser)
    detectors = benches.add_parser("detectors", help="on simulated measurements and whole runs")
    _add_seeds(detectors, range(101, 125), "up to an hour")
    detectors.add_argument(
        "--data", type=Path, metavar="DIR", help="real recordings, with the folder car_park"
    )
    _add_output(detectors)
    graph = benches.add_parser("graph", help="beside the optimum with true associations")
    _add_seeds(graph, range(1, 51), "some hours")
    _add_data(graph, "; `long` is measured only if asked for")
    _add_output(graph)
    localization = benches.add_parser("localization", help="in known maps, given and real")
    _add_seeds(localization, range(1, 101), "up to an hour")
    _add_data(localization)
    _add_output(localization)
    online = benches.add_parser("online", help="of the graph in a process of its own, in real time")
    _add_seeds(online, range(1, 4), "some minutes")
    _add_output(online)
    refine = benches.add_parser("refine", help="beside the batch optimum, and with a prior map")
    _add_seeds(refine, range(101, 113), "some minutes")
    _add_output(refine)
    recognition = benches.add_parser("constellation", help="where groups of landmarks stand")
    _add_seeds(recognition, range(1, 11), "some minutes")
    _add_output(recognition)


def _add_data(parser: argparse.ArgumentParser, more: str = "") -> None:
    parser.add_argument(
        "--data",
        type=Path,
        default=DATA,
        metavar="DIR",
        help=f"the real recordings and stem maps (default: {DATA})",
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="NAME",
        help=f"sections that begin with this, may be repeated{more}",
    )


def _add_seeds(parser: argparse.ArgumentParser, default: range, takes: str) -> None:
    parser.add_argument(
        "--seeds",
        type=seeds,
        default=default,
        metavar="A-B",
        help=f"of the simulated worlds (default: {default[0]}-{default[-1]}, {takes})",
    )


def _add_set(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=what)


def _add_output(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="where to write (default: results/<time>)"
    )


if __name__ == "__main__":
    sys.exit(main())
