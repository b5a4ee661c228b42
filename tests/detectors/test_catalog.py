"""Detectors by name: defaults, refusals, and detectors from outside."""

from importlib.metadata import EntryPoint
from typing import Final

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict

from detectors import catalog
from detectors.catalog import create_detector, detector_names, detector_settings
from detectors.detector import DetectorType
from semgraph.errors import SettingsError
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.measurements import LaserScan, ScannerGeometry


class RockAheadSettings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    range_m: float = 2.0


class RockAhead:
    """A detector from outside: there is always a rock ahead."""

    def __init__(self, settings: RockAheadSettings) -> None:
        self._range_m: Final = settings.range_m

    def detect(self, scan: LaserScan) -> Perceptions:
        covariances = polar_covariances(np.full(1, 0.1), np.full(1, 0.1))
        ranges_m = np.array([self._range_m])
        return Perceptions.from_arrays(scan.stamp_ns, Kind.ROCK, ranges_m, np.zeros(1), covariances)


ROCK_AHEAD = DetectorType(RockAheadSettings, RockAhead)


def _publish(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    points = [EntryPoint(name, value, catalog.ENTRY_POINT_GROUP)]
    monkeypatch.setattr(catalog, "entry_points", lambda **_: points)


@pytest.mark.parametrize("name", detector_names())
def test_every_detector_works_with_its_defaults(name: str) -> None:
    defaults = detector_settings(name)()
    create_detector(name, {})
    create_detector(name, defaults.model_dump())
    assert defaults.model_config["frozen"]
    assert defaults.model_config["extra"] == "forbid"


@pytest.mark.parametrize("name", detector_names())
def test_an_unknown_setting_is_refused(name: str) -> None:
    known = next(iter(detector_settings(name).model_fields))
    with pytest.raises(SettingsError, match=f"unknown setting '{known}x'; did you mean '{known}'"):
        create_detector(name, {f"{known}x": 1.0})


@pytest.mark.parametrize("value", ["wide", None, [], float("nan"), -1.0])
def test_an_impossible_value_is_refused_in_one_line(value: object) -> None:
    with pytest.raises(SettingsError, match="detector reflectors: range_max_m: ") as caught:
        create_detector("reflectors", {"range_max_m": value})
    assert "\n" not in str(caught.value)


def test_an_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(SettingsError, match="'reflector'; did you mean 'reflectors'"):
        create_detector("reflector", {})
    with pytest.raises(SettingsError, match=r"known: .*reflectors"):
        detector_settings("zzz")


def test_a_detector_from_outside_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    _publish(monkeypatch, "rock-ahead", f"{__name__}:ROCK_AHEAD")
    scan = LaserScan(7, ScannerGeometry(0.0, 0.1, 0.1, 10.0), np.full(3, np.inf))
    perceptions = create_detector("rock-ahead", {"range_m": 4.0}).detect(scan)
    assert "rock-ahead" in detector_names()
    assert perceptions.ranges_m.tolist() == [4.0]


def test_a_name_of_our_own_cannot_be_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    _publish(monkeypatch, "reflectors", f"{__name__}:ROCK_AHEAD")
    assert detector_settings("reflectors") is not RockAheadSettings


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("no.such.module:X", "cannot load"),
        ("math:no_such_name", "cannot load"),
        ("math:pi", "expected math:pi to be a DetectorType"),
    ],
)
def test_a_broken_entry_point_is_named(
    monkeypatch: pytest.MonkeyPatch, value: str, said: str
) -> None:
    _publish(monkeypatch, "broken", value)
    with pytest.raises(SettingsError, match=f"detector broken: {said}"):
        create_detector("broken", {})
