"""The bench of constellations: what is seen is what stands there, wrong and sure are counted."""

from pathlib import Path

import numpy as np
import pytest

from evaluation.benches.bench_constellation import (
    CONFIDENT,
    SECTIONS,
    WELL_MAPPED,
    Look,
    Outcome,
    elsewhere,
    forest,
    found_again,
    looks_at,
    mapped,
    orchard,
    pose_within,
    real_stand,
    seen,
)
from semgraph.errors import InputError


def test_what_is_seen_stands_there() -> None:
    rng = np.random.default_rng(0)
    stand = forest(rng)
    look = Look(sigma_m=1e-6, missed=0.0, clutter=0.0)
    world_T_base = pose_within(stand, 20.0, rng)
    group = seen(stand, world_T_base, look, rng)
    distances = np.linalg.norm(stand.positions - (world_T_base.x, world_T_base.y), axis=1)
    assert len(group) == (distances <= look.within_m).sum()
    there = world_T_base.transform(group.positions)
    gaps = np.linalg.norm(there[:, None] - stand.positions[None], axis=2).min(axis=1)
    assert gaps.max() < 1e-4


def test_misses_and_clutter_are_as_many_as_asked_for() -> None:
    rng = np.random.default_rng(0)
    stand = forest(rng)
    look = Look(within_m=200.0, missed=0.4, clutter=0.0)
    middle = pose_within(stand, 99.0, rng)
    assert len(seen(stand, middle, look, rng)) == pytest.approx(0.6 * 584, rel=0.1)
    look = Look(within_m=200.0, missed=0.0, clutter=0.5)
    assert len(seen(stand, middle, look, rng)) == pytest.approx(1.5 * 584, rel=0.1)


def test_the_map_errs_as_it_says() -> None:
    rng = np.random.default_rng(0)
    stand = forest(rng, 5000)
    group = mapped(stand, WELL_MAPPED, rng)
    assert (group.positions - stand.positions).std() == pytest.approx(0.1, rel=0.05)
    assert group.covariances[0] == pytest.approx(0.01 * np.eye(2))


def test_poses_stay_out_of_the_margin() -> None:
    rng = np.random.default_rng(0)
    stand = orchard(rng)
    poses = [pose_within(stand, 30.0, rng) for _ in range(50)]
    low, high = stand.positions.min(axis=0) + 30.0, stand.positions.max(axis=0) - 30.0
    places = np.array([[pose.x, pose.y] for pose in poses])
    assert ((places >= low) & (places <= high)).all()


def test_wrong_is_sure_and_off() -> None:
    outcomes = [
        Outcome(9, CONFIDENT + 1.0, 0.1),
        Outcome(9, CONFIDENT + 1.0, 1.5),
        Outcome(9, CONFIDENT - 1.0, 1.5),
    ]
    assert [each.confident for each in outcomes] == [True, True, False]
    assert [each.wrong for each in outcomes] == [False, True, False]


def test_a_well_mapped_forest_reaches_its_targets() -> None:
    rows = found_again(forest, WELL_MAPPED, "forest")([1])
    assert all(row.reached for row in rows), [row.texts() for row in rows]


def test_nobody_is_sure_elsewhere_or_in_rows() -> None:
    assert elsewhere([1])[0].value == 0.0
    outcomes = looks_at(orchard, Look(within_m=12.0), [1], 1, 20.0)
    assert not any(each.wrong for each in outcomes)


def test_sections_are_named_once_and_take_time() -> None:
    assert len({section.name for section in SECTIONS}) == len(SECTIONS)
    assert all(section.work > 0.0 for section in SECTIONS)


def test_a_stem_map_that_is_not_there_is_said() -> None:
    with pytest.raises(InputError, match=r"nowhere\.csv"):
        real_stand(Path("nowhere.csv")).figures[0]([1])
