"""One trial run in this process, judged and measured."""

import hashlib
import platform
import resource
import sys
import time
from importlib.metadata import version
from typing import Final

import numpy as np

from evaluation.estimators.catalog import estimator
from evaluation.metrics import Direction, Metric
from evaluation.studies.judging import drawing_of, judge_estimate, series_of
from evaluation.studies.trial import Outcome, Status, Trial
from semgraph.errors import SemgraphError
from semgraph.settings import Settings, load_settings
from sensors.catalog import open_source, source_options
from sensors.truth import Source

_PACKAGES: Final = ("semgraph", "numpy", "gtsam")


def measure(trial: Trial) -> Outcome:
    """What comes out of a trial; a known error is an outcome too, all others are raised.

    Times are of the estimator alone, without opening and judging. Libraries that spread over
    several processors add to its processor time: workers keep them to one, before numpy is loaded.
    """
    clock = _Clock()
    try:
        run, settings, source = estimator(trial.estimator), settings_of(trial), source_of(trial)
        clock = _Clock()
        estimate = run(source, settings, rng_of(trial))
        wall_s, cpu_s = clock.read()
        metrics = judge_estimate(estimate, source)
        series, drawing = series_of(estimate, source), drawing_of(estimate, source)
    except SemgraphError as error:
        wall_s, cpu_s = clock.read()
        return Outcome(
            trial,
            Status.FAILED,
            " ".join(str(error).split()),
            wall_s=wall_s,
            cpu_s=cpu_s,
            peak_memory_bytes=peak_memory_bytes(),
            versions=versions(),
        )
    peak = peak_memory_bytes()
    measured = (
        Metric("cpu_s", cpu_s, "s", Direction.LOWER),
        Metric("peak_memory_mb", 1e-6 * peak, "MB", Direction.LOWER),
    )
    return Outcome(
        trial=trial,
        status=Status.FINISHED,
        metrics=(*metrics, *measured),
        wall_s=wall_s,
        cpu_s=cpu_s,
        peak_memory_bytes=peak,
        series=series,
        drawing=drawing,
        versions=versions(),
    )


def settings_of(trial: Trial) -> Settings:
    """The estimators' settings.

    Raises:
        SettingsError: a name or value is not known.
    """
    return load_settings(None, [f"{key}={value}" for key, value in trial.settings])


def source_of(trial: Trial) -> Source:
    """The source with the trial's seed; what was recorded has none, and takes none.

    Raises:
        SemgraphError: no such source or option, or what the reader refuses.
    """
    options: dict[str, object] = dict(trial.options)
    if "seed" in source_options(trial.source).model_fields:
        options["seed"] = trial.seed
    return open_source(trial.source, options)


def rng_of(trial: Trial) -> np.random.Generator:
    """The same for all estimators on the same measurements."""
    digest = hashlib.sha256(f"{trial.study}\0{trial.condition}".encode()).digest()
    entropy = [int.from_bytes(digest[:16], "big"), trial.seed]
    return np.random.default_rng(np.random.SeedSequence(entropy))


def peak_memory_bytes() -> int:
    """Of this process, so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def versions() -> tuple[tuple[str, str], ...]:
    """Of what the figures depend on."""
    packages = tuple((name, version(name)) for name in _PACKAGES)
    return (*packages, ("python", platform.python_version()))


class _Clock:
    """Wall and processor seconds since it was made."""

    def __init__(self) -> None:
        self._wall_s, self._cpu_s = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float]:
        return time.perf_counter() - self._wall_s, time.process_time() - self._cpu_s
