"""A trial in this process: what comes out, what is the same again, and why it may fail."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.studies.judging import OF_THE_MACHINE
from evaluation.studies.measuring import measure, rng_of, settings_of, source_of
from evaluation.studies.trial import Outcome, Status, Trial
from semgraph.errors import SettingsError
from tests.sensors.sources import same

TRIAL = Trial(
    study="test",
    condition="short",
    source="course:perceptions",
    options=(
        ("lap_s", "6"),
        ("num_trees", "20"),
        ("odometry", "true"),
        ("overlap_s", "1"),
        ("track_radius_m", "6"),
    ),
    settings=(("fast.search_radius_m", "0.8"),),
    estimator="fast",
    seed=3,
)


def figures(outcome: Outcome) -> dict[str, float]:
    return {name: value for name, value in outcome.values.items() if name not in OF_THE_MACHINE}


def test_a_trial_is_measured() -> None:
    outcome = measure(TRIAL)
    assert outcome.status is Status.FINISHED
    assert outcome.reason == ""
    assert 0.0 < outcome.values["trajectory_rmse_m"] < 0.1
    assert outcome.cpu_s == outcome.values["cpu_s"] > 0.0
    assert outcome.wall_s > 0.0
    assert outcome.peak_memory_bytes > 2**24
    assert dict(outcome.versions).keys() == {"semgraph", "numpy", "gtsam", "python"}
    assert outcome.series is not None
    assert outcome.drawing is not None
    assert len(outcome.drawing.true_landmarks) == 20


def test_the_same_trial_gives_the_same_figures() -> None:
    for name in ("fast", "combined"):
        trial = replace(TRIAL, estimator=name)
        assert figures(measure(trial)) == figures(measure(trial))


def test_all_estimators_see_the_same_noise() -> None:
    other = replace(TRIAL, estimator="ekf-slam")
    assert same(source_of(TRIAL).truth, source_of(other).truth)
    assert rng_of(TRIAL).random() == rng_of(other).random()
    assert rng_of(TRIAL).random() != rng_of(replace(TRIAL, seed=4)).random()
    assert rng_of(TRIAL).random() != rng_of(replace(TRIAL, condition="long")).random()
    assert not same(source_of(TRIAL).truth, source_of(replace(TRIAL, seed=4)).truth)


def test_settings_reach_the_estimator() -> None:
    assert settings_of(TRIAL).fast.search_radius_m == pytest.approx(0.8)
    with pytest.raises(SettingsError, match="did you mean 'search_radius_m'"):
        settings_of(replace(TRIAL, settings=(("fast.search_radius", "1"),)))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"estimator": "fsat"}, "did you mean 'fast'"),
        ({"source": "course:nowhere"}, "expected a folder or a source"),
        ({"options": (("trees", "3"),)}, "unknown option 'trees'"),
        ({"settings": (("fast.rules", "none"),)}, "fast.rules"),
        ({"options": (("lap_s", "5"),), "estimator": "dead-reckoning"}, "expected wheels"),
    ],
)
def test_a_known_error_is_an_outcome(change: dict[str, object], reason: str) -> None:
    outcome = measure(replace(TRIAL, **change))  # type: ignore[arg-type]
    assert outcome.status is Status.FAILED
    assert reason in outcome.reason
    assert "\n" not in outcome.reason
    assert outcome.metrics == ()
    assert outcome.versions


def test_an_unknown_error_is_not_swallowed(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> np.random.Generator:
        raise ZeroDivisionError

    monkeypatch.setattr("evaluation.studies.measuring.rng_of", broken)
    with pytest.raises(ZeroDivisionError):
        measure(TRIAL)
