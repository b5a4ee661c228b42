"""Reads files from outside, bounded in size; whatever is wrong with one is an `InputError`."""

import gzip
import io
import stat
import zlib
from pathlib import Path

from semgraph.errors import InputError

MAX_FILE_BYTES = 512 * 2**20


def read_bytes(path: Path, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """The content of a regular file, unpacked if its name ends with .gz.

    Raises:
        InputError: missing, unreadable, not a regular file, damaged, or beyond `max_bytes`.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise InputError(f"{path}: expected a file, got a folder or device")
        with path.open("rb") as file:
            content = file.read(max_bytes + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: expected a file, there is none") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {_reason(error)}") from error
    if path.suffix == ".gz":
        content = _unpack(path, content, max_bytes)
    if len(content) > max_bytes:
        raise InputError(f"{path}: expected at most {max_bytes / 2**20:g} MiB, got more")
    return content


def read_text(path: Path, max_bytes: int = MAX_FILE_BYTES) -> str:
    """The content of a text file (UTF-8).

    Raises:
        InputError: as `read_bytes`, or not text.
    """
    try:
        text = read_bytes(path, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected text in UTF-8, got bytes at {error.start}") from error
    if "\0" in text:
        raise InputError(f"{path}: expected text, got a NUL byte")
    return text


def is_there(path: Path) -> bool:
    """Whether there is anything by this name, be it a file that can be read or not.

    Raises:
        InputError: its folder may not be looked into.
    """
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {_reason(error)}") from error
    return True


def plain_or_gz(path: Path) -> Path:
    """`path` if it is there, else the same with .gz behind.

    Raises:
        InputError: as `is_there`.
    """
    return path if is_there(path) else path.with_name(path.name + ".gz")


def _unpack(path: Path, packed: bytes, max_bytes: int) -> bytes:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(packed)) as file:
            return file.read(max_bytes + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: damaged gzip file: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """The first line of what an error says, without the file's name."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error).partition("\n")[0] or type(error).__name__
