from datetime import datetime
from pathlib import Path

import pytest

from semgraph.errors import SemgraphError
from semgraph.files.staging import new_results_folder, point_latest, staged_folder

NOW = datetime(2026, 3, 1, 12, 30, 5)


def fill(folder: Path, text: str) -> None:
    with staged_folder(folder, "marker") as staging:
        (staging / "marker").write_text(text)


def test_the_folder_takes_its_name_only_at_the_end(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "run"
    with staged_folder(folder, "marker") as staging:
        (staging / "marker").write_text("new")
        assert not folder.exists()
    assert (folder / "marker").read_text() == "new"
    assert list(folder.parent.iterdir()) == [folder]


def test_an_empty_folder_and_an_earlier_one_are_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    for text in ("first", "second"):
        fill(folder, text)
        assert (folder / "marker").read_text() == text
    assert list(tmp_path.iterdir()) == [folder]


def test_the_link_latest_is_followed(tmp_path: Path) -> None:
    fill(tmp_path / "run", "first")
    assert point_latest(tmp_path / "run") is None
    fill(tmp_path / "latest", "second")
    assert (tmp_path / "run" / "marker").read_text() == "second"
    assert (tmp_path / "latest").is_symlink()


def test_something_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("dear")
    with pytest.raises(SemgraphError, match="holds something else"):
        fill(tmp_path, "new")
    with pytest.raises(SemgraphError, match="it is a file"):
        fill(tmp_path / "thesis.txt", "new")
    assert (tmp_path / "thesis.txt").read_text() == "dear"


def fail(folder: Path, error: BaseException) -> None:
    with staged_folder(folder, "marker") as staging:
        (staging / "half").write_text("half")
        raise error


def test_a_failure_or_an_interrupt_leaves_nothing(tmp_path: Path) -> None:
    for error in (ValueError("broken"), KeyboardInterrupt()):
        with pytest.raises(type(error)):
            fail(tmp_path / "run", error)
    assert not list(tmp_path.iterdir())


def test_a_failure_leaves_no_empty_parent(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), staged_folder(tmp_path / "results" / "run", "marker"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_impossible_names_are_one_line(tmp_path: Path) -> None:
    for name in ("a" * 300, "nul\0byte"):
        with pytest.raises(SemgraphError, match="cannot be written") as caught:
            fill(tmp_path / name, "new")
        assert "\n" not in str(caught.value)


def test_results_are_named_after_the_time_and_never_twice(tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        folder = new_results_folder(tmp_path, NOW)
        folder.mkdir()
        names.append(folder.name)
    assert names == ["2026-03-01T12-30-05", "2026-03-01T12-30-05-2", "2026-03-01T12-30-05-3"]


def test_latest_moves_on(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        assert point_latest(tmp_path / name) is None
        assert (tmp_path / "latest").resolve() == (tmp_path / name).resolve()


def test_a_link_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "latest").mkdir()
    (tmp_path / "run").mkdir()
    told = point_latest(tmp_path / "run")
    assert told is not None
    assert "the link could not be made" in told
    assert sorted(path.name for path in tmp_path.iterdir()) == ["latest", "run"]
