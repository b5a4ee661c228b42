"""The spool: what is whole comes out as it went in, what is torn does not come out."""

import os
import resource
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from semgraph.beside.spool import Spool
from semgraph.errors import SemgraphError


@pytest.fixture
def spool() -> Iterator[Spool]:
    with closing(Spool()) as made:
        yield made


@pytest.fixture
def other() -> Iterator[Spool]:
    with closing(Spool()) as made:
        yield made


def descriptor(spool: Spool) -> int:
    return spool._file.fileno()


def test_values_come_out_in_order_and_none_where_there_is_no_more(spool: Spool) -> None:
    assert spool.read() is None
    values = [{"a": 1}, np.arange(5.0), "text", (1, 2)]
    for value in values[:2]:
        spool.append(value)
    assert spool.read() == {"a": 1}
    for value in values[2:]:
        spool.append(value)
    np.testing.assert_array_equal(spool.read(), np.arange(5.0))
    assert [spool.read(), spool.read(), spool.read()] == ["text", (1, 2), None]


def test_a_half_written_tail_is_not_read_until_it_is_whole(spool: Spool, other: Spool) -> None:
    whole, torn = spool, other
    whole.append(np.arange(1000))
    frame = os.pread(descriptor(whole), 100_000, 0)
    for length in (1, 11, 12, 13, len(frame) // 2, len(frame) - 1):
        os.pwrite(descriptor(torn), frame[:length], 0)
        assert torn.read() is None
    os.pwrite(descriptor(torn), frame, 0)
    np.testing.assert_array_equal(torn.read(), np.arange(1000))


def test_a_changed_byte_is_refused(spool: Spool) -> None:
    spool.append("what was said")
    byte = os.pread(descriptor(spool), 1, 20)
    os.pwrite(descriptor(spool), bytes([byte[0] ^ 1]), 20)
    with pytest.raises(SemgraphError, match="damaged at byte 0"):
        spool.read()


def test_it_has_no_name_and_nobody_else_may_open_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with closing(Spool()) as spool:
        spool.append("x")
        assert list(tmp_path.iterdir()) == []
        assert os.fstat(descriptor(spool)).st_mode & 0o777 == 0o600


@contextmanager
def at_most(num_bytes: int) -> Iterator[None]:
    """A disk that is full after so many bytes of a file."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_is_told_and_leaves_the_spool_as_it_was(spool: Spool) -> None:
    spool.append("before")
    for limit in (1000, 10):
        with at_most(limit), pytest.raises(SemgraphError, match="TMPDIR"):
            spool.append(bytes(5000))
    spool.append("after")
    assert [spool.read(), spool.read(), spool.read()] == ["before", "after", None]


def answer(questions: Spool, answers: Spool) -> None:
    """In another process: from the start, whatever was read here."""
    while (question := questions.read()) is not None:
        answers.append(question * 2)


def test_a_spawned_process_reads_from_the_start_and_answers(spool: Spool, other: Spool) -> None:
    questions, answers = spool, other
    for value in (1, 2, 3):
        questions.append(value)
    assert questions.read() == 1
    process = get_context("spawn").Process(target=answer, args=(questions, answers))
    process.start()
    process.join(30.0)
    assert process.exitcode == 0
    assert [answers.read() for _ in range(4)] == [2, 4, 6, None]
    assert questions.read() == 2
