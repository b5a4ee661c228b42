"""The headline figures of a study."""

from dataclasses import replace

import pytest

from evaluation.benches.bench_study import rows
from evaluation.studies.trial import Outcome, Status
from semgraph.errors import SemgraphError
from tests.evaluation.study_report import made


def test_ratios_are_of_pairs_and_failures_are_counted() -> None:
    outcomes = _outcomes()
    found = {row.name: row for row in rows(outcomes)}
    assert found["trials that did not finish"].reached
    assert found["smoothed / oracle, path, median"].value == pytest.approx(1.06, abs=0.06)
    assert found["smoothed / fast, path, median"].value < 1.0
    failed = replace(outcomes[0], status=Status.FAILED, metrics=())
    after = {row.name: row for row in rows((failed, *outcomes[1:]))}
    assert not after["trials that did not finish"].reached


def test_without_the_oracle_there_is_no_table() -> None:
    outcomes = [each for each in _outcomes() if each.trial.estimator != "oracle"]
    with pytest.raises(SemgraphError, match="oracle"):
        rows(outcomes)


def _outcomes() -> tuple[Outcome, ...]:
    return tuple(
        replace(
            each,
            metrics=(
                *each.metrics,
                replace(each.metrics[0], name="landmarks_duplicate", value=0.0, unit=""),
            ),
        )
        for each in made.outcomes(12)
    )
