"""Detectors side by side: changed while running, and none of them can stop the others."""

import time

import numpy as np
import pytest
from pydantic import BaseModel

from detectors import bank as bank_module
from detectors.bank import DetectorBank
from detectors.detector import DetectorType
from semgraph.errors import SettingsError
from semgraph.geometry import Pose2
from semgraph.landmarks import Kind, Perceptions, polar_covariances
from sensors.measurements import DepthImage, LaserScan, ScannerGeometry

GEOMETRY = ScannerGeometry(-1.0, 0.01, 0.1, 50.0, Pose2(1.0, 0.0, 0.0))


class PostSettings(BaseModel, extra="forbid", frozen=True):
    bearing: float = 0.0


class Post:
    """Sees one post 5 m away, whatever the scan."""

    def __init__(self, settings: PostSettings) -> None:
        self._bearing = settings.bearing

    def detect(self, scan: LaserScan) -> Perceptions:
        return Perceptions.from_arrays(
            scan.stamp_ns,
            Kind.MARKER,
            np.array([5.0]),
            np.array([self._bearing]),
            polar_covariances(np.array([0.1]), np.array([0.01])),
        )


class Thrower(Post):
    def detect(self, scan: LaserScan) -> Perceptions:
        if scan.stamp_ns % 2:
            raise ZeroDivisionError("odd\nstamp")
        return super().detect(scan)


class Sleeper(Post):
    def detect(self, scan: LaserScan) -> Perceptions:
        time.sleep(0.3)
        return super().detect(scan)


class Liar(Post):
    def detect(self, scan: LaserScan) -> Perceptions:
        return super().detect(scan_at(scan.stamp_ns + 1))


KINDS = {
    "post": DetectorType(PostSettings, Post),
    "thrower": DetectorType(PostSettings, Thrower),
    "sleeper": DetectorType(PostSettings, Sleeper),
    "liar": DetectorType(PostSettings, Liar),
    "other-sensor": DetectorType(PostSettings, Thrower, looks_at=DepthImage),
}


@pytest.fixture(autouse=True)
def detectors(monkeypatch: pytest.MonkeyPatch) -> None:
    def create(name: str, values: dict[str, object]) -> object:
        return KINDS[name].build(KINDS[name].settings.model_validate(values))

    monkeypatch.setattr(bank_module, "detector_type", KINDS.__getitem__)
    monkeypatch.setattr(bank_module, "create_detector", create)


def scan_at(stamp_ns: int) -> LaserScan:
    return LaserScan(stamp_ns, GEOMETRY, np.full(201, np.inf))


def test_what_all_detectors_find_is_seen_from_base() -> None:
    bank = DetectorBank({"post": {}, "thrower": {"bearing": 1.0}})
    found = bank.perceive(scan_at(2))
    assert found.stamp_ns == 2
    np.testing.assert_allclose(found.ranges_m[0], 6.0)
    assert len(found) == 2
    assert bank.faults == ()


def test_what_two_detectors_find_in_one_scan_is_one_thing() -> None:
    assert len(DetectorBank({"post": {}, "thrower": {}}).perceive(scan_at(2))) == 1


def test_one_that_throws_is_named_and_counted_and_left_out_of_that_scan_alone() -> None:
    bank = DetectorBank({"post": {}, "thrower": {"bearing": 1.0}})
    assert [len(bank.perceive(scan_at(stamp_ns))) for stamp_ns in range(6)] == [2, 1] * 3
    assert bank.faults == ("detector thrower left out of 3 measurements: ZeroDivisionError: odd",)


def test_one_that_stalls_is_left_out_until_it_is_replaced() -> None:
    bank = DetectorBank({"post": {}, "sleeper": {"bearing": 1.0}}, stall_s=0.05)
    started = time.monotonic()
    assert [len(bank.perceive(scan_at(stamp_ns))) for stamp_ns in range(20)] == [1] * 20
    assert time.monotonic() - started < 0.25
    (fault,) = bank.faults
    assert fault.startswith("detector sleeper left out of 1 measurements: no answer within 0.05 s")
    bank.replace({"post": {}, "sleeper": {"bearing": 1.0}})
    assert len(bank.perceive(scan_at(30))) == 1
    assert bank.faults[0].startswith("detector sleeper left out of 2 measurements")


def test_perceptions_of_another_moment_are_a_fault() -> None:
    bank = DetectorBank({"liar": {}})
    assert len(bank.perceive(scan_at(0))) == 0
    assert "stamp" in bank.faults[0]


def test_a_detector_sees_only_its_class_of_measurements() -> None:
    bank = DetectorBank({"other-sensor": {}})
    assert len(bank.perceive(scan_at(1))) == 0
    assert bank.faults == ()
    assert not bank.looks_at(scan_at(1))


def test_settings_and_detectors_change_between_two_scans() -> None:
    bank = DetectorBank({"post": {}})
    assert bank.perceive(scan_at(0)).bearings[0] == 0.0
    bank.replace({"post": {"bearing": 0.5}})
    assert bank.perceive(scan_at(1)).bearings[0] > 0.0
    bank.replace({"thrower": {}})
    assert len(bank.perceive(scan_at(3))) == 0
    bank.replace({})
    assert len(bank.perceive(scan_at(4))) == 0


@pytest.mark.parametrize("bad", [{"post": {"colour": 3}}, {"unheard-of": {}}])
def test_a_change_that_cannot_be_is_refused_and_nothing_changes(
    bad: dict[str, dict[str, object]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    bank = DetectorBank({"reflectors": {}})
    with pytest.raises(SettingsError):
        bank.replace({"reflectors": {}, **bad})
    assert bank.choices == {"reflectors": {}}
    assert list(bank.effective()) == ["reflectors"]


def test_a_bad_choice_is_refused_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    with pytest.raises(SettingsError):
        DetectorBank({"trees-2d": {"max_misfit": "wide"}})


def test_an_observer_is_told_of_every_answer_and_of_no_fault() -> None:
    told: list[tuple[str, int, float]] = []
    bank = DetectorBank(
        {"post": {}, "thrower": {}},
        observe=lambda name, found, seconds: told.append((name, len(found), seconds)),
    )
    for stamp_ns in range(2):
        bank.perceive(scan_at(stamp_ns))
    assert [(name, count) for name, count, _ in told] == [("post", 1), ("thrower", 1), ("post", 1)]
    assert all(seconds >= 0.0 for *_, seconds in told)
