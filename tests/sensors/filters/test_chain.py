"""Every filter by itself and in a chain: what none may do, and how settings are refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict

from semgraph.errors import InputError, SettingsError
from sensors.filters.chain import (
    FilterSettings,
    apply_chain,
    build_chain,
    filter_names,
    filter_settings,
)
from sensors.filters.context import UNKNOWN, ScanContext
from sensors.measurements import LaserScan, Tilt
from tests.sensors.filters.scans import CONTEXTS, SCANS, same_scan, scan_of

every_filter = pytest.mark.parametrize("name", filter_names())
MOVED = ("deskew", "level")
LEANING = ScanContext(twist=(1.0, 0.2, 0.5), tilt=Tilt(0.02, 0.03))


def _apply(names: list[str], scan: LaserScan, context: ScanContext) -> LaserScan:
    return apply_chain(build_chain(filter_settings([{"name": n} for n in names])), scan, context)


def test_the_filters_are_those_asked_for() -> None:
    known = ["deskew", "field", "invalid", "level", "median", "range", "shadow"]
    assert filter_names() == known


@every_filter
@given(scan=SCANS, context=CONTEXTS)
@settings(max_examples=40, deadline=None)
def test_no_filter_invents_a_return(name: str, scan: LaserScan, context: ScanContext) -> None:
    filtered = _apply([name], scan, context)
    returns = np.isfinite(scan.ranges_m)
    if name not in MOVED:
        assert not (np.isfinite(filtered.ranges_m) & ~returns).any()
    # What is moved may fall to other beams: what comes out lies where something came in.
    out_m = filtered.ranges_m[np.isfinite(filtered.ranges_m)]
    if not returns.any():
        assert not len(out_m)
    assert len(filtered.ranges_m) == len(scan.ranges_m)
    assert filtered.stamp_ns == scan.stamp_ns


@every_filter
@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("num_beams", [0, 1, 2, 3, 541])
def test_a_scan_of_nothing_stays_one(name: str, value: float, num_beams: int) -> None:
    scan = scan_of(np.full(num_beams, value))
    filtered = _apply([name], scan, LEANING)
    assert len(filtered.ranges_m) == num_beams
    assert not np.isfinite(filtered.ranges_m).any()
    if value == np.inf and name not in MOVED:
        # But for the reach, which the range filter may shorten.
        reach_m = scan.geometry.range_max_m
        assert filtered.geometry.range_max_m <= reach_m
        whole = replace(filtered, geometry=replace(filtered.geometry, range_max_m=reach_m))
        same_scan(whole, scan)


@pytest.mark.parametrize("name", ["range", "field", "invalid"])
@given(scan=SCANS)
def test_limits_twice_are_limits_once(name: str, scan: LaserScan) -> None:
    once = _apply([name], scan, UNKNOWN)
    same_scan(_apply([name], once, UNKNOWN), once)


@pytest.mark.parametrize("name", MOVED)
@given(scan=SCANS)
def test_a_filter_without_its_input_changes_nothing(name: str, scan: LaserScan) -> None:
    assert _apply([name], scan, UNKNOWN) is scan


@pytest.mark.parametrize("name", MOVED)
@given(scan=SCANS)
def test_standing_level_changes_nothing(name: str, scan: LaserScan) -> None:
    still = ScanContext(twist=(0.0, 0.0, 0.0), tilt=Tilt())
    np.testing.assert_allclose(_apply([name], scan, still).ranges_m, scan.ranges_m, atol=1e-11)


@given(scan=SCANS, names=st.lists(st.sampled_from(filter_names()), max_size=5), context=CONTEXTS)
@settings(deadline=None)
def test_a_chain_is_its_filters_one_after_the_other(
    scan: LaserScan, names: list[str], context: ScanContext
) -> None:
    step_by_step = scan
    for name in names:
        step_by_step = _apply([name], step_by_step, context)
    same_scan(_apply(names, scan, context), step_by_step)


@every_filter
def test_a_scan_without_intensities_has_none_afterwards(name: str) -> None:
    bare = LaserScan(1, scan_of([1.0]).geometry, np.full(541, 5.0))
    assert _apply([name], bare, LEANING).intensities is None


def test_a_settings_model_takes_the_list() -> None:
    class Section(BaseModel):
        model_config = ConfigDict(frozen=True, extra="forbid")

        filters: list[FilterSettings]

    section = Section.model_validate({"filters": [{"name": "range", "max_m": 30.0}]})
    assert section.filters == filter_settings([{"name": "range", "max_m": 30.0}])
    scan = apply_chain(build_chain(section.filters), scan_of([29.0, 31.0]))
    assert scan.ranges_m.tolist() == [29.0, np.inf]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"name": "rnage"}, r"filters: 0: unknown filter 'rnage', did you mean 'range'\?"),
        ({}, "filters: 0: unknown filter ''"),
        ({"name": 3}, "filters: 0: unknown filter 3"),
        ({"name": "range", "maxm": 3.0}, r"0 \(range\): unknown setting 'maxm', .*'max_m'"),
        ({"name": "range", "max_m": "far"}, r"0 \(range\): max_m: .*got 'far'"),
        ({"name": "range", "min_m": 60.0}, "expected min_m below max_m"),
        ({"name": "range", "max_m": float("inf")}, "max_m: "),
        ({"name": "field", "bearing_min": 1.0, "bearing_max": 0.0}, "expected bearing_min below"),
        ({"name": "median", "num_beams": 4}, "expected an odd number"),
        ({"name": "median", "num_beams": 0}, "num_beams: "),
        ({"name": "shadow", "min_angle": 0.0}, "min_angle: "),
        ({"name": "deskew", "sweep_s": -0.015}, "sweep_s: "),
        ({"name": "deskew", "stamp_position": 1.5}, "stamp_position: "),
        ({"name": "level", "height_m": float("nan")}, "height_m: "),
    ],
)
def test_bad_settings_are_refused_in_one_line(table: dict[str, object], said: str) -> None:
    with pytest.raises(SettingsError, match=said) as caught:
        filter_settings([table])
    assert "\n" not in str(caught.value)


VALUES = st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.lists(st.integers())
KEYS = st.sampled_from(["name", "min_m", "max_m", "num_beams", "sweep_s", "x"])
TABLES = st.dictionaries(KEYS, VALUES | st.sampled_from(filter_names()), max_size=4)


@given(tables=st.lists(TABLES | VALUES, max_size=3))
@settings(max_examples=150)
def test_any_table_is_a_filter_or_a_settings_error(tables: list[dict[str, object]]) -> None:
    try:
        built = filter_settings(tables)
    except SettingsError as refusal:
        said = str(refusal)
    else:
        said = ""
        assert len(built) == len(tables)
    assert "\n" not in said


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_twist_that_is_not_finite_is_refused(bad: float) -> None:
    with pytest.raises(InputError, match="expected a finite vx, vy, omega"):
        ScanContext(twist=(0.0, bad, 0.0))
