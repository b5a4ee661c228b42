"""All detectors of a run side by side: replaceable between two measurements, none can stop it."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any, Final, final

from detectors.catalog import create_detector, detector_settings, detector_type
from detectors.detector import Detector
from semgraph.doubles import each_once
from semgraph.landmarks import Perceptions
from sensors.measurements import Raw

STALL_S: Final = 2.0
"""After this long a detector counts as stalled."""

Choices = Mapping[str, Mapping[str, object]]
"""Settings by the detector's name; what is left out has its default."""


Observe = Callable[[str, Perceptions, float], None]
"""Told after each answer: the detector's name, what it found, seconds of CPU."""


def _as_found(perceptions: Perceptions) -> Perceptions:
    return perceptions


@final
class DetectorBank:
    """What each measurement shows to the detectors that look at its class.

    A detector that throws is left out for that measurement, one that stalls until it is replaced.

    Raises:
        SettingsError: an unknown name or setting, or a value that a setting cannot take.
    """

    def __init__(
        self, choices: Choices, stall_s: float = STALL_S, observe: Observe | None = None
    ) -> None:
        self._stall_s = stall_s
        self._observe = observe
        self._faults: Counter[tuple[str, str]] = Counter()
        self._guards = _guards(choices)
        self._choices = _copied(choices)

    @property
    def choices(self) -> Choices:
        """The detectors at work, and what is set in them."""
        return self._choices

    def effective(self) -> dict[str, dict[str, Any]]:
        """All settings as they hold, defaults included."""
        return {
            name: detector_settings(name).model_validate(values).model_dump(mode="json")
            for name, values in self._choices.items()
        }

    def replace(self, choices: Choices) -> None:
        """From the next measurement on, these are the detectors; those unchanged keep on.

        Raises:
            SettingsError: as at the start; then nothing changes.
        """
        new = {
            name: values
            for name, values in _copied(choices).items()
            if self._choices.get(name) != values or self._guards[name].is_stalled
        }
        guards = _guards(new)
        kept = {name: guard for name, guard in self._guards.items() if name in choices}
        self._guards = {**kept, **guards}
        self._choices = _copied(choices)

    def perceive(
        self, measurement: Raw, correct: Callable[[Perceptions], Perceptions] = _as_found
    ) -> Perceptions:
        """What all that look at it find in it, relative to base.

        Args:
            measurement: of one sensor.
            correct: what is to be done to perceptions that are relative to the sensor.
        """
        parts = []
        for name, guard in self._guards.items():
            if not isinstance(measurement, guard.looks_at) or guard.is_stalled:
                continue
            started = time.process_time()
            outcome = guard.detect(measurement, self._stall_s)
            if isinstance(outcome, Perceptions):
                if self._observe is not None:
                    self._observe(name, outcome, time.process_time() - started)
                parts.append(correct(outcome).seen_from(measurement.base_T_sensor))
            else:
                self._faults[name, outcome.reason] += 1
        return each_once(measurement.stamp_ns, parts, of_one_measurement=True)

    @property
    def faults(self) -> tuple[str, ...]:
        """Who was left out, why and how often, one line each."""
        return tuple(
            f"detector {name} left out of {count} measurements: {reason}"
            for (name, reason), count in self._faults.items()
        )

    def looks_at(self, measurement: Raw) -> bool:
        """Whether any detector takes such measurements."""
        return any(isinstance(measurement, guard.looks_at) for guard in self._guards.values())


@dataclass(frozen=True, slots=True)
class _Fault:
    """Why there is no outcome."""

    reason: str


@dataclass(slots=True)
class _Guard:
    """A detector in a thread of its own, that only it can hold up."""

    detector: Detector[Any]
    looks_at: type[Raw]
    is_stalled: bool = False
    _tasks: SimpleQueue[Raw] = field(default_factory=SimpleQueue)
    _outcomes: SimpleQueue[Perceptions | _Fault] = field(default_factory=SimpleQueue)
    _thread: threading.Thread | None = None

    def detect(self, measurement: Raw, stall_s: float) -> Perceptions | _Fault:
        """Its perceptions, or what went wrong."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, daemon=True)
            self._thread.start()
        self._tasks.put(measurement)
        try:
            return self._outcomes.get(timeout=stall_s)
        except Empty:
            self.is_stalled = True
            return _Fault(f"no answer within {stall_s:g} s, left out until it is replaced")

    def _work(self) -> None:
        while not self.is_stalled:
            self._outcomes.put(self._attempt(self._tasks.get()))

    def _attempt(self, measurement: Raw) -> Perceptions | _Fault:
        try:
            outcome: object = self.detector.detect(measurement)
        except Exception as error:  # noqa: BLE001  # code from outside may raise anything
            return _Fault(f"{type(error).__name__}: {str(error).partition(chr(10))[0]}")
        if not isinstance(outcome, Perceptions) or outcome.stamp_ns != measurement.stamp_ns:
            return _Fault("it gave no Perceptions of the measurement's stamp")
        return outcome


def _guards(choices: Choices) -> dict[str, _Guard]:
    return {
        name: _Guard(create_detector(name, values), detector_type(name).looks_at)
        for name, values in choices.items()
    }


def _copied(choices: Choices) -> dict[str, dict[str, object]]:
    return {name: dict(values) for name, values in choices.items()}
