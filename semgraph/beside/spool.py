"""A queue between two processes that is its own log: a file without a name, written at its end."""

import os
import pickle
import tempfile
import zlib
from collections.abc import Callable
from multiprocessing.reduction import DupFd
from struct import Struct
from typing import Any, Final, final

from semgraph.errors import SemgraphError

_HEAD: Final = Struct("<QI")


@final
class Spool:
    """What one process appends and another reads, each at its own pace; neither waits.

    The file has no name and belongs to its user alone, so nobody else can open it and nothing of
    it is left however the processes end; only because it holds nothing but our own values are they
    pickled. Each stands behind its length and checksum: of one that is still being written, or
    whose writer died, nothing is read. In memory there is one value at a time.

    Handed to a process that is being spawned, it is read from its start there: the log replayed.

    Raises:
        SemgraphError: there is no place for a file.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        try:
            # Unbuffered: what was appended is there for the reader at once.
            self._file = (
                tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
                if descriptor is None
                else os.fdopen(descriptor, "r+b", buffering=0)
            )
        except OSError as error:
            raise _refused(str(error.strerror)) from error
        self._end = os.fstat(self._file.fileno()).st_size
        self._at = 0

    def __reduce__(self) -> tuple[Callable[[Any], "Spool"], tuple[Any]]:
        return _received, (DupFd(self._file.fileno()),)

    def append(self, value: object) -> None:
        """One value more.

        Raises:
            SemgraphError: the disk takes no more; then the spool is as it was.
        """
        payload = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        frame = _HEAD.pack(len(payload), zlib.crc32(payload)) + payload
        reason = "no space left"
        try:
            written = os.pwrite(self._file.fileno(), frame, self._end)
        except OSError as error:
            written, reason = 0, str(error.strerror)
        if written < len(frame):
            self._file.truncate(self._end)
            raise _refused(reason)
        self._end += len(frame)

    def read(self) -> Any:
        """The next value; None until it is there whole.

        Raises:
            SemgraphError: its checksum is wrong.
        """
        head = os.pread(self._file.fileno(), _HEAD.size, self._at)
        if len(head) < _HEAD.size:
            return None
        length, checksum = _HEAD.unpack(head)
        payload = os.pread(self._file.fileno(), length, self._at + _HEAD.size)
        if len(payload) < length:
            return None
        if zlib.crc32(payload) != checksum:
            raise SemgraphError(f"spool: damaged at byte {self._at}; is the disk sound?")
        self._at += _HEAD.size + length
        return pickle.loads(payload)  # noqa: S301  # our own, see above

    def close(self) -> None:
        """Here; it ceases to be once all processes have closed it."""
        self._file.close()


def _refused(reason: str) -> SemgraphError:
    folder = tempfile.tempdir or "the folder for temporary files"
    return SemgraphError(
        f"spool in {folder}: cannot be written: {reason}; "
        "free some space or let TMPDIR name another folder"
    )


def _received(handle: Any) -> Spool:
    return Spool(handle.detach())
