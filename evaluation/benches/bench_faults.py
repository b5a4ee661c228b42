"""Ten thousand faults: whether a run is lost, and whether one that says nothing changes it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from evaluation.benches.bench import Section
from evaluation.benches.bench_runs import run_source
from evaluation.benches.bench_table import Better, Row
from evaluation.benches.bench_workers import each_seed
from evaluation.benches.faults import FAULTS, Fault, WheelFault, inject
from semgraph.results import RunResult
from sensors.catalog import open_source
from sensors.truth import Source

NUM_FAULTS: Final = 10_000
_FAULTS_A_BATCH: Final = 200
# So many runs hold them, about.
_RUNS_A_BATCH: Final = 5
_SHARE: Final = 0.5
_SAME_M: Final = 1e-3
_SHORT: Final = {"track_radius_m": 8.0, "num_trees": 30, "lap_s": 8.0, "overlap_s": 2.0}


@dataclass(frozen=True, slots=True)
class Struck:
    """A run with faults of one kind.

    Attributes:
        name: of the fault.
        num_faults: how many.
        lost: what ended the run; empty where nothing did.
        change_m: of the farthest pose, beside the run without; NaN where a fault may change it.
    """

    name: str
    num_faults: int
    lost: str
    change_m: float


def strike(source: Source, sound: RunResult, fault: Fault, rng: np.random.Generator) -> Struck:
    """A run over a source with a fault in half of what it concerns."""
    measurements, count = inject(tuple(source.recording.measurements), fault, _SHARE, rng)
    faulty = Source(replace(source.recording, measurements=measurements), source.truth)
    try:
        result = run_source(faulty)
    except Exception as error:  # noqa: BLE001 - whatever ends a run is the figure
        return Struck(fault.name, count, f"{type(error).__name__}: {error}", np.nan)
    lost = "" if np.isfinite(result.smoothed.map_T_bases).all() else "poses that are not finite"
    return Struck(
        fault.name, count, lost, _change_m(result, sound) if fault.says_nothing else np.nan
    )


def _change_m(result: RunResult, sound: RunResult) -> float:
    """Infinite where poses are missing or the map has more or fewer landmarks."""
    one, other = sound.smoothed, result.smoothed
    _, rows, other_rows = np.intersect1d(one.stamps_ns, other.stamps_ns, return_indices=True)
    if len(rows) < len(one) or len(result.landmarks) != len(sound.landmarks):
        return np.inf
    apart = one.map_T_bases[rows, :2] - other.map_T_bases[other_rows, :2]
    return float(np.linalg.norm(apart, axis=1).max())


def strikes(case: tuple[int, int]) -> list[Struck]:
    """Runs on the course of a seed until a batch of faults is in; each batch has its own kinds."""
    seed, batch = case
    rng = np.random.default_rng([seed, batch])
    sources = {odometry: _course(seed, odometry=odometry) for odometry in (False, True)}
    sound = {odometry: run_source(source) for odometry, source in sources.items()}
    struck: list[Struck] = []
    turn = batch * _RUNS_A_BATCH
    while sum(each.num_faults for each in struck) < _FAULTS_A_BATCH:
        fault = FAULTS[turn % len(FAULTS)]
        has_wheels = isinstance(fault, WheelFault) or bool(turn // len(FAULTS) % 2)
        struck.append(strike(sources[has_wheels], sound[has_wheels], fault, rng))
        turn += 1
    return struck


def _course(seed: int, *, odometry: bool) -> Source:
    return open_source("course:perceptions", {**_SHORT, "seed": seed, "odometry": odometry})


def faults(seeds: Sequence[int]) -> list[Row]:
    """Ten thousand, in batches that the seeds take in turn."""
    batches = range(NUM_FAULTS // _FAULTS_A_BATCH)
    cases = [(seeds[batch % len(seeds)], batch) for batch in batches]
    return rows([each for struck in each_seed(strikes, cases) for each in struck])


def rows(struck: Sequence[Struck]) -> list[Row]:
    """How many faults, which kinds end a run, and which change it though they say nothing."""
    lost = [each for each in struck if each.lost]
    changes_m = np.array([each.change_m for each in struck])
    changed = [each for each, change in zip(struck, changes_m, strict=True) if change > _SAME_M]
    worst_m = float(np.nanmax(changes_m)) if np.isfinite(changes_m).any() else np.nan
    count = sum(each.num_faults for each in struck)
    return [
        Row("faults injected", count, "", Better.HIGHER, NUM_FAULTS),
        Row(f"runs lost{_named(lost)}", len(lost), "", Better.LOWER, 0.0),
        Row(
            f"largest change by what says nothing{_named(changed)}",
            worst_m,
            "m",
            Better.LOWER,
            _SAME_M,
        ),
    ]


def _named(struck: Sequence[Struck]) -> str:
    names = sorted({each.name for each in struck})
    return f" ({', '.join(names)})" if names else ""


SECTION: Final = Section("faults", (faults,), 1.6)
