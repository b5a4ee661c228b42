"""Range, field and device codes, beam by beam."""

import numpy as np
import pytest

from sensors.filters.limits import (
    FieldSettings,
    InvalidSettings,
    RangeSettings,
    limit_field,
    limit_range,
    read_codes,
)
from sensors.measurements import ScannerGeometry
from tests.sensors.filters.scans import scan_of


def test_near_and_far_become_too_near_and_no_return() -> None:
    scan = scan_of([0.2, 0.5, 7.0, 30.0, 30.1, np.nan, np.inf, -np.inf])
    limited = limit_range(scan, RangeSettings(min_m=0.5, max_m=30.0)).ranges_m
    np.testing.assert_array_equal(
        limited, [-np.inf, 0.5, 7.0, 30.0, np.inf, np.nan, np.inf, -np.inf]
    )


@pytest.mark.parametrize(("first", "increment"), [(-3.0, 0.1), (3.0, -0.1)])
@pytest.mark.parametrize("turn", [0.0, 2.0 * np.pi, -2.0 * np.pi])
def test_the_field_is_kept_whichever_way_the_laser_turns(
    first: float, increment: float, turn: float
) -> None:
    scan = scan_of(np.full(61, 4.0), ScannerGeometry(first + turn, increment, 0.1, 50.0))
    bearings = first + increment * np.arange(61)
    kept = np.isfinite(limit_field(scan, FieldSettings(bearing_min=-1.0, bearing_max=0.5)).ranges_m)
    np.testing.assert_array_equal(kept, (bearings > -1.0 - 1e-6) & (bearings < 0.5 + 1e-6))


def test_a_field_may_lie_astern() -> None:
    scan = scan_of(np.full(13, 4.0), ScannerGeometry(-3.0, 0.5, 0.1, 50.0))
    kept = np.isfinite(limit_field(scan, FieldSettings(bearing_min=1.5, bearing_max=4.5)).ranges_m)
    assert np.flatnonzero(~kept).tolist() == [3, 4, 5, 6, 7, 8]


def test_the_whole_default_field_of_an_lms151_is_kept() -> None:
    assert np.isfinite(limit_field(scan_of(np.full(541, 4.0)), FieldSettings()).ranges_m).all()


def test_both_codes_for_nothing_are_no_return_and_errors_are_invalid() -> None:
    scan = scan_of([0.0, 81.9, 81.91, 0.007, 0.016, 5.0, 80.0, -1.0, np.inf, -np.inf, np.nan])
    np.testing.assert_array_equal(
        read_codes(scan, InvalidSettings()).ranges_m,
        [np.inf] * 3 + [np.nan, 0.016, 5.0, 80.0, np.nan, np.inf, -np.inf, np.nan],
    )
