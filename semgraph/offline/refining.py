"""Refines runs together, and writes what came out."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from semgraph.errors import InputError
from semgraph.estimates import Trajectory
from semgraph.files.map_files import write_map_csv, write_map_json
from semgraph.files.run_log import LOG_NPZ, RunLog, read_log
from semgraph.files.tables import write_text
from semgraph.files.trajectory_files import write_covariances, write_tum
from semgraph.geometry import Pose2
from semgraph.graph.smoother import SmootherSettings
from semgraph.offline.batch import Batch, Belief
from semgraph.offline.map_changes import Change, Fate, changes
from semgraph.offline.map_update import update_map
from semgraph.offline.prior_map import PriorMap
from semgraph.offline.refinement import Refined, refine, refined
from semgraph.offline.sessions import join
from semgraph.results import MAP_CSV, MAP_JSON, RUN_JSON

REFINED_JSON: Final = "refined.json"
REPORT_CSV: Final = "report.csv"
REPORT_TXT: Final = "report.txt"
_COLUMNS: Final = (
    *("fate", "kind", "prior", "landmark", "x_m", "y_m", "moved_m", "moved_chi2"),
    *("looks", "log_odds"),
)
_MAX_LINES: Final = 30


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """What came of all sessions together.

    Attributes:
        names: of the sessions.
        refined: the optimum.
        trajectories: of each session.
        changes: of the prior map; None without one.
    """

    names: tuple[str, ...]
    refined: Refined
    trajectories: tuple[Trajectory, ...]
    changes: tuple[Change, ...] | None


def is_run(folder: Path) -> bool:
    """Whether a folder holds the results of a run."""
    return (folder / RUN_JSON).is_file()


def log_of_run(folder: Path) -> RunLog:
    """What a run measured.

    Raises:
        InputError: it has no log, or one that is damaged.
    """
    if not (folder / LOG_NPZ).is_file():
        raise InputError(f"{folder}: expected {LOG_NPZ}, there is none; run the recording again")
    return read_log(folder / LOG_NPZ)


def refine_sessions(
    sessions: Sequence[tuple[str, RunLog]],
    settings: SmootherSettings,
    prior: PriorMap | None,
    map_T_start: Pose2 | None,
    note: Callable[[str], None],
) -> Refinement:
    """All sessions in one batch, in the frame of the prior map if there is one.

    Args:
        sessions: names and logs.
        settings: of the graph.
        prior: a map from before.
        map_T_start: where the first session starts in it; None where both have one frame.
        note: told what is being done.

    Raises:
        InputError: a session shares no landmarks with those before.
        GraphError: the batch cannot be solved.
    """
    each = [_alone(name, log, settings, note) for name, log in sessions]
    result = each[0]
    if len(each) > 1:
        joined = join(each)
        belief, rounds = refine(joined.batch, joined.belief, settings, note)
        result = refined(joined.batch, belief, settings, rounds)
    fates = None
    if prior is not None:
        start = sessions[0][1].start.pose
        prior_T_map = Pose2() if map_T_start is None else map_T_start @ start.inverse()
        result = update_map(result, prior, settings, note, prior_T_map)
        note("what became of the prior map")
        fates = changes(result.batch, result.belief, result.landmarks, result.tentative, prior)
    names = tuple(name for name, _ in sessions)
    return Refinement(names, result, _trajectories(result), fates)


def write_refinement(refinement: Refinement, folder: Path) -> None:
    """Writes the map, the trajectories, and the report into a folder that is there.

    Raises:
        SemgraphError: a file cannot be written.
    """
    result = refinement.refined
    write_map_json(folder / MAP_JSON, result.landmarks)
    write_map_csv(folder / MAP_CSV, result.landmarks)
    for number, trajectory in enumerate(refinement.trajectories):
        end = f"_{number + 1}" if number else ""
        scans = result.batch.session(number)
        write_tum(folder / f"trajectory{end}.tum", trajectory)
        covariances = result.pose_covariances[scans]
        write_covariances(folder / f"trajectory_covariance{end}.csv", trajectory, covariances)
    if refinement.changes is not None:
        write_changes(folder / REPORT_CSV, refinement.changes)
    write_text(folder / REPORT_TXT, "\n".join(report(refinement)) + "\n")
    told = {
        "sessions": list(refinement.names),
        "num_scans": [len(trajectory) for trajectory in refinement.trajectories],
        "num_landmarks": len(result.landmarks),
        "associations_changed": list(result.changes),
        "is_settled": result.is_settled,
        "cost": result.cost,
    }
    write_text(folder / REFINED_JSON, json.dumps(told, indent=1) + "\n")


def write_changes(path: Path, changed: Sequence[Change]) -> None:
    """Writes what became of a map, a line each.

    Raises:
        SemgraphError: the file cannot be written.
    """
    rows = [",".join(_cells(change)) for change in changed]
    write_text(path, "\n".join([",".join(_COLUMNS), *rows]) + "\n")


def report(refinement: Refinement) -> list[str]:
    """What came out, for people: lines."""
    result = refinement.refined
    rounds = ", ".join(str(count) for count in result.changes)
    assigned = result.belief.assigned()
    lines = [
        f"{', '.join(refinement.names)}: {len(result.batch)} scans, "
        f"{int(assigned.sum())} of {len(assigned)} perceptions of {len(result.landmarks)} "
        "landmarks in the map",
        f"associations changed in each round: {rounds}"
        + ("" if result.is_settled else "; stopped before nothing changed any more"),
        f"cost at the optimum: {result.cost:.1f}",
    ]
    if refinement.changes is None:
        return lines
    lines.append(counts_of(refinement.changes))
    told = [_line(each) for each in refinement.changes if each.fate not in _UNTOLD]
    lines += told[:_MAX_LINES]
    if len(told) > _MAX_LINES:
        lines.append(f"and {len(told) - _MAX_LINES} more: {REPORT_CSV}")
    return lines


def counts_of(changed: Sequence[Change]) -> str:
    """How many landmarks had which fate."""
    counts = {
        fate: sum(change.fate is fate for change in changed)
        for fate in (Fate.KEPT, Fate.MOVED, Fate.GONE, Fate.UNSURE, Fate.NOT_VISITED, Fate.ADDED)
    }
    return ", ".join(f"{count} {fate.value}" for fate, count in counts.items())


_UNTOLD: Final = (Fate.KEPT, Fate.NOT_VISITED)


def _alone(
    name: str, log: RunLog, settings: SmootherSettings, note: Callable[[str], None]
) -> Refined:
    batch = Batch.of(log)
    begin = Belief(log.trajectory.map_T_bases, log.landmarks, {})
    belief, rounds = refine(batch, begin, settings, lambda text: note(f"{name}: {text}"))
    note(f"{name}: covariances")
    return refined(batch, belief, settings, rounds)


def _trajectories(result: Refined) -> tuple[Trajectory, ...]:
    sessions = [result.batch.session(k) for k in range(len(result.batch.firsts))]
    return tuple(
        Trajectory(result.batch.stamps_ns[scans], result.belief.map_T_bases[scans])
        for scans in sessions
    )


def _cells(change: Change) -> list[str]:
    """One row of the report; what is unknown is an empty cell."""
    x, y = change.map_t_landmark.tolist()
    numbers = (x, y, change.moved_m, change.significance)
    return [
        change.fate.value,
        change.kind.label,
        change.prior,
        str(change.landmark) if change.landmark >= 0 else "",
        *("" if np.isnan(value) else repr(value) for value in numbers),
        str(change.looks),
        f"{change.log_odds:.3f}",
    ]


def _line(change: Change) -> str:
    x, y = change.map_t_landmark.tolist()
    where = f"{change.fate.value}: {change.kind.label} at ({x:.2f}, {y:.2f}) m"
    if change.fate is Fate.ADDED:
        return f"{where}, landmark {change.landmark}, sighted {change.looks} times"
    where += f", {change.prior} of the prior map"
    if change.fate is Fate.MOVED:
        return f"{where}, moved by {change.moved_m:.2f} m, chi2 {change.significance:.1f}"
    return f"{where}, {change.looks} looks in vain, log odds of being there {change.log_odds:.1f}"
