"""Reads arrays of numbers from .npz files, bounded before anything is expanded."""

import io
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semgraph.errors import InputError, known_names
from sensors.files import read_bytes

MAX_EXPANDED_BYTES = 1024 * 2**20
MAX_MEMBERS = 100


def load_npz(
    path: Path, required: Collection[str], optional: Collection[str] = ()
) -> dict[str, NDArray[Any]]:
    """The arrays of numbers in the file, by name. Nothing is unpickled.

    Raises:
        InputError: unreadable, damaged, too big when expanded, a name unknown or missing, or an
            array that holds no numbers.
    """
    content = read_bytes(path)
    if content.count(b"PK\x01\x02") > MAX_MEMBERS:
        raise InputError(f"{path}: expected at most {MAX_MEMBERS} arrays, got more")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _check_members(path, archive, required, optional)
            return {_name(member): _array(path, archive, member) for member in archive.infolist()}
    except (
        *(zipfile.BadZipFile, zlib.error, struct.error, OSError, EOFError, MemoryError),
        *(ValueError, TypeError, LookupError, SyntaxError, ArithmeticError),
        *(RuntimeError, AttributeError, tokenize.TokenError),
    ) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(f"{path}: damaged or no .npz file: {reason}") from error


def _name(member: zipfile.ZipInfo) -> str:
    return member.filename.removesuffix(".npy")


def _check_members(
    path: Path, archive: zipfile.ZipFile, required: Collection[str], optional: Collection[str]
) -> None:
    names = [_name(member) for member in archive.infolist()]
    known = [*required, *optional]
    for name in names:
        if name not in known:
            raise InputError(f"{path}: unknown array {name[:40]!r}, {known_names(name, known)}")
        if names.count(name) > 1:
            raise InputError(f"{path}: the array {name} is in it twice")
    for name in required:
        if name not in names:
            raise InputError(f"{path}: expected an array {name}, there is none")
    expanded = sum(member.file_size for member in archive.infolist())
    if expanded > MAX_EXPANDED_BYTES:
        raise InputError(
            f"{path}: expected at most {MAX_EXPANDED_BYTES / 2**20:g} MiB when expanded, "
            f"got {expanded / 2**20:.0f} MiB"
        )


def _array(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """One array; its header must promise as many bytes as the member has."""
    with archive.open(member) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # numpy's, on headers of Python 2
        version = np.lib.format.read_magic(file)
        if version not in {(1, 0), (2, 0)}:
            raise InputError(f"{path}: {member.filename}: unknown version {version} of .npy")
        read_header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, is_fortran, dtype = read_header(file)
        if dtype.kind not in "uif":
            raise InputError(f"{path}: {member.filename}: expected numbers, got {dtype}")
        data = file.read()
    array = np.frombuffer(data, dtype=dtype)
    return array.reshape(shape, order="F" if is_fortran else "C")
