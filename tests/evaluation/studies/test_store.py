"""The file of outcomes: whole lines only, damage refused by number, full disks survived."""

import json
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.studies.outcome_lines import (
    MAX_LINE_BYTES,
    outcome_line,
    parse_outcome,
    parse_trial,
    trial_line,
)
from evaluation.studies.store import TRIALS_JSONL, opened_store, read_outcomes
from evaluation.studies.trial import Outcome, Status, Trial
from semgraph.errors import InputError, SemgraphError
from tests.evaluation.studies.small_trials import measure, trial

LINE = outcome_line(measure(trial()))


@contextmanager
def no_file_above(num_bytes: int) -> Iterator[None]:
    """A disk that is full once a file has so many bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def write(folder: Path, *lines: bytes) -> None:
    (folder / TRIALS_JSONL).write_bytes(b"".join(lines))


def changed(**fields: Any) -> bytes:
    return json.dumps({**json.loads(LINE), **fields}).encode() + b"\n"


def test_an_outcome_comes_back_as_it_was() -> None:
    before, after = measure(trial()), parse_outcome(LINE)
    assert (after.trial, after.status, after.metrics) == (
        before.trial,
        before.status,
        before.metrics,
    )
    assert (after.wall_s, after.cpu_s, after.versions) == (0.5, 0.25, before.versions)
    assert before.series is not None
    assert after.series is not None
    np.testing.assert_allclose(after.series.nees, before.series.nees, rtol=1e-5)
    assert np.isnan(after.series.heading_errors_deg).all()
    assert before.drawing is not None
    assert after.drawing is not None
    np.testing.assert_allclose(after.drawing.true_path, before.drawing.true_path, atol=1e-4)
    assert after.drawing.true_landmarks.shape == (0, 2)
    assert outcome_line(after) == LINE


texts = st.text(max_size=20)
pairs = st.lists(st.tuples(texts, texts), max_size=3).map(tuple)


@given(
    st.builds(
        Trial, texts, texts, texts, pairs, pairs, texts, st.integers(min_value=0, max_value=2**62)
    )
)
def test_any_trial_comes_back_as_it_was(given_trial: Trial) -> None:
    line = trial_line(given_trial)
    assert line.count(b"\n") == 1
    assert parse_trial(line) == given_trial
    failed = outcome_line(Outcome(given_trial, Status.FAILED, "why"))
    assert parse_outcome(failed).trial.id == given_trial.id


def test_outcomes_are_there_again_after_each_append(tmp_path: Path) -> None:
    lines = [outcome_line(measure(trial(seed=seed))) for seed in range(3)]
    with opened_store(tmp_path / "new") as store:
        for number, line in enumerate(lines, start=1):
            store.append(line)
            assert len(read_outcomes(tmp_path / "new")) == number
    with opened_store(tmp_path / "new") as store:
        assert [each.trial.seed for each in store.outcomes.values()] == [0, 1, 2]
        assert not store.notes


def test_a_torn_last_line_is_said_and_left_out_wherever_it_is_torn(tmp_path: Path) -> None:
    second = outcome_line(measure(trial(seed=1)))
    for kept in (1, 10, len(second) // 2, len(second) - 1):
        write(tmp_path, LINE, second[:kept])
        with opened_store(tmp_path) as store:
            assert len(store.outcomes) == 1
            assert f"the last line was not finished ({kept} bytes)" in store.notes[0]
            store.append(second)
        assert (tmp_path / TRIALS_JSONL).read_bytes() == LINE + second


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"\n", "expected an outcome"),
        (b"{}\n", "id: Field required"),
        (b"[" * 100_000 + b"\n", "expected an outcome"),
        (changed(more=1), "more: Extra inputs"),
        (changed(id="0123456789ab"), "not 0123456789ab as it says"),
        (changed(status="splendid"), "status"),
        (changed(status="failed"), "expected a reason where a trial did not finish"),
        (changed(wall_s=-1.0), "wall_s"),
        (changed(wall_s=float("nan")), "wall_s"),
        (changed(wall_s="1"), "wall_s"),
        (changed(peak_memory_bytes=2**70), "peak_memory_bytes"),
        (changed(metrics=json.loads(LINE)["metrics"] * 2), "each metric once"),
        (changed(reason="x" * 5000), "reason"),
        (LINE.replace(b'"times_s":[0.0', b'"times_s":[null'), "times_s"),
        (LINE.replace(b'"times_s":[0.0,', b'"times_s":['), "position_errors_m"),
        (LINE.replace(b'"value":', b'"value":1e999,"v":', 1), "value"),
        (b"x" * (MAX_LINE_BYTES + 10) + b"\n", "bytes"),
        (LINE, "is finished already"),
    ],
)
def test_a_line_that_is_no_outcome_is_refused_by_its_number(
    tmp_path: Path, line: bytes, reason: str
) -> None:
    write(tmp_path, LINE, line)
    with pytest.raises(InputError, match=f"{TRIALS_JSONL} line 2: .*{reason}"):
        read_outcomes(tmp_path)


def test_damage_anywhere_is_refused_or_harmless_but_never_anything_else(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    whole = LINE + outcome_line(measure(trial(seed=1)))
    refusals = []
    for _ in range(500):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.integers(0, 256)
        write(tmp_path, bytes(data))
        try:
            outcomes = read_outcomes(tmp_path)
        except InputError as error:
            refusals.append(str(error))
        else:
            assert len(outcomes) <= 2
    assert len(refusals) > 200
    assert all(" line " in refusal for refusal in refusals)


def test_a_full_disk_is_said_and_loses_nothing(tmp_path: Path) -> None:
    second = outcome_line(measure(trial(seed=1)))
    with opened_store(tmp_path) as store:
        store.append(LINE)
        with (
            no_file_above(len(LINE) + 100),
            pytest.raises(SemgraphError, match="the 1 trials before are kept: make room"),
        ):
            store.append(second)
        assert (tmp_path / TRIALS_JSONL).read_bytes() == LINE
        store.append(second)
    assert len(read_outcomes(tmp_path)) == 2


def test_two_processes_do_not_write_one_folder(tmp_path: Path) -> None:
    with (
        opened_store(tmp_path),
        pytest.raises(SemgraphError, match="another process runs this study"),
        opened_store(tmp_path),
    ):
        pass
    with opened_store(tmp_path):
        pass


def test_a_failed_trial_may_come_again_and_a_finished_one_not(tmp_path: Path) -> None:
    with opened_store(tmp_path) as store:
        store.append(outcome_line(Outcome(trial(), Status.FAILED, "why")))
        store.append(LINE)
        with pytest.raises(InputError, match="is finished already"):
            store.append(LINE)
    assert [each.status for each in read_outcomes(tmp_path)] == [Status.FINISHED]


def test_a_folder_that_cannot_be_one_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(InputError, match="holds something else"), opened_store(tmp_path):
        pass
    with pytest.raises(SemgraphError, match="cannot be written"), opened_store(tmp_path / "file"):
        pass
    with pytest.raises(InputError, match="expected the folder of a study"):
        read_outcomes(tmp_path)


def test_a_reason_with_a_files_odd_bytes_is_stored_as_text(tmp_path: Path) -> None:
    outcome = Outcome(trial(), Status.FAILED, "no file \udcff.csv")
    with opened_store(tmp_path) as store:
        assert store.append(outcome_line(outcome)).reason == r"no file \udcff.csv"


def test_what_is_as_good_as_infinite_is_unknown_and_never_read(tmp_path: Path) -> None:
    good = measure(trial())
    series, drawing = good.series, good.drawing
    assert series is not None
    assert drawing is not None
    huge = replace(
        good,
        metrics=(replace(good.metrics[0], value=1e308),),
        series=replace(series, position_errors_m=np.full(5, 1e308)),
        drawing=replace(drawing, estimated_path=np.full((5, 2), -1e308)),
    )
    with opened_store(tmp_path) as store:
        kept = store.append(outcome_line(huge))
        assert np.isnan(kept.metrics[0].value)
        assert kept.series is not None
        assert kept.series.position_errors_m.max() == 1e100
        with pytest.raises(InputError, match="less than or equal"):
            store.append(changed(metrics=[{"name": "a", "value": 1e101, "unit": "",
                                           "better": "lower"}]))  # fmt: skip
