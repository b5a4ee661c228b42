"""One trial of a study and what came out of it: all that execution, store and report share."""

import hashlib
import json
from dataclasses import dataclass, field
from enum import StrEnum

from evaluation.metrics import Metric
from semgraph.arrays import FloatArray

MAX_SAMPLES = 120


class Status(StrEnum):
    """How a trial ended."""

    FINISHED = "finished"
    FAILED = "failed"
    TIMED_OUT = "timed out"
    OUT_OF_MEMORY = "out of memory"


@dataclass(frozen=True, slots=True)
class Trial:
    """What is run: an estimator on a source under a condition, with a seed.

    Attributes:
        study: its name.
        condition: source, options and settings in words, as the report names them.
        source: as on the command line.
        options: of the source, without its seed, sorted by key.
        settings: of the estimator, `section.key` and value, sorted by key.
        estimator: its name in `evaluation.estimators.catalog`.
        seed: of all noise; trials with one condition and seed see the same measurements.
    """

    study: str
    condition: str
    source: str
    options: tuple[tuple[str, str], ...]
    settings: tuple[tuple[str, str], ...]
    estimator: str
    seed: int

    @property
    def id(self) -> str:
        """Twelve hex digits that only these inputs have, on every machine."""
        parts = (
            self.study,
            self.condition,
            self.source,
            self.options,
            self.settings,
            self.estimator,
            self.seed,
        )
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]

    @property
    def pair(self) -> tuple[str, int]:
        """What trials of several estimators on the same measurements have in common."""
        return self.condition, self.seed


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Errors over time, after rigid alignment, of at most `MAX_SAMPLES` samples.

    Attributes:
        times_s: (n,) since the start.
        position_errors_m: (n,) the largest since the sample before.
        heading_errors_deg: (n,) the same; NaN where the truth has no headings.
        nees: (n,) of the pose at the sample; NaN where no covariance is known.
    """

    times_s: FloatArray
    position_errors_m: FloatArray
    heading_errors_deg: FloatArray
    nees: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """What a page shows of a trial, in the truth's frame, thinned out.

    Attributes:
        true_path: (k, 2) m.
        estimated_path: (n, 2) m, aligned rigidly; n is at most `MAX_SAMPLES`.
        true_landmarks: (m, 2) m.
        estimated_landmarks: (l, 2) m, aligned like the path.
    """

    true_path: FloatArray
    estimated_path: FloatArray
    true_landmarks: FloatArray
    estimated_landmarks: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What came out of a trial.

    Attributes:
        reason: why it did not finish, in one line; empty if it did.
        metrics: each with unit and direction; none if it did not finish.
        wall_s, cpu_s: what the estimator took, without opening and judging.
        peak_memory_bytes: of its process, at the end of the trial.
        series, drawing: None where the truth has no path.
    """

    trial: Trial
    status: Status
    reason: str = ""
    metrics: tuple[Metric, ...] = ()
    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_memory_bytes: int = 0
    series: Series | None = None
    drawing: Drawing | None = None
    versions: tuple[tuple[str, str], ...] = field(default=())

    @property
    def values(self) -> dict[str, float]:
        """The metrics' values by name."""
        return {metric.name: metric.value for metric in self.metrics}
