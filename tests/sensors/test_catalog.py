"""Finding sources, their options, and the battery that every entry of the catalog passes."""

import subprocess
import sys
from pathlib import Path

import pytest

from semgraph.errors import InputError, SettingsError
from sensors.catalog import open_source, source_names, source_options
from sensors.truth import TrueLandmarks, TruePath, Truth
from tests.sensors.sources import check_recording, opened, perceptions_of, same

REAL_SOURCES = ["car_park", "victoria_park", "mrclam6", "wild_v03"]


@pytest.mark.shared_data
@pytest.mark.parametrize("source", REAL_SOURCES)
def test_a_real_folder_keeps_the_promises_of_recordings(shared_data: Path, source: str) -> None:
    recording = opened(str(shared_data / source)).recording
    check_recording(recording)
    allowed = {"LaserScan", "Perceptions", "WheelOdometry"}
    assert {type(m).__name__ for m in recording.measurements} <= allowed


def test_the_graph_of_the_wheel_keeps_the_promises_of_recordings() -> None:
    check_recording(opened("victoria-park-graph").recording)


@pytest.mark.shared_data
@pytest.mark.parametrize("source", [*REAL_SOURCES, "victoria-park-graph"])
def test_truth_lies_apart(shared_data: Path, source: str) -> None:
    place = str(shared_data / source) if source in REAL_SOURCES else source
    recording = opened(place).recording
    held = [getattr(recording, name) for name in recording.__slots__]
    assert not any(isinstance(value, Truth | TruePath | TrueLandmarks) for value in held)


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("source", "option"),
    [("car_park", "gnss"), ("victoria-park-graph", "identities")],
)
def test_text_of_a_command_line_sets_an_option(shared_data: Path, source: str, option: str) -> None:
    place = source if source == "victoria-park-graph" else str(shared_data / source)
    as_text = open_source(place, {option: "true"}).recording
    as_value = open_source(place, {option: True}).recording
    otherwise = opened(place).recording
    assert same(as_text.measurements, as_value.measurements)
    assert not same(as_text.measurements, otherwise.measurements)


@pytest.mark.shared_data
def test_a_name_before_a_folder_chooses_the_reader(shared_data: Path) -> None:
    named = open_source(f"mrclam:{shared_data / 'mrclam6'}", {"robot": "1"})
    assert same(named, opened(str(shared_data / "mrclam6")))


@pytest.mark.shared_data
@pytest.mark.parametrize("source", ["mrclam6", "victoria-park-graph"])
def test_associations_pair_with_perceptions(shared_data: Path, source: str) -> None:
    source_ = opened(str(shared_data / source) if source == "mrclam6" else source)
    assert source_.truth.associations is not None
    sizes = {scan.stamp_ns: len(scan) for scan in perceptions_of(source_.recording)}
    assert {stamp: len(rows) for stamp, rows in source_.truth.associations.items()} == sizes


@pytest.mark.parametrize("name", source_names())
def test_every_name_tells_its_options(name: str, tmp_path: Path) -> None:
    has_no_place = name == "victoria-park-graph" or name.startswith("course:")
    options = source_options(name if has_no_place else f"{name}:{tmp_path}")
    assert options().model_dump() is not None


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("course:papr", "did you mean 'course:paper'"),
        ("car-parc", "did you mean 'car-park'"),
        ("nowhere/at/all", "known: car-park"),
        ("", "nothing in this folder|expected a folder"),
        ("car-park", "car-park:FOLDER"),
        ("mrclam:nowhere", "expected a folder"),
        ("\0", "expected a folder"),
        ("x" * 5000, "expected a folder"),
    ],
)
def test_an_unknown_source_is_refused(
    source: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=expected) as refusal:
        open_source(source, {})
    assert "\n" not in str(refusal.value)


def test_a_folder_of_nothing_known_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing in this folder is known.*mrclam"):
        open_source(str(tmp_path), {})


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"identitys": True}, "did you mean 'identities'"),
        ({"identities": "perhaps"}, "option identities: .* got 'perhaps'"),
    ],
)
def test_a_wrong_option_is_refused(options: dict[str, object], expected: str) -> None:
    with pytest.raises(SettingsError, match=expected):
        open_source("victoria-park-graph", options)


def test_the_catalog_loads_no_reader_and_no_heavy_package() -> None:
    code = (
        "import sys, sensors.catalog; "
        "print([m for m in sys.modules if m.split('.')[0] in ('scipy', 'gtsam', 'matplotlib') "
        "or m in ('sensors.car_park', 'sensors.mrclam')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_reading_the_graph_does_not_import_gtsam() -> None:
    code = (
        "import sys; from sensors.catalog import open_source; "
        "open_source('victoria-park-graph', {}); print('gtsam' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
