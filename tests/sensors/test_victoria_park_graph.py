"""The graph of the gtsam wheel, and graphs written by hand."""

from pathlib import Path

import numpy as np
import pytest

from semgraph.errors import InputError
from sensors.victoria_park_graph import (
    GRAPH_FILE,
    VictoriaParkGraphOptions,
    gtsam_data,
    read,
    recognises,
)
from tests.sensors.sources import odometry_of, opened, perceptions_of, write_text

EDGE = "0.0001 0 0 4e-06 0 4e-06"
GRAPH = f"""ODOMETRY 0 1 1.0 0.0 0.5 {EDGE}
LANDMARK 1 7 3.0 4.0 0.4 0 0.4
LANDMARK 1 5 2.0 0.0 0.4 0 0.4
ODOMETRY 1 2 1.0 0.0 0.0 {EDGE}
LANDMARK 2 7 2.0 -4.0 0.4 0 0.4
"""


def test_the_wheel_carries_all_of_the_graph() -> None:
    source = opened("victoria-park-graph")
    sets = perceptions_of(source.recording)
    assert recognises(gtsam_data())
    assert len(odometry_of(source.recording)) == 6969
    assert sum(map(len, sets)) == 3640
    assert not any(identity for p in sets for identity in p.identities)
    assert source.truth.associations is not None
    rows = np.concatenate(list(source.truth.associations.values()))
    assert np.array_equal(np.unique(rows), np.arange(151))


def test_a_graph_by_hand(tmp_path: Path) -> None:
    write_text(tmp_path, GRAPH_FILE, GRAPH)
    source = read(tmp_path, VictoriaParkGraphOptions(identities=True))
    first, second = perceptions_of(source.recording)
    assert (first.stamp_ns, second.stamp_ns) == (200_000_000, 400_000_000)
    assert first.ranges_m.tolist() == [5.0, 2.0]
    assert first.identities.tolist() == ["7", "5"]
    last = odometry_of(source.recording)[-1].odom_T_base
    assert (last.x, last.y, last.theta) == pytest.approx((1 + np.cos(0.5), np.sin(0.5), 0.5))
    assert source.truth.associations is not None
    assert source.truth.associations[200_000_000].tolist() == [1, 0]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("ODOMETRY 1 2", "ODOMETRY 1 1", "line 4: expected a chain"),
        ("ODOMETRY 1 2", "ODOMETRY 0 2", "line 4: expected a chain"),
        ("LANDMARK 1 7", "LANDMARK 9 7", "line 2: expected a pose met before, got 9"),
        ("3.0 4.0", "nan 4.0", "line 2: expected finite"),
        ("3.0 4.0", "3.0 1e999", "line 2: expected finite"),
        ("3.0 4.0", "0 0", "line 2: expected a landmark apart"),
        ("3.0 4.0", "three 4.0", "line 2: expected numbers"),
        ("LANDMARK 2", "VERTEX 2", "line 5: expected ODOMETRY"),
        (" 0.4 0 0.4\nODO", " 0.4\nODO", "line 3: expected ODOMETRY"),
        ("1.0 0.0 0.5", "\0 0.0 0.5", "NUL"),
    ],
)
def test_a_damaged_graph_is_refused_by_line(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    assert old in GRAPH
    write_text(tmp_path, GRAPH_FILE, GRAPH.replace(old, new))
    with pytest.raises(InputError, match=f"{GRAPH_FILE}.*{expected}"):
        read(tmp_path, VictoriaParkGraphOptions())


def test_a_graph_without_sightings_has_nothing_to_run(tmp_path: Path) -> None:
    write_text(tmp_path, GRAPH_FILE, "")
    with pytest.raises(InputError, match="at least one LANDMARK"):
        read(tmp_path, VictoriaParkGraphOptions())
