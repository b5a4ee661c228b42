"""Faults are put in, counted, and judged by what they do to a run."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.benches import bench_faults
from evaluation.benches.bench_faults import Struck, rows, strike
from evaluation.benches.bench_runs import run_source
from evaluation.benches.faults import FAULTS, ScanFault, WheelFault, inject
from semgraph.landmarks import Perceptions
from semgraph.results import RunResult
from sensors.catalog import open_source
from sensors.measurements import WheelOdometry
from sensors.truth import Source
from tests.sensors.sources import same

TINY: dict[str, object] = {
    "seed": 1,
    "track_radius_m": 6.0,
    "num_trees": 20,
    "lap_s": 3.0,
    "overlap_s": 0.5,
    "odometry": True,
}


@pytest.fixture(scope="module")
def tiny() -> tuple[Source, RunResult]:
    source = open_source("course:perceptions", TINY)
    return source, run_source(source)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_kinds_of_faults_have_names_of_their_own() -> None:
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_strikes_the_share_that_it_is_to_and_never_the_start(
    tiny: tuple[Source, RunResult], fault: ScanFault | WheelFault
) -> None:
    sound = tuple(tiny[0].recording.measurements)
    struck, count = inject(sound, fault, 1.0, rng())
    concerned = [m for m in sound if isinstance(m, Perceptions | WheelOdometry)]
    kind = Perceptions if isinstance(fault, ScanFault) else WheelOdometry
    assert count == sum(isinstance(m, kind) for m in concerned) - 1
    assert same(struck[:2], list(sound[:2]))
    assert inject(sound, fault, 0.0, rng())[1] == 0


def test_what_the_types_refuse_leaves_the_sound_measurement() -> None:
    sound = tuple(open_source("course:perceptions", TINY).recording.measurements)
    refused = FAULTS[:12]
    assert {"range NaN", "covariance indefinite", "wheels NaN"} <= {each.name for each in refused}
    for fault in refused:
        assert same(inject(sound, fault, 1.0, rng())[0], list(sound)), fault.name


def test_what_the_types_let_through_changes_the_measurements() -> None:
    sound = tuple(open_source("course:perceptions", TINY).recording.measurements)
    for fault in FAULTS[12:]:
        assert not same(inject(sound, fault, 1.0, rng())[0], list(sound)), fault.name


@pytest.mark.parametrize("fault", [each for each in FAULTS if each.says_nothing][12:])
def test_a_fault_that_says_nothing_changes_nothing(
    tiny: tuple[Source, RunResult], fault: ScanFault | WheelFault
) -> None:
    struck = strike(*tiny, fault, rng())
    assert struck.lost == ""
    assert struck.change_m <= 1e-3


@pytest.mark.parametrize(
    "name", ["scan empty", "scan twice", "all at one point", "sigmas a million times"]
)
def test_a_fault_that_lies_does_not_end_a_run(tiny: tuple[Source, RunResult], name: str) -> None:
    (fault,) = (each for each in FAULTS if each.name == name)
    struck = strike(*tiny, fault, rng())
    assert struck.lost == ""
    assert struck.num_faults > 10


def test_what_ends_a_run_is_told(tiny: tuple[Source, RunResult]) -> None:
    source, sound = tiny
    bare = replace(source, recording=replace(source.recording, measurements=()))
    struck = strike(bare, sound, ScanFault("no scan is left", lambda scan, _: [scan]), rng())
    assert "expected scans or perceptions" in struck.lost


def test_lost_and_changed_runs_are_named_and_missed() -> None:
    good = Struck("a", 10_000, "", 0.0)
    assert all(row.reached for row in rows([good]))
    lost, changed = replace(good, name="b", lost="E: x"), replace(good, name="c", change_m=0.1)
    missed = {row.name for row in rows([good, lost, changed]) if not row.reached}
    assert missed == {"runs lost (b)", "largest change by what says nothing (c)"}
    assert not all(row.reached for row in rows([replace(good, num_faults=9)]))
    assert not all(row.reached for row in rows([replace(good, change_m=np.inf)]))


def test_runs_follow_until_so_many_faults_are_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_faults, "_SHORT", {k: v for k, v in TINY.items() if k != "seed"})
    monkeypatch.setattr(bench_faults, "FAULTS", FAULTS[:3])
    monkeypatch.setattr(bench_faults, "_FAULTS_A_BATCH", 40)
    struck = bench_faults.strikes((1, 0))
    assert sum(each.num_faults for each in struck) >= 40
    assert len({each.name for each in struck}) > 1
    assert bench_faults.strikes((1, 1))[0].name != struck[0].name
