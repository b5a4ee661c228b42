from pathlib import Path

import pytest

from semgraph.errors import SettingsError
from semgraph.fast_estimator import Rules
from semgraph.settings import load_settings


def test_flags_win_over_the_file_and_the_file_over_defaults(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("[fast]\nsearch_radius_m = 0.7\ninsert_radius_m = 0.2\n[source]\nseed = 4\n")
    settings = load_settings(file, ["fast.search_radius_m=0.9", "fast.rules=paper", "robot=3"])
    assert settings.fast.search_radius_m == 0.9
    assert settings.fast.insert_radius_m == 0.2
    assert settings.fast.rules is Rules.PAPER
    assert settings.source == {"seed": 4, "robot": "3"}
    assert settings.tracker.memory_m == 20.0


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("fast.serch_radius_m=1", "search_radius_m"),
        ("fst.rules=paper", "fast"),
        ("fast.search_radius_m=-1", "greater than 0"),
        ("fast.search_radius_m=nan", "fast.search_radius_m"),
        ("fast.rules", "key=value"),
    ],
)
def test_what_is_unknown_or_impossible_is_refused_with_the_nearest(
    assignment: str, words: str
) -> None:
    with pytest.raises(SettingsError, match=words) as error:
        load_settings(None, [assignment])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["[fast", "fast = 3", "\x00", "[nonsense]\n"])
def test_a_bad_file_is_refused_by_name(tmp_path: Path, text: str) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(SettingsError, match=r"bad\.toml"):
        load_settings(file, [])
    with pytest.raises(SettingsError, match="missing"):
        load_settings(tmp_path / "missing.toml", [])


@pytest.mark.parametrize("text", ["a = " + "9" * 5000, "a = " + "[" * 100_000, 'a = "\0'])
def test_hostile_settings_are_one_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(SettingsError, match=r"bad\.toml") as error:
        load_settings(file, [])
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_a_device_is_no_settings_file() -> None:
    with pytest.raises(SettingsError, match="expected a file, got a folder or device"):
        load_settings(Path("/dev/zero"), [])
    with pytest.raises(SettingsError, match="expected TOML"):
        load_settings(None, ["filters=" + "[" * 100_000])
