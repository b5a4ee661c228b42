"""Tables of text, files and stamps."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from semgraph.errors import InputError
from sensors.files import read_bytes, read_text
from sensors.stamps import seconds
from sensors.text_table import TextTable


def csv_table(folder: Path, text: str) -> TextTable:
    (folder / "a.csv").write_text(text, encoding="utf-8")
    return TextTable.of_csv(folder / "a.csv", ("stamp_s", "x"), ("y",))


def test_columns_come_in_any_order_and_lines_are_counted(tmp_path: Path) -> None:
    table = csv_table(tmp_path, "\ufeffx, stamp_s\n1,0.5\n\n 2 ,1.5\n")
    assert table.lines.tolist() == [2, 4]
    assert table.numbers("x").tolist() == [1.0, 2.0]
    assert table.stamps_ns("stamp_s").tolist() == [500_000_000, 1_500_000_000]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("stamp_s,z\n", "line 1: unknown column 'z'.* known: stamp_s, x, y"),
        ("stamp_s,x,x\n", "line 1: column 'x' stands there twice"),
        ("x\n", "line 1: expected a column stamp_s"),
        ("stamp_s,x\n1\n", "line 2: expected 2 values, got 1"),
        ("stamp_s,x\n\n1,0x1\n", "line 3: x: expected a finite number, got '0x1'"),
        ("stamp_s,x\n1,1e11\n", "line 2: x: expected a finite number"),
    ],
)
def test_a_fault_is_named_with_its_line(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError, match=f"a.csv: {expected}"):
        csv_table(tmp_path, text).numbers("x")


@given(stamp_ns=st.integers(min_value=-(10**18), max_value=2 * 10**18))
def test_a_stamp_is_written_and_read_to_the_nanosecond(stamp_ns: int) -> None:
    table = TextTable(Path("a"), np.array([1]), {"t": [seconds(stamp_ns)]})
    assert table.stamps_ns("t").tolist() == [stamp_ns]


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"ok\xff")
    with pytest.raises(InputError, match="expected text in UTF-8, got bytes at 2"):
        read_text(tmp_path / "a")


def test_a_file_beyond_the_limit_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(1025))
    assert len(read_bytes(tmp_path / "a", 1025)) == 1025
    with pytest.raises(InputError, match="expected at most"):
        read_bytes(tmp_path / "a", 1024)
