"""What a measurement shows: filters, then detectors, both of which may change while running."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from detectors.bank import Choices, DetectorBank, Observe
from semgraph.errors import InputError, SettingsError
from semgraph.geometry import Pose2
from semgraph.landmarks import Perceptions
from semgraph.settings import Settings, load_settings
from sensors.filters.chain import Chain, FilterSettings, apply_chain, build_chain, filter_settings
from sensors.filters.context import ScanContext
from sensors.filters.deskewing import DeskewSettings, deskew_perceptions
from sensors.measurements import ImuSample, LaserScan, Raw, Recording, Tilt
from sensors.views import View


def chosen_detectors(recording: Recording, settings: Settings) -> Choices:
    """The recording's detectors and those of the settings; `NAME = false` leaves one out."""
    names = {**dict.fromkeys(recording.detectors), **dict.fromkeys(settings.detectors)}
    chosen = {}
    for name in names:
        own = settings.detectors.get(name, {})
        if own is not False:
            chosen[name] = {**recording.detectors.get(name, {}), **own}
    return chosen


def chosen_filters(recording: Recording, settings: Settings) -> list[FilterSettings]:
    """The filters of the settings, or the recording's where the settings have none.

    Raises:
        SettingsError: an unknown filter or a value that it cannot take.
    """
    if settings.filters is None:
        return filter_settings(recording.filters)
    return filter_settings(settings.filters)


@dataclass(frozen=True, slots=True, eq=False)
class Perceived:
    """What a measurement shows, relative to base.

    Attributes:
        perceptions: what the detectors found.
        view: how far a laser saw, by what its filters left; None of other sensors.
    """

    perceptions: Perceptions
    view: View | None = None


@final
class Perceiver:
    """Filters and detectors of one run.

    Raises:
        SettingsError: an unknown filter or detector, or a value that it cannot take.
    """

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        live: Path | None = None,
        observe: Observe | None = None,
    ) -> None:
        self._recording = recording
        self._bank = DetectorBank(chosen_detectors(recording, settings), observe=observe)
        self._set_filters(chosen_filters(recording, settings))
        self._live = _LiveFile(live) if live is not None else None
        self._twist: tuple[float, float, float] | None = None
        self._tilt: Tilt | None = None
        self._changes: list[str] = []

    @property
    def bank(self) -> DetectorBank:
        """The detectors."""
        return self._bank

    @property
    def filters(self) -> list[FilterSettings]:
        """What is done to scans before."""
        return self._filters

    @property
    def deskews(self) -> bool:
        """Whether what scans show depends on how base moves."""
        return self._deskew is not None

    @property
    def events(self) -> tuple[str, ...]:
        """What was changed while running, and which detectors were left out."""
        return (*self._changes, *self._bank.faults)

    def lean(self, sample: ImuSample) -> None:
        """Base leans like this from now on."""
        self._tilt = sample.tilt if sample.tilt is not None else self._tilt

    def moved(self, last_T_current: Pose2, seconds: float) -> None:
        """Base moved like this since the measurement before."""
        if seconds > 0.0:
            x, y, turn = (last_T_current.as_array() / seconds).tolist()
            self._twist = (x, y, turn)

    def perceive(self, measurement: Raw) -> Perceived:
        """What it shows.

        Raises:
            InputError: no detector looks at such measurements.
        """
        self._look_for_changes(measurement)
        if not self._bank.looks_at(measurement) and not self._changes:
            raise InputError(
                f"{self._recording.name}: expected a detector for its measurements of class "
                f"{type(measurement).__name__}; name one, say --set detectors.trees-2d={{}}"
            )
        if not isinstance(measurement, LaserScan):
            return Perceived(self._bank.perceive(measurement))
        context = ScanContext(self._twist, self._tilt)
        scan = apply_chain(self._chain, measurement, context)
        found = self._bank.perceive(scan, lambda found: self._deskewed(found, scan, context))
        return Perceived(found, View.of_scan(scan))

    def _deskewed(self, found: Perceptions, scan: LaserScan, context: ScanContext) -> Perceptions:
        """Not the scan is deskewed but what is found in it: that is exact."""
        if self._deskew is None:
            return found
        return deskew_perceptions(found, scan, self._deskew, context)

    def _set_filters(self, filters: list[FilterSettings]) -> None:
        self._filters = filters
        deskews = [each for each in filters if isinstance(each, DeskewSettings)]
        self._deskew = deskews[0] if deskews else None
        self._chain: Chain = build_chain([each for each in filters if each not in deskews])

    def _look_for_changes(self, measurement: Raw) -> None:
        if self._live is None or not self._live.has_changed():
            return
        when = f"at {measurement.stamp_ns * 1e-9:.2f} s"
        try:
            settings = load_settings(self._live.file, [])
            filters = chosen_filters(self._recording, settings)
            self._bank.replace(chosen_detectors(self._recording, settings))
        except SettingsError as error:
            self._changes.append(f"settings unchanged {when}: {error}")
            return
        self._set_filters(filters)
        names = ", ".join(self._bank.choices) or "none"
        self._changes.append(f"settings changed {when}: detectors {names}")


class _LiveFile:
    """Tells once when a file has been written anew; the first state counts as new."""

    def __init__(self, file: Path) -> None:
        self.file: Final = file
        self._seen: tuple[int, int] | None = None

    def has_changed(self) -> bool:
        """A file that is not there has not changed."""
        try:
            stat = self.file.stat()
        except OSError:
            return False
        state = (stat.st_mtime_ns, stat.st_size)
        is_new = state != self._seen
        self._seen = state
        return is_new
