"""The forest's own: stem maps, a person, felled trees, uneven ground."""

from pathlib import Path

import numpy as np
import pytest

from semgraph.errors import InputError, SemgraphError
from sensors.catalog import open_source
from sensors.measurements import LaserScan
from sensors.recorded import Recorded
from sensors.simulation.courses import forest
from sensors.simulation.courses.forest import ForestOptions
from sensors.simulation.courses.laser_scans import ScansOnTheWay
from sensors.simulation.courses.stem_maps import MarkUnit, stand_from_stem_map
from sensors.simulation.world import Thing
from sensors.truth import Source
from tests.sensors.simulation.courses.small import opened_small, small
from tests.sensors.sources import same, scans_of

FELLED = {"felled": True, "speed": 2.0, "overlap_s": 0.0, "track_radius_m": 12.0, "scan_every": 10}


@pytest.fixture(scope="module")
def felled() -> Source:
    return opened_small("course:forest", seed=1, **FELLED)


def test_felled_trees_are_apart_from_those_that_stand(felled: Source) -> None:
    standing, gone = felled.truth.landmarks, felled.truth.felled
    assert standing is not None
    assert gone is not None
    assert len(gone.kinds) == ForestOptions().num_felled
    gaps_m = np.linalg.norm(
        standing.world_t_landmarks[:, None] - gone.world_t_landmarks[None], axis=2
    )
    assert gaps_m.min() > 0.3
    assert small("course:forest").truth.felled is None


def test_felled_trees_are_seen_in_the_first_lap_alone(felled: Source) -> None:
    """A tree's centre is hit from its front: nothing is measured there when it is gone."""
    gone, path = felled.truth.felled, felled.truth.path
    assert gone is not None
    assert path is not None
    assert path.headings is not None
    hits = np.zeros(2, dtype=np.int64)
    scans = scans_of(felled.recording)
    for k, scan in enumerate(scans):
        assert isinstance(scan, LaserScan)
        row = int(np.searchsorted(path.stamps_ns, scan.stamp_ns))
        geometry = scan.geometry
        bearings = geometry.angle_min + geometry.angle_increment * np.arange(len(scan.ranges_m))
        angles = path.headings[row] + bearings
        c, s = np.cos(path.headings[row]), np.sin(path.headings[row])
        laser = path.world_t_reference[row] + geometry.base_T_laser.x * np.array([c, s])
        points = laser + scan.ranges_m[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        distances_m = np.linalg.norm(points[:, None] - gone.world_t_landmarks[None], axis=2)
        near = distances_m < 0.5 * gone.diameters_m + 0.05
        hits[int(k >= len(scans) // 2)] += int((near & (scan.ranges_m[:, None] < 8.0)).sum())
    assert hits[0] > 200
    assert hits[1] < 0.05 * hits[0]


def test_too_many_trees_to_fell_are_refused() -> None:
    with pytest.raises(InputError, match="expected 20 trees to fell"):
        opened_small("course:forest", **FELLED | {"num_felled": 20, "stems_per_ha": 50})


def test_a_person_walks_at_the_speed_of_one_and_touches_nothing() -> None:
    options = ForestOptions.model_validate({"seed": 3, "person": True, "overlap_s": 0.0})
    source = forest.read("course:forest", options)
    recorded = source.recording.measurements
    assert isinstance(recorded, Recorded)
    assert isinstance(recorded.measure, ScansOnTheWay)
    world_at, way = recorded.measure.world_at, recorded.measure.way
    worlds = [world_at(tick) for tick in range(0, len(way.stamps_ns), 50)]
    places = np.array([world.world_t_things[-1] for world in worlds])
    assert all(world.things[-1] == Thing.PERSON for world in worlds)
    assert all(0.35 <= 2.0 * world.radii_m[-1] <= 0.5 for world in worlds)
    speeds = np.hypot(*np.diff(places, axis=0).T)
    np.testing.assert_allclose(speeds, 1.2, rtol=0.1)
    for world, place in zip(worlds, places, strict=True):
        gaps_m = np.hypot(*(world.world_t_things[:-1] - place).T) - world.radii_m[:-1]
        assert gaps_m.min() > world.radii_m[-1] + 0.05
    assert not same(scans_of(source.recording)[3], scans_of(small("course:forest").recording)[3])


def test_level_ground_needs_no_levelling() -> None:
    level = opened_small("course:forest", tilt_sigma_rad=0.0).recording
    assert [table["name"] for table in level.filters] == ["invalid", "deskew"]
    names = [table["name"] for table in small("course:forest").recording.filters]
    assert names == ["invalid", "level", "deskew"]


def stem_map(folder: Path, unit: float, rows: int = 400) -> Path:
    rng = np.random.default_rng(5)
    table = np.column_stack([rng.uniform(100.0, 170.0, (rows, 2)), rng.uniform(0.1, 0.5, rows)])
    table[:, 2] /= unit
    file = folder / "stems.csv"
    np.savetxt(file, table, delimiter=",", header="x,y,mark", comments="", fmt="%.4f")
    return file


@pytest.mark.parametrize("unit", list(MarkUnit))
def test_a_stem_map_is_a_stand_about_the_origin(tmp_path: Path, unit: MarkUnit) -> None:
    file = stem_map(tmp_path, unit.metres)
    stand = stand_from_stem_map(file, unit, np.random.default_rng(0))
    low, high = stand.world_t_things.min(axis=0), stand.world_t_things.max(axis=0)
    np.testing.assert_allclose(low, -high, atol=1.0)
    assert ((stand.radii_m >= 0.04) & (stand.radii_m <= 0.26)).all()
    distances_m = np.linalg.norm(stand.world_t_things[:, None] - stand.world_t_things, axis=2)
    np.fill_diagonal(distances_m, np.inf)
    assert (distances_m > stand.radii_m[:, None] + stand.radii_m).all()
    assert len(stand) > 380
    source = open_source(
        "course:forest",
        {"stem_map": str(file), "mark_unit": unit.value, "overlap_s": 0, "speed": 5.0},
    )
    assert source.truth.landmarks is not None
    assert len(source.truth.landmarks.kinds) == len(stand)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "."),
        ("x,y\n1,2\n", "mark"),
        ("x,y,mark\n", "1 to 20000 stems, got 0"),
        ("x,y,mark\n1,2,0.21\n", "0.01 to 3 m in cm .choose mark_unit"),
        ("x,y,mark\n1,2,nan\n", "mark"),
        ("x,y,mark\n1,inf,20\n", "finite number"),
        ("x,y,mark\n1,2e7,20\n", "finite number"),
        ("x,y,mark\n1,2,-20\n", "choose mark_unit"),
        ("x,y,mark\n1,2\n", "."),
        ("\0", "."),
    ],
)
def test_a_bad_stem_map_is_refused_in_one_line(tmp_path: Path, content: str, expected: str) -> None:
    file = tmp_path / "stems.csv"
    file.write_text(content)
    with pytest.raises(SemgraphError, match=expected) as refusal:
        open_source("course:forest", {"stem_map": str(file)})
    assert "\n" not in str(refusal.value)
