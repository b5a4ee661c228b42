"""What a report tells: the outcomes of a study, ordered for reading."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.metrics import Direction, Metric
from evaluation.studies.comparison import ORACLE, Difference, Summary
from evaluation.studies.trial import Outcome, Status
from semgraph.arrays import FloatArray

PATH_ERROR: Final = "trajectory_rmse_m"
# What these are told beyond the measurements; they are shown, and win nothing.
TOLD_MORE: Final = {
    ORACLE: "true associations",
    "particle-filter": "the true map",
    "combined": "the true map",
}
CPU: Final = Metric("cpu_s", np.nan, "s", Direction.LOWER)
# What a reader asks first, in this order; the rest is in the tables.
_HEADLINES: Final = (
    PATH_ERROR,
    "online_trajectory_rmse_m",
    "heading_rmse_deg",
    "map_rmse_m",
    "map_recall",
    "association_precision",
    "nees_mean",
    "cpu_s",
)
_WORDS: Final = {
    "trajectory_rmse": "path error (ATE RMSE)",
    "online_trajectory_rmse": "path error as told at the time",
    "heading_rmse": "heading error (RMSE)",
    "map_rmse": "landmark error (RMSE)",
    "landmarks_duplicate": "landmarks mapped twice",
    "trajectory_max_origin": "drift from the start, largest",
    "map_recall": "share of the landmarks found",
    "nees_mean": "NEES of the poses",
    "nees_last": "NEES of the last pose",
    "cpu": "CPU time",
}
_SPELLED: Final = {"rmse": "RMSE", "nees": "NEES", "nis": "NIS", "cpu": "CPU"}


@dataclass(frozen=True, slots=True, eq=False)
class Contents:
    """A study as read from its files.

    Attributes:
        what: it asks, in a sentence or more; may be empty.
        settings: the study's file as it is.
        num_planned: trials that the study has, whether they have run or not.
        run_again: the command that makes it again.
        one_again: the command that runs a trial alone, with `{id}` for the trial.
    """

    name: str
    what: str
    settings: str
    num_planned: int
    run_again: str
    one_again: str
    outcomes: tuple[Outcome, ...]
    summaries: tuple[Summary, ...]
    differences: tuple[Difference, ...]

    @property
    def conditions(self) -> tuple[str, ...]:
        """As they first appear."""
        return _first_seen(each.trial.condition for each in self.outcomes)

    @property
    def estimators(self) -> tuple[str, ...]:
        """As they first appear."""
        return _first_seen(each.trial.estimator for each in self.outcomes)

    def estimators_of(self, condition: str) -> tuple[str, ...]:
        """Those that the study has under a condition."""
        its = (each.trial for each in self.outcomes)
        return _first_seen(each.estimator for each in its if each.condition == condition)

    @property
    def metrics(self) -> dict[str, Metric]:
        """One of each name, for unit and direction; the headlines first."""
        known = {metric.name: metric for each in self.outcomes for metric in each.metrics}
        first = [known[name] for name in _HEADLINES if name in known]
        return {metric.name: metric for metric in (*first, *known.values())}

    @property
    def headlines(self) -> tuple[Metric, ...]:
        """What is judged first, at most eight."""
        metrics = self.metrics
        judged = [each for each in metrics.values() if each.better is not Direction.NEITHER]
        return tuple([each for each in judged if each.name in _HEADLINES] or judged)[:8]

    @property
    def primary(self) -> Metric | None:
        """By which estimators are ranked; None where nothing was measured."""
        return next(iter(self.headlines), None)

    @property
    def failed(self) -> tuple[Outcome, ...]:
        """What did not finish."""
        return tuple(each for each in self.outcomes if each.status is not Status.FINISHED)

    def finished(self, condition: str, estimator: str) -> tuple[Outcome, ...]:
        """By seed."""
        its = [
            each
            for each in self.outcomes
            if each.trial.condition == condition
            and each.trial.estimator == estimator
            and each.status is Status.FINISHED
        ]
        return tuple(sorted(its, key=lambda each: each.trial.seed))

    def values(self, condition: str, estimator: str, metric: str) -> FloatArray:
        """(n,) finite values over the seeds; CPU is what the trial took where no metric says."""
        its = self.finished(condition, estimator)
        if metric == CPU.name:
            found = [each.values.get(metric, each.cpu_s) for each in its]
        else:
            found = [each.values.get(metric, np.nan) for each in its]
        values: FloatArray = np.array(found, dtype=float)
        return np.compress(np.isfinite(values), values)

    def expected(self, condition: str, metric: str) -> float | None:
        """What an honest estimator has; NEES has 2 or 3 by what truth the condition has."""
        known = (each for each in self.summaries if each.condition == condition and each.n)
        return next((each.expected for each in known if each.metric == metric), None)

    def nearest_to(self, metric: Metric) -> str:
        """As `, nearest to 3`; nothing of a metric of which nothing is expected."""
        found = {self.expected(condition, metric.name) for condition in self.conditions}
        known = sorted(each for each in found if each is not None)
        return f", nearest to {' or '.join(f'{each:g}' for each in known)}" if known else ""

    def summary(self, condition: str, estimator: str, metric: str) -> Summary | None:
        """None where there is no value."""
        wanted = condition, estimator, metric
        return next(
            (
                each
                for each in self.summaries
                if (each.condition, each.estimator, each.metric) == wanted and each.n
            ),
            None,
        )

    def contenders(self, condition: str, metric: Metric) -> tuple[Summary, ...]:
        """The ranked ones that are told nothing but the measurements."""
        ranked = self.ranked(condition, metric)
        return tuple(each for each in ranked if each.estimator not in TOLD_MORE)

    def contests(self, metric: Metric) -> tuple[str, ...]:
        """The conditions under which two or more contend."""
        return tuple(each for each in self.conditions if len(self.contenders(each, metric)) > 1)

    def ranked(self, condition: str, metric: Metric) -> tuple[Summary, ...]:
        """The estimators from best to worst median; without a value they are left out."""
        its = [
            each
            for each in self.summaries
            if each.condition == condition and each.metric == metric.name and each.n
        ]
        return tuple(sorted(its, key=_badness))


def words_of(metric: Metric | Summary | Difference) -> str:
    """A metric's name in words, without its unit."""
    name = metric.name if isinstance(metric, Metric) else metric.metric
    if metric.unit:
        unit = metric.unit.replace("/", "_").replace("%", "percent").lower()
        name = name.removesuffix("_" + unit)
    return _WORDS.get(name) or " ".join(_SPELLED.get(word, word) for word in name.split("_"))


def capitalised(words: str) -> str:
    """With a capital at the start, the rest as it is."""
    return words[:1].upper() + words[1:]


def label_of(metric: Metric) -> str:
    """A metric's name in words with its unit, for an axis."""
    return f"{words_of(metric)} ({metric.unit})" if metric.unit else words_of(metric)


def _badness(summary: Summary) -> float:
    if summary.expected is not None:
        return abs(summary.median - summary.expected)
    return -summary.median if summary.better is Direction.HIGHER else summary.median


def _first_seen(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))
