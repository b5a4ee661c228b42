"""What is asked of every course from raw measurements."""

from itertools import islice, takewhile
from pathlib import Path

import numpy as np
import pytest

from evaluation.metrics import judge
from semgraph.errors import SettingsError
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.settings import Settings
from sensors.catalog import open_source, source_names
from sensors.measurements import DepthImage, ImuSample, LaserScan, Measurement, Raw, Recording
from sensors.plain_folder import PlainOptions, read
from sensors.plain_writing import write
from tests.sensors.simulation.courses.small import SMALL, opened_small, small
from tests.sensors.sources import check_recording, same, scans_of

COURSES = sorted(SMALL)


def some_of(recording: Recording) -> list[Measurement]:
    """All up to the sixth scan."""
    scans = (m for m in recording.measurements if isinstance(m, Raw))
    last = next(islice(scans, 5, None)).stamp_ns
    return list(takewhile(lambda m: m.stamp_ns <= last, recording.measurements))


def test_every_course_is_tested() -> None:
    courses = {name for name in source_names() if name.startswith("course:")}
    ready = {"course:perceptions", "course:eight", "course:lanes"}
    assert courses == {*COURSES, *ready}


@pytest.mark.parametrize("name", COURSES)
def test_a_course_keeps_the_promises_of_recordings(name: str) -> None:
    recording = small(name).recording
    check_recording(recording)
    assert recording.name == name
    assert any(isinstance(m, ImuSample) and m.tilt is not None for m in recording.measurements)


@pytest.mark.parametrize("name", COURSES)
def test_the_same_seed_gives_the_same_course_and_another_another(name: str) -> None:
    one, other = small(name), opened_small(name, seed=2)
    again = opened_small(name, seed=1)
    assert same(some_of(one.recording), some_of(again.recording))
    assert same(one.truth, again.truth)
    assert not same(some_of(one.recording)[-1], some_of(other.recording)[-1])


@pytest.mark.parametrize("name", COURSES)
def test_truth_covers_the_run(name: str) -> None:
    source = small(name)
    path, landmarks, in_sight = source.truth.path, source.truth.landmarks, source.truth.associations
    assert path is not None
    assert landmarks is not None
    assert in_sight is not None
    stamps = [scan.stamp_ns for scan in scans_of(source.recording)]
    assert path.stamps_ns[0] <= stamps[0] < stamps[-1] <= path.stamps_ns[-1]
    assert list(in_sight) == stamps
    rows = np.concatenate(list(in_sight.values()))
    assert len(np.unique(rows)) >= 5
    assert ((rows >= 0) & (rows < len(landmarks.kinds))).all()
    assert path.headings is not None
    start = np.append(path.world_t_reference[0], path.headings[0])
    np.testing.assert_array_equal(source.recording.map_T_start.as_array(), start)


@pytest.mark.parametrize("name", COURSES)
def test_a_course_runs_from_end_to_end(name: str) -> None:
    source = small(name)
    settings = Settings()
    perceiver = Perceiver(source.recording, settings)
    result = run(source.recording, settings, perceiver, Silence(), {})
    values = {metric.name: metric.value for metric in judge(result, source.truth)}
    assert values["trajectory_rmse_m"] < 0.1
    assert values["map_rmse_m"] < 0.15
    assert values["landmarks_found"] >= 5.0
    assert perceiver.events == ()


@pytest.mark.parametrize("name", COURSES)
def test_a_course_survives_a_plain_folder(name: str, tmp_path: Path) -> None:
    source = small(name)
    write(source, tmp_path / "written")
    back = read(tmp_path / "written", PlainOptions())
    check_recording(back.recording)
    assert same(list(back.recording.filters), list(source.recording.filters))
    for one, other in zip(source.recording.measurements, back.recording.measurements, strict=True):
        if isinstance(one, DepthImage):
            assert isinstance(other, DepthImage)
            assert (one.stamp_ns, one.camera, one.tilt) == (
                other.stamp_ns,
                other.camera,
                other.tilt,
            )
            np.testing.assert_allclose(one.depths_m, other.depths_m, rtol=0.0, atol=5.01e-4)
        else:
            assert same(one, other), type(one)
    assert back.recording.map_T_start == source.recording.map_T_start
    assert same(back.truth.landmarks, source.truth.landmarks)


@pytest.mark.parametrize("name", COURSES)
@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("seed", "-1", "greater than or equal to 0"),
        ("track_radius_m", "inf", "less than or equal"),
        ("track_radius_m", "nan", "option track_radius_m"),
        ("overlap_s", "long", "valid number"),
        ("sed", "1", "did you mean 'seed'"),
    ],
)
def test_a_bad_option_is_refused_in_one_line(
    name: str, option: str, value: str, expected: str
) -> None:
    with pytest.raises(SettingsError, match=expected) as refusal:
        open_source(name, {option: value})
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("value", ["0.3", "", "x", 1, None, [0.5], "0.50001"])
def test_the_laser_has_two_beam_spacings(value: object) -> None:
    with pytest.raises(SettingsError, match=r"beam_spacing_deg: .* 0.25 or 0.5"):
        open_source("course:paper", {"beam_spacing_deg": value})


def test_a_fine_laser_turns_slower_and_is_deskewed_longer() -> None:
    recording = opened_small("course:paper", beam_spacing_deg="0.25").recording
    scan = scans_of(recording)[0]
    assert isinstance(scan, LaserScan)
    assert len(scan.ranges_m) == 1081
    assert recording.filters[-1]["sweep_s"] == pytest.approx(0.03)
