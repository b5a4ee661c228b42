"""Scans at the start of a run are deskewed as all others are."""

from dataclasses import replace

import numpy as np
import pytest

from semgraph.files.yaw_rates import YawRateLog
from semgraph.first_motion import tell_first_motion
from semgraph.geometry import Pose2, relative_poses
from semgraph.landmarks import Perceptions
from semgraph.moments import moments
from semgraph.perceiving import Perceiver
from semgraph.settings import Settings, load_settings
from sensors.catalog import open_source
from sensors.measurements import LaserScan, Recording
from sensors.truth import Source

SETTINGS = Settings()


@pytest.fixture(scope="module")
def source() -> Source:
    return open_source("course:paper", {"seed": 1})


def first_perceptions(recording: Recording, perceiver: Perceiver) -> Perceptions:
    return next(moments(recording, perceiver, YawRateLog())).perceptions


def true_first_motion(source: Source) -> Pose2:
    path = source.truth.path
    assert path is not None
    assert path.headings is not None
    poses = np.column_stack([path.world_t_reference, path.headings])
    stamps_ns = [s.stamp_ns for s in source.recording.measurements if isinstance(s, LaserScan)][:2]
    ends = np.array([poses[np.searchsorted(path.stamps_ns, stamp_ns)] for stamp_ns in stamps_ns])
    return Pose2.from_array(relative_poses(ends[:1], ends[1:])[0])


def test_the_first_scan_is_deskewed_as_if_the_motion_were_known(source: Source) -> None:
    recording = source.recording
    told, knowing, unaware = (Perceiver(recording, SETTINGS) for _ in range(3))
    tell_first_motion(recording, told, SETTINGS.fast)
    knowing.moved(true_first_motion(source), 0.1)
    found, true, skewed = (first_perceptions(recording, each) for each in (told, knowing, unaware))
    error, skew = (np.abs(each.bearings - true.bearings).max() for each in (found, skewed))
    assert skew > 5e-4
    assert error < 0.3 * skew


def test_where_nothing_is_deskewed_nothing_is_perceived_twice(source: Source) -> None:
    looks = []

    class Counted(list[LaserScan]):
        def __iter__(self):  # type: ignore[no-untyped-def]
            looks.append(1)
            return super().__iter__()

    scans = Counted(each for each in source.recording.measurements if isinstance(each, LaserScan))
    recording = replace(source.recording, measurements=scans)
    plain = Perceiver(recording, load_settings(None, ["filters=[]"]))
    tell_first_motion(recording, plain, SETTINGS.fast)
    assert not looks
    tell_first_motion(recording, Perceiver(recording, SETTINGS), SETTINGS.fast)
    assert looks


def test_a_recording_of_one_scan_tells_no_motion(source: Source) -> None:
    scan = next(each for each in source.recording.measurements if isinstance(each, LaserScan))
    recording = replace(source.recording, measurements=[scan])
    told = Perceiver(recording, SETTINGS)
    tell_first_motion(recording, told, SETTINGS.fast)
    unaware = Perceiver(recording, SETTINGS)
    assert np.array_equal(
        first_perceptions(recording, told).bearings, first_perceptions(recording, unaware).bearings
    )
