"""What would make trials fail is said before the first of them runs."""

from collections.abc import Sequence

from evaluation.estimators.catalog import ESTIMATORS
from evaluation.studies.trial import Trial
from semgraph.errors import InputError, SemgraphError, known_names
from semgraph.settings import load_settings
from sensors.catalog import check_options


def check_trials(trials: Sequence[Trial]) -> None:
    """Nothing, for trials whose sources, options, settings and estimators are all known.

    Raises:
        InputError: the first that is not, with its condition.
    """
    for trial in {(each.condition, each.estimator): each for each in trials}.values():
        if trial.estimator not in ESTIMATORS:
            raise InputError(
                f"study {trial.study}: unknown estimator {trial.estimator!r}, "
                f"{known_names(trial.estimator, ESTIMATORS)}"
            )
    for trial in {each.condition: each for each in trials}.values():
        try:
            check_options(trial.source, dict(trial.options))
            load_settings(None, [f"{key}={value}" for key, value in trial.settings])
        except SemgraphError as error:
            raise InputError(f"condition {trial.condition!r}: {error}") from error
