"""The outcomes of a study, each on the disk before the next is looked at."""

import fcntl
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import BinaryIO, Final, final

from evaluation.studies.outcome_lines import MAX_LINE_BYTES, parse_outcome
from evaluation.studies.trial import Outcome, Status
from semgraph.errors import InputError, SemgraphError

STUDY_TOML: Final = "study.toml"
TRIALS_JSONL: Final = "trials.jsonl"
_LOCK: Final = ".lock"
_MAX_LINES: Final = 1_000_000


@final
class Store:
    """Outcomes in `trials.jsonl`, one a line; opened by `opened_store` alone.

    Attributes:
        notes: what a user should hear about the file, one line each.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.notes: list[str] = []
        self._path = folder / TRIALS_JSONL
        self._outcomes, self._size, torn = _read(self._path)
        if torn:
            self.notes.append(
                f"{self._path}: the last line was not finished ({torn} bytes) and is left out; "
                "its trial runs again"
            )
        self._file: FileIO | None = None

    @property
    def outcomes(self) -> Mapping[str, Outcome]:
        """By trial id; the last of a trial that was run again."""
        return self._outcomes

    def append(self, line: bytes) -> Outcome:
        """The outcome of a line that is on the disk when this returns.

        Raises:
            InputError: there is no outcome in the line, or its trial is finished already.
            SemgraphError: the disk does not take it; the file is as it was before.
        """
        outcome = parse_outcome(line)
        _check_new(self._outcomes, outcome)
        if self._file is None:
            self._file = self._opened()
        try:
            _write_all(self._file, line)
            os.fsync(self._file.fileno())
        except OSError as error:
            self._give_up()
            raise SemgraphError(
                f"{self._path}: cannot be written: {error.strerror}; the {len(self._outcomes)} "
                "trials before are kept: make room and give the same command again"
            ) from error
        self._size += len(line)
        self._outcomes[outcome.trial.id] = outcome
        return outcome

    def close(self) -> None:
        """Lets go of the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _opened(self) -> FileIO:
        """The file, without a torn end."""
        try:
            file = FileIO(self._path, "a")
            file.truncate(self._size)
        except OSError as error:
            raise SemgraphError(f"{self._path}: cannot be written: {error.strerror}") from error
        return file

    def _give_up(self) -> None:
        """Half a line is cut off; where even that fails it is recognised when it is read."""
        if self._file is None:
            return
        file, self._file = self._file, None
        try:
            file.truncate(self._size)
        except OSError:
            self.notes.append(f"{self._path}: its end may be torn")
        file.close()


@contextmanager
def opened_store(folder: Path) -> Iterator[Store]:
    """The store of a folder that nobody else writes meanwhile.

    Raises:
        InputError: it is no study's, or a line of its outcomes is damaged.
        SemgraphError: the folder cannot be written, or another process writes it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _check_ours(folder)
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise SemgraphError(f"{folder}: cannot be written: {error.strerror}") from error
    try:
        _lock(folder, lock)
        store = Store(folder)
        try:
            yield store
        finally:
            store.close()
    finally:
        os.close(lock)


def read_outcomes(folder: Path) -> tuple[Outcome, ...]:
    """The outcomes in a study's folder, in the order in which they came.

    Raises:
        InputError: there are none, or a line is damaged.
    """
    path = folder / TRIALS_JSONL
    if not path.is_file():
        raise InputError(f"{folder}: expected the folder of a study, it has no {TRIALS_JSONL}")
    outcomes, _, _ = _read(path)
    return tuple(outcomes.values())


def _check_ours(folder: Path) -> None:
    others = {path.name for path in folder.iterdir()} - {_LOCK}
    if others and not others & {STUDY_TOML, TRIALS_JSONL}:
        raise InputError(
            f"{folder}: expected a new or empty folder or that of a study (with {STUDY_TOML}), it "
            "holds something else; choose another --output"
        )


def _write_all(file: FileIO, line: bytes) -> None:
    """A disk that fills up may take a part of a line before it complains."""
    written = 0
    while written < len(line):
        written += file.write(line[written:])


def _lock(folder: Path, lock: int) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise SemgraphError(
            f"{folder}: another process runs this study; wait for it, or choose another --output"
        ) from None


def _read(path: Path) -> tuple[dict[str, Outcome], int, int]:
    """The outcomes by id, the bytes they take, and the bytes of a torn last line."""
    outcomes: dict[str, Outcome] = {}
    size = 0
    try:
        with path.open("rb") as file:
            for number, line in enumerate(_lines(file), start=1):
                if not line.endswith(b"\n") and len(line) <= MAX_LINE_BYTES:
                    return outcomes, size, len(line)
                _take(outcomes, line, f"{path} line {number}")
                size += len(line)
                if number > _MAX_LINES:
                    raise InputError(f"{path}: expected at most {_MAX_LINES} lines")
    except FileNotFoundError:
        return {}, 0, 0
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    return outcomes, size, 0


def _lines(file: BinaryIO) -> Iterator[bytes]:
    while line := file.readline(MAX_LINE_BYTES + 1):
        yield line


def _take(outcomes: dict[str, Outcome], line: bytes, where: str) -> None:
    try:
        outcome = parse_outcome(line)
        _check_new(outcomes, outcome)
    except InputError as error:
        raise InputError(f"{where}: {error}; delete this line, and its trial runs again") from error
    outcomes[outcome.trial.id] = outcome


def _check_new(outcomes: Mapping[str, Outcome], outcome: Outcome) -> None:
    earlier = outcomes.get(outcome.trial.id)
    if earlier is not None and earlier.status is Status.FINISHED:
        raise InputError(f"trial {outcome.trial.id} is finished already")
