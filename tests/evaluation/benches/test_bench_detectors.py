"""The bench of all detectors: sections in order, what is missing left out, files whole or none."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from rich.console import Console

from evaluation.benches.bench import Section, bench, chosen, measure, tell
from evaluation.benches.bench_detectors import SECTIONS, car_park
from evaluation.benches.bench_table import Better, Row
from semgraph.errors import InputError, SemgraphError
from semgraph.progress import Silence


def figures(seeds: Sequence[int]) -> list[Row]:
    return [Row("last seed", float(seeds[-1]), "", Better.HIGHER, 3.0)]


def missing(seeds: Sequence[int]) -> list[Row]:
    raise InputError("expected a library\nthere is none")


def broken(seeds: Sequence[int]) -> list[Row]:
    raise ZeroDivisionError


class Told(list[int]):
    def done(self, count: int) -> None:
        self.append(count)

    def note(self, text: str) -> None:
        pass


def test_sections_have_names_and_figures_of_their_own() -> None:
    assert len({section.name for section in SECTIONS}) == len(SECTIONS)
    every = [each for section in SECTIONS for each in section.figures]
    assert len(every) == len(set(every))
    assert all(section.work > 0.0 for section in SECTIONS)


def test_what_is_missing_is_left_out_and_the_rest_measured() -> None:
    told = Told()
    sections = (
        Section("one", (figures, missing, figures), 1.0),
        Section("two", (figures, figures), 3.0),
    )
    one, two = measure(sections, range(1, 4), told)
    assert (len(one.rows), one.left_out) == (1, "expected a library there is none")
    assert (len(two.rows), two.left_out) == (2, "")
    assert two.rows[0].value == 3.0
    assert told == [8, 62, 100]


def test_progress_within_figures_is_told() -> None:
    def slow(seeds: Sequence[int]) -> list[Row]:
        for k in range(4):
            tell((k + 1) / 4)
        return figures(seeds)

    told = Told()
    measure([Section("one", (slow, figures), 1.0), Section("two", (slow,), 1.0)], [1], told)
    assert told == [6, 12, 19, 25, 50, 62, 75, 88, 100]
    tell(0.5)
    assert told[-1] == 100


def test_sections_are_chosen_by_how_they_begin() -> None:
    sections = [
        Section("paper", (figures,), 1.0),
        Section("long", (figures,), 9.0, asked_only=True),
    ]
    assert [each.name for each in chosen(sections, [])] == ["paper"]
    assert [each.name for each in chosen(sections, ["lo", "pap"])] == ["paper", "long"]
    assert [each.name for each in chosen(sections, ["long"])] == ["long"]
    with pytest.raises(InputError, match="did you mean 'paper'"):
        chosen(sections, ["papr"])


def test_without_data_the_car_park_is_left_out(tmp_path: Path) -> None:
    (unnamed,) = measure([car_park(None)], [1], Silence())
    assert "--data DIR" in unnamed.left_out
    (empty,) = measure([car_park(tmp_path)], [1], Silence())
    assert str(tmp_path) in empty.left_out


@pytest.mark.shared_data
def test_the_car_park_is_found_inside_the_recordings(shared_data: Path) -> None:
    (section,) = measure([car_park(shared_data)], [1], Silence())
    assert section.left_out == ""
    assert len(section.rows) == 2


def test_both_files_are_written_or_none(tmp_path: Path) -> None:
    console = Console(quiet=True)
    folder = tmp_path / "out"
    with pytest.raises(ZeroDivisionError):
        bench(console, "detectors", [Section("one", (figures, broken), 1.0)], [1], folder)
    assert list(tmp_path.iterdir()) == []
    bench(console, "detectors", [Section("one", (figures,), 1.0)], [1, 2], folder)
    assert sorted(path.name for path in folder.iterdir()) == ["detectors.csv", "detectors.md"]
    assert "seeds 1 to 2" in (folder / "detectors.md").read_text()
    bench(console, "detectors", [Section("one", (figures,), 1.0)], [5], folder)
    assert "5.0" in (folder / "detectors.csv").read_text()
    (folder / "detectors.csv").unlink()
    with pytest.raises(SemgraphError, match="holds something else"):
        bench(console, "detectors", [Section("one", (figures,), 1.0)], [5], folder)
