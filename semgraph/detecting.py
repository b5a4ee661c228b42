"""What the detectors find in a recording, without any estimate: `semgraph detect`."""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from semgraph.errors import InputError
from semgraph.landmarks import Perceptions
from semgraph.perceiving import Perceiver
from semgraph.progress import Report
from semgraph.thinning import Thinned
from sensors.measurements import ImuSample, Raw, Recording, WheelOdometry
from sensors.plain_perceptions import write_perceptions

_KEPT_OF_A_CLASS: Final = 64


@dataclass(frozen=True, slots=True)
class Effort:
    """What a detector did.

    Attributes:
        num_measurements: that it looked at and answered.
        num_perceptions: in all of them.
        median_ms, p99_ms: of CPU a measurement.
    """

    detector: str
    num_measurements: int
    num_perceptions: int
    median_ms: float
    p99_ms: float

    @property
    def mean_perceptions(self) -> float:
        """Perceptions a measurement."""
        return self.num_perceptions / self.num_measurements


@dataclass(slots=True)
class Efforts:
    """Gathers what a bank of detectors tells."""

    _counts: dict[str, int] = field(default_factory=dict)
    _milliseconds: dict[str, "array[float]"] = field(default_factory=dict)

    def __call__(self, detector: str, perceptions: Perceptions, cpu_seconds: float) -> None:
        """Takes one answer of a detector."""
        self._counts[detector] = self._counts.get(detector, 0) + len(perceptions)
        self._milliseconds.setdefault(detector, array("d")).append(1e3 * cpu_seconds)

    def table(self) -> list[Effort]:
        """One line a detector, in the order in which they first answered."""
        return [
            Effort(
                detector,
                len(times),
                self._counts[detector],
                *np.percentile(np.frombuffer(times), (50.0, 99.0)).tolist(),
            )
            for detector, times in self._milliseconds.items()
        ]


Seen = tuple[Raw, Perceptions]
"""A measurement, and what was found in it relative to base."""


def write_detections(
    recording: Recording, perceiver: Perceiver, file: Path, report: Report, num_shown: int
) -> list[Seen]:
    """Writes `perceptions.csv`, and gives some of what was seen to be shown.

    Returns:
        At most `num_shown`, spread over the recording and, evenly, over classes of measurements.

    Raises:
        InputError: a class of measurements without a detector, or none that a detector looks at.
        SemgraphError: the file cannot be written.
    """
    kept: dict[type[Raw], Thinned[Seen]] = {}
    write_perceptions(file, _found(recording, perceiver, report, kept))
    if not kept:
        raise InputError(
            f"{recording.name}: expected scans, clouds or images; there are none to detect in, "
            "its perceptions come ready: semgraph run takes them as they are"
        )
    shares = np.diff(np.linspace(0, num_shown, len(kept) + 1).astype(int)).tolist()
    chosen = [
        each
        for share, thinned in zip(shares, kept.values(), strict=True)
        for each in thinned.spread(share)
    ]
    return sorted(chosen, key=lambda seen: seen[0].stamp_ns)


def _found(
    recording: Recording,
    perceiver: Perceiver,
    report: Report,
    kept: dict[type[Raw], Thinned[Seen]],
) -> Iterator[Perceptions]:
    for count, (measurement, perceptions) in enumerate(_perceived(recording, perceiver), start=1):
        thinned = kept.setdefault(type(measurement), Thinned(_KEPT_OF_A_CLASS))
        thinned.add((measurement, perceptions))
        report.done(count)
        yield perceptions


def _perceived(recording: Recording, perceiver: Perceiver) -> Iterator[Seen]:
    """Scans are deskewed by the wheels, since nothing here estimates motion."""
    last: WheelOdometry | None = None
    for measurement in recording.measurements:
        if isinstance(measurement, WheelOdometry):
            if last is not None:
                moved = last.odom_T_base.between(measurement.odom_T_base)
                perceiver.moved(moved, 1e-9 * (measurement.stamp_ns - last.stamp_ns))
            last = measurement
        elif isinstance(measurement, ImuSample):
            perceiver.lean(measurement)
        elif isinstance(measurement, Raw):
            yield measurement, perceiver.perceive(measurement).perceptions
