"""Where a scan is cut, and which edges are free."""

import numpy as np
import pytest

from detectors.scan_segments import Segments, cut_scan
from detectors.tree_settings import TreeSettings
from sensors.measurements import LaserScan, ScannerGeometry

GEOMETRY = ScannerGeometry(0.0, np.radians(0.5), 0.1, 50.0)
INF, NAN = np.inf, np.nan


def _cut(*ranges_m: float) -> Segments:
    return cut_scan(LaserScan(0, GEOMETRY, np.array(ranges_m)), TreeSettings())


@pytest.mark.parametrize(
    ("ranges_m", "counts"),
    [
        ((), []),
        ((INF, INF), []),
        ((5.0, 5.0, 5.0), [3]),
        ((5.0, INF, 5.0), [2]),
        ((5.0, INF, INF, 5.0), [1, 1]),
        ((5.0, 5.0, 7.0, 7.0), [2, 2]),
        ((5.0, 5.25), [2]),
        ((5.0, 5.5), [1, 1]),
        ((0.2, 5.0, 31.0, NAN), [1]),
    ],
)
def test_cuts(ranges_m: tuple[float, ...], counts: list[int]) -> None:
    segments = _cut(*ranges_m)
    assert segments.counts.tolist() == counts
    assert segments.counts.sum() == len(segments.beams) == len(segments.ranges_m)


@pytest.mark.parametrize(
    ("beyond", "step_m"),
    [
        ((INF, INF), INF),
        ((8.0, 8.0), 3.0),
        ((3.0, 3.0), -INF),
        ((8.0, 4.0), -INF),
        ((INF, 4.0), -INF),
        ((NAN, INF), -INF),
        ((-INF, INF), -INF),
        ((), -INF),
    ],
)
def test_steps_beyond_an_edge(beyond: tuple[float, ...], step_m: float) -> None:
    segments = _cut(INF, INF, 5.0, 5.0, 5.0, *beyond)
    at = int(np.flatnonzero(segments.counts == 3)[0])
    assert segments.steps_m[0, at] == INF
    assert segments.steps_m[1, at] == step_m
    mirrored = _cut(*beyond[::-1], 5.0, 5.0, 5.0, INF, INF)
    at = int(np.flatnonzero(mirrored.counts == 3)[0])
    assert mirrored.steps_m[:, at].tolist() == [step_m, INF]


def test_selection_keeps_beams_together() -> None:
    chosen = _cut(5.0, 5.0, 9.0, 9.0, 9.0, 5.0).select(np.array([False, True, True]))
    assert chosen.beams.tolist() == [2, 3, 4, 5]
    assert chosen.starts.tolist() == [0, 3]
    assert chosen.counts.tolist() == [3, 1]
