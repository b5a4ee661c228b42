"""Filters and detectors of a run, changed while it goes on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from semgraph.errors import InputError, SettingsError
from semgraph.geometry import Pose2
from semgraph.perceiving import Perceiver
from semgraph.settings import load_settings
from sensors.measurements import LaserScan, Mounting, PointCloud, Recording, ScannerGeometry

GEOMETRY = ScannerGeometry(-1.0, 0.01, 0.1, 50.0)
RECORDING = Recording("two posts", [], 0, detectors={"reflectors": {}})


def scan_with_posts(stamp_ns: int) -> LaserScan:
    """Bright beams at 5 m ahead and at 12 m to the left."""
    ranges_m = np.full(201, np.inf)
    intensities = np.zeros(201)
    for beams, range_m in ((slice(99, 102), 5.0), (slice(180, 183), 12.0)):
        ranges_m[beams] = range_m
        intensities[beams] = 1000.0
    return LaserScan(stamp_ns, GEOMETRY, ranges_m, intensities)


def perceiver(*assignments: str, live: Path | None = None) -> Perceiver:
    return Perceiver(RECORDING, load_settings(None, list(assignments)), live)


def test_filters_come_before_detectors() -> None:
    assert len(perceiver().perceive(scan_with_posts(0)).perceptions) == 2
    near = perceiver('filters=[{name = "range", max_m = 8.0}]')
    assert len(near.perceive(scan_with_posts(0)).perceptions) == 1


def test_settings_change_between_two_scans_and_none_is_lost(tmp_path: Path) -> None:
    live = tmp_path / "live.toml"
    running = perceiver(live=live)
    counts = [len(running.perceive(scan_with_posts(0)).perceptions)]
    for text in (
        '[[filters]]\nname = "range"\nmax_m = 8.0\n',
        "[detectors]\nreflectors = false\n[detectors.trees-2d]\n",
        "[detectors.reflectors]\nno_such_setting = 1\n",
        "[[[",
        "",
    ):
        live.write_text(text)
        counts.append(len(running.perceive(scan_with_posts(1)).perceptions))
    assert counts[:2] == [2, 1]
    assert counts[2] == counts[3] == counts[4]
    assert counts[5] == 2
    assert len(running.events) == 5
    assert "trees-2d" in running.events[1]
    assert all("unchanged" in event for event in running.events[2:4])


def test_what_is_found_is_carried_to_the_stamp_by_the_motion() -> None:
    turning = perceiver('filters=[{name = "deskew", sweep_s = 0.04, stamp_position = 0.0}]')
    still = turning.perceive(scan_with_posts(0)).perceptions
    turning.moved(Pose2(0.0, 0.0, 0.1), 0.1)
    moved = turning.perceive(scan_with_posts(1)).perceptions
    turned = moved.bearings - still.bearings
    assert turned[0] == pytest.approx(0.02, abs=0.001)
    assert turned[1] == pytest.approx(0.04 * 181 / 200, abs=0.001)


def test_measurements_that_no_detector_takes_are_refused() -> None:
    cloud = PointCloud(0, Mounting(), np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
    with pytest.raises(InputError, match="PointCloud"):
        perceiver().perceive(cloud)


@pytest.mark.parametrize(
    "assignment",
    [
        'filters=[{name = "rnage"}]',
        "filters=[{",
        "detectors.reflectors.colour=1",
        "detectors.reflector.min_hits=1",
    ],
)
def test_bad_choices_are_refused_at_the_start(assignment: str) -> None:
    with pytest.raises(SettingsError) as error:
        perceiver(assignment)
    assert "\n" not in str(error.value)


def test_a_view_is_of_the_filtered_scan_and_a_device_code_is_clear_sight() -> None:
    """0.0 m of an LMS1xx is no return, not a thing right before the laser."""
    scan = scan_with_posts(0)
    coded = replace(scan, ranges_m=np.where(np.isinf(scan.ranges_m), 0.0, scan.ranges_m))
    there = (Pose2(), np.array([[5.0, 3.0]]), np.array([0.6]))
    codes, near = '{name="invalid"}', '{name="range",max_m=5.0}'
    for filters, sees in ((f"[{codes}]", True), (f"[{codes},{near}]", False), ("[]", False)):
        view = perceiver(f"filters={filters}").perceive(coded).view
        assert view is not None
        assert view.sees(*there)[0] == sees
