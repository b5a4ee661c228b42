"""What disturbs perception: blindness, people who walk; and what stays as it is without."""

import numpy as np
import pytest

from semgraph.landmarks import Perceptions
from sensors.catalog import open_source
from sensors.truth import Source

SHORT: dict[str, object] = {"seed": 2, "track_radius_m": 10.0, "num_trees": 40, "lap_s": 20.0}


def scans_of(source: Source) -> list[Perceptions]:
    return [part for part in source.recording.measurements if isinstance(part, Perceptions)]


def test_blindness_empties_scans_and_changes_nothing_else() -> None:
    clear = open_source("course:perceptions", SHORT)
    blind = open_source("course:perceptions", {**SHORT, "num_blind": 2, "blind_s": 1.0})
    sizes = np.array([len(scan) for scan in scans_of(blind)])
    assert 10 <= (sizes == 0).sum() <= 20
    assert sizes[0] > 0
    gaps = np.flatnonzero(np.diff(np.concatenate([[0], sizes == 0, [0]]).astype(int)) == 1)
    assert len(gaps) in (1, 2)
    associations = blind.truth.associations
    assert associations is not None
    assert [len(rows) for rows in associations.values()] == sizes.tolist()
    assert clear.truth.landmarks is not None
    assert blind.truth.landmarks is not None
    assert np.array_equal(
        clear.truth.landmarks.world_t_landmarks, blind.truth.landmarks.world_t_landmarks
    )


def test_what_walks_is_perceived_and_is_no_landmark() -> None:
    source = open_source("course:perceptions", {**SHORT, "moving": 0.5, "missed": 0.0})
    assert source.truth.landmarks is not None
    assert len(source.truth.landmarks.kinds) == 40
    associations = source.truth.associations
    assert associations is not None
    rows = np.concatenate(list(associations.values()))
    assert rows.max() == 39
    walking = (rows == -1).mean()
    assert 0.1 < walking < 0.6
    still = open_source("course:perceptions", {**SHORT, "missed": 0.0}).truth.associations
    assert still is not None
    assert (np.concatenate(list(still.values())) >= 0).all()


def test_a_walker_goes_on_at_walking_speed() -> None:
    source = open_source(
        "course:perceptions", {**SHORT, "num_trees": 1, "moving": 1.0, "missed": 0.0}
    )
    path, associations = source.truth.path, source.truth.associations
    assert path is not None
    assert path.headings is not None
    assert associations is not None
    places: dict[int, np.ndarray] = {}
    for k, scan in enumerate(scans_of(source)):
        turn, rows = path.headings[k], associations[scan.stamp_ns]
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        for point in scan.base_t_landmarks()[rows == -1]:
            places[scan.stamp_ns] = R @ point + path.world_t_reference[k]
    stamps = sorted(places)
    apart = [(a, b) for a, b in zip(stamps, stamps[5:], strict=False) if b - a == 500_000_000]
    speeds = [float(np.linalg.norm(places[b] - places[a])) / 0.5 for a, b in apart]
    assert len(speeds) > 10
    assert np.median(speeds) == pytest.approx(1.2, abs=0.15)
